"""The axis of Zhu, Ni, Shih (2008, equation 18): 24 sets of its errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
POSITIONS, SETS, SET_TIME = np.linspace(0.0, 320.0, 17), 24, 600.0
NAMES = ("dT_1_K", "dT_2_K", "dT_3_K", "x_z_mm", "d_z_um")


def positioning_error(
    temperatures: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Equation (18) [um], of temperatures [K] of shape (3, n) and positions [mm]."""
    t1, t2, t3 = temperatures
    alone = 0.486 - 0.306 * t1 - 0.081 * t2 - 2.420 * t3
    return np.asarray(alone + at * (0.014 - 0.002 * t1 - 0.008 * t2 - 0.100 * t3))


def axis_columns(rng: np.random.Generator) -> tuple[dict[str, Array], dict[str, Array]]:
    """Sixteen sets to fit and eight to verify, every third one, with noise within 0.5 um."""
    time = (SET_TIME * np.arange(SETS)[:, None] + 5.0 * np.arange(len(POSITIONS))).ravel()
    at = np.tile(POSITIONS, SETS)
    rises = [amount * -np.expm1(-time / tau) for amount, tau in ((6, 5000), (4, 9000), (3, 3000))]
    # The machine moves more or less: the three are no combination of each other.
    rises[1] = rises[1] + 0.8 * np.sin(time / 1800)
    rises[2] = rises[2] * (1 + 0.3 * np.sin(time / 2500))
    error = positioning_error(np.array(rises), at) + rng.uniform(-0.5, 0.5, len(time))
    columns = dict(zip(("time_s", *NAMES), (time, *rises, at, error), strict=True))
    kept = np.repeat(np.arange(SETS) % 3 != 2, len(POSITIONS))
    train, test = ({name: v[rows] for name, v in columns.items()} for rows in (kept, ~kept))
    return train, test
