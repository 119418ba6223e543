"""A response read through first-order lags, as modes again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Modes

# A pole within this share of that of the lag makes one double pole with it: the weights of two
# simple ones would cancel. The step response is off by the square of it.
DOUBLE_POLE_TOLERANCE = 1e-3


def lagged_modes(modes: Modes, *time_constants: float) -> Modes:
    """``modes`` times a/(s + a), a = 1/time constant, for each of them, by partial fractions.

    Parameters
    ----------
    modes : Modes
    *time_constants : float [s], above 0

    Returns
    -------
    Modes
        Of the same steady state.
    """
    for time_constant in time_constants:
        modes = _lagged(modes, time_constant)
    return modes


def _lagged(modes: Modes, time_constant: float) -> Modes:
    if isinstance(modes, DelayedModes):
        late = _lagged(modes.prompt(), time_constant)
        return replace(modes, poles=late.poles, weights=late.weights, double=late.double)
    a = 1 / time_constant
    poles, weights, double = list(modes.poles), list(modes.weights), list(modes.double)
    # A triple pole has no place in this form: the lag moves aside.
    for p in modes.poles[modes.double != 0].real:
        if abs(p + a) < DOUBLE_POLE_TOLERANCE * a:
            a = -p * (1 + DOUBLE_POLE_TOLERANCE)
    own = modes.direct * a
    for k, (p, w, v) in enumerate(zip(modes.poles, modes.weights, modes.double, strict=True)):
        if v == 0 and p.imag == 0 and abs(p.real + a) < DOUBLE_POLE_TOLERANCE * a:
            poles[k], weights[k], double[k] = (p.real - a) / 2, 0.0, w.real * a
            continue
        # w/(s−p)·a/(s+a) and v/(s−p)²·a/(s+a).
        simple, twice = w * a / (p + a), v * a / (p + a)
        weights[k], double[k] = simple - twice / (p + a), twice.real
        pair = 2.0 if p.imag else 1.0
        own += pair * (-simple.real) + (twice / (p + a)).real
    return Modes(
        np.append(np.array(poles, complex), -a),
        np.append(np.array(weights, complex), own),
        np.append(np.array(double, float), 0.0),
    )
