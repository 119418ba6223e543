"""The rod of Zhu, Ni, Shih (2008, table 1): heat at the fixed end, expansion at the free one."""

from __future__ import annotations

import numpy as np
from machines.heated_rod import Array, HeatedRod

ROD = HeatedRod(
    length=1.0,
    radius=float(np.sqrt(0.0314 / np.pi)),
    conductivity=60.5,
    capacity=434.0 * 7.8e3,
    film=20.0,
    cells=200,
)
# Expansion [um/(m K)], candidate places [m].
EXPANSION, PLACES = 10.8, tuple(round(0.1 * k, 1) for k in range(1, 10))
SENSORS = tuple(f"T_{k}_degC" for k in range(1, 10))
OUTPUT, ROOM = "d_tip_um", 20.0


def rod_columns(
    heat: Array,
    dt: float,
    rng: np.random.Generator | None = None,
    noise: float = 0.0,
    rod: HeatedRod = ROD,
) -> dict[str, Array]:
    """Time, temperatures at the nine places and the expansion for a heat [W], with noise [K]."""
    rises = rod.temperatures(heat, dt)
    centres = (np.arange(rod.cells) + 0.5) * rod.length / rod.cells
    columns: dict[str, Array] = {"time_s": np.arange(len(heat), dtype=float) * dt}
    for name, place in zip(SENSORS, PLACES, strict=True):
        k = int(np.searchsorted(centres, place))
        part = (place - centres[k - 1]) / (centres[k] - centres[k - 1])
        columns[name] = ROOM + (1 - part) * rises[:, k - 1] + part * rises[:, k]
        if rng is not None:
            columns[name] = columns[name] + noise * rng.standard_normal(len(heat))
    columns[OUTPUT] = EXPANSION * rod.length * rises.mean(axis=1)
    return columns


def random_heat(rng: np.random.Generator, rows: int, held: int, most: float = 1000.0) -> Array:
    """A heat [W] that is drawn anew every so many rows."""
    return np.repeat(rng.uniform(0, most, -(-rows // held)), held)[:rows]


def periodic_heat(rows: int, period: int, on: float = 0.5, most: float = 1000.0) -> Array:
    """A heat [W] that is on for a part of every period [rows]."""
    return np.where(np.arange(rows) % period < on * period, most, 0.0)
