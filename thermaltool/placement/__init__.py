"""Thermal modes, sensor choice, and regression that survives other conditions."""
