"""Thermal-network form: first-order modes whose time constants all outputs share."""
