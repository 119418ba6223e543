"""Subspace identification: poles that all outputs share, real or complex, and feedthrough."""
