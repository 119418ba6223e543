"""A bar in finite volumes that is heated at two places, and what sixteen sensors read on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

PERIOD, ROWS, SENSORS = 30.0, 2400, 16
NAMES = [f"T_s{k}_degC" for k in range(1, SENSORS + 1)]


def bar(
    rng: np.random.Generator, rows: int = ROWS, noise: float = 0.02
) -> tuple[Array, Array, Array]:
    """Sensor temperatures and growth of a bar of 40 cells that is heated at two places.

    Sensors lie near the surface, the growth is that of the core behind it, which lags by 20 min.
    """
    cells = 40
    stiff = np.diag(np.full(cells - 1, 1.0), 1)
    stiff = stiff + stiff.T
    along = (stiff - np.diag(stiff.sum(axis=1))) * 0.02 - 3e-4 * np.eye(cells)
    across = 1 / 1200.0
    A = np.block([[along, np.zeros((cells, cells))], [across * np.eye(cells)] * 2])
    A[cells:, cells:] *= -1
    B = np.zeros((2 * cells, 3))
    B[5, 0] = B[30, 1] = 0.02
    B[:cells, 2] = 3e-4
    whole = expm(PERIOD * np.block([[A, B], [np.zeros((3, 2 * cells + 3))]]))
    F, G = whole[: 2 * cells, : 2 * cells], whole[: 2 * cells, 2 * cells :]
    time: Array = PERIOD * np.arange(rows, dtype=np.float64)
    duty = np.repeat(rng.uniform(0, 1, (2, rows // 240 + 1)), 240, axis=1)[:, :rows]
    duty[:, (time // 3600) % 4 >= 2] = 0.0
    duty[:, :40] = 0.0
    u = np.vstack([duty, 1.5 * np.sin(2 * np.pi * time / 43200.0)])
    x, states = np.zeros(2 * cells), []
    for now in u.T:
        states.append(x)
        x = F @ x + G @ now
    course = np.array(states).T
    places = np.sort(rng.choice(cells, SENSORS, replace=False))
    levels = rng.uniform(18, 24, (SENSORS, 1))
    temperatures = course[places] + levels + noise * rng.standard_normal((SENSORS, rows))
    lever = np.linspace(1.0, -0.4, cells)
    growth = lever @ course[cells:] * 2.0
    return temperatures, growth + 0.1 * rng.standard_normal(rows), time
