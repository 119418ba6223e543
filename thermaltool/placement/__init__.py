"""Thermal modes, where sensors belong, and regressions that survive other conditions."""
