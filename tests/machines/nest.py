"""A spindle in a probe nest: three lumped bodies by Euler steps, five displacements, a room."""

from __future__ import annotations

import numpy as np

# Heat by speed [W per (rev/min)^1.5], capacities [J/K] and conductances [W/K] of bearing, head
# and column.
HEAT, STEP = 1.1e-4, 5.0
CAPACITY = np.array([2.4e3, 1.6e4, 9e4])
BETWEEN = np.array([6.0, 9.0])
TO_ROOM = np.array([1.5, 4.0, 12.0])
# Displacement of X1, X2, Y1, Y2, Z by the temperatures of the three [um/K].
BEND = np.array(
    [[0.3, -0.9, 0.5], [0.2, -0.6, 0.45], [-0.4, 2.1, -1.0], [-0.3, 1.8, -0.9], [2.2, 1.1, 0.4]]
)
PROBES = {
    "d_x1_um": "X:50mm", "d_x2_um": "X:150mm", "d_y1_um": "Y:50mm", "d_y2_um": "Y:150mm",
    "d_z_um": "Z",
}  # fmt: skip


def displacements(time: np.ndarray, speed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the five probes would read without noise, shape (5, n) [um]."""
    warm = np.zeros(3)
    scale = rng.uniform(0.7, 1.4, (5, 3))
    swing, phase = rng.uniform(0.2, 1.0), rng.uniform(0, 2 * np.pi)
    rows, at, turns_before = [], float(time[0]), float(speed[0])
    for moment, turns in zip(time, speed, strict=True):
        while at < moment - 1e-9:
            room = swing * (np.sin(2 * np.pi * at / 86400 + phase) - np.sin(phase))
            flow = BETWEEN * np.diff(warm)
            gain = TO_ROOM * (room - warm)
            gain[0] += HEAT * abs(turns_before) ** 1.5 + flow[0]
            gain[1] += flow[1] - flow[0]
            gain[2] -= flow[1]
            warm = warm + STEP * gain / CAPACITY
            at += STEP
        turns_before = turns
        rows.append((BEND * scale) @ warm)
    return np.array(rows).T


def wander(n: int, dt: float, sigma: float, tau: float, rng: np.random.Generator) -> np.ndarray:
    """An Ornstein-Uhlenbeck process, by its recursion."""
    keep = np.exp(-dt / tau)
    x = np.empty(n)
    x[0] = sigma * rng.standard_normal()
    for k in range(1, n):
        x[k] = keep * x[k - 1] + sigma * np.sqrt(1 - keep**2) * rng.standard_normal()
    return x


def readings(true: np.ndarray, dt: float, rng: np.random.Generator, drift: float) -> np.ndarray:
    """What five probes read: white noise, a drift, steps of 10 nm."""
    read = [row + wander(len(row), dt, drift, 1500.0, rng) for row in true]
    return np.round((np.array(read) + 0.04 * rng.standard_normal(true.shape)) / 0.01) * 0.01
