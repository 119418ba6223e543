"""Transfer functions from measured logs: ARX, ARMAX, OE and BJ, discrete and continuous."""
