"""Thermal error of machines: from a measured log to a compensated stream."""

__version__ = "0.1.0"
