"""What a roundness tester says of a trace."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def roundness(angle: Array, radius: Array, undulations: int = 50) -> float:
    """Departure from the least-squares circle, largest minus smallest [unit of radius].

    Parameters
    ----------
    angle : (n,) ndarray [revolutions]
        Any, over at least one revolution.
    radius : (n,) ndarray
    undulations : int
        Waves per revolution that a roundness tester's filter passes; with `undulations` = 50 the
        usual one (here with a sharp edge).
    """
    turn = 2 * np.pi * angle[:, None] * np.arange(undulations + 1)
    waves = np.hstack([np.cos(turn), np.sin(turn[:, 1:])])
    weights = np.linalg.lstsq(waves, radius, rcond=None)[0]
    weights[[0, 1, undulations + 1]] = 0.0  # the circle and its centre
    return float(np.ptp(waves @ weights))
