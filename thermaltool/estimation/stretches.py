"""Stretches of a record over which a filter has the same matrices."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import clock_step

# Indices of sensors.
Sensors = NDArray[np.intp]

# Stretches of fewer rows are walked through.
SHORT_STRETCH = 200


@dataclass(frozen=True)
class Stretch:
    """Rows over which the filter has the same matrices.

    A row's prediction a is corrected by the innovation v and carried on, a ← F a + K v; the
    adjoint comes the other way, r ← Hᵀ S⁻¹ v + Lᵀ r with L = F − K H.
    """

    rows: slice
    some: Sensors
    C: Float
    H: Float
    S: Float
    K: Float
    L: Float
    PC: Float

    @property
    def short(self) -> bool:
        """Whether it is walked through."""
        return self.rows.stop - self.rows.start < SHORT_STRETCH

    @property
    def weighed(self) -> Float:
        """What an innovation adds to the sum that goes back, shape (sensors, states)."""
        return np.asarray(np.linalg.solve(self.S, self.H), np.float64)

    def ahead(self) -> Recursion:
        """Of the prediction: readings of the sensors and estimates, before each reading."""
        return Recursion(self.L, self.K, np.zeros_like(self.K), np.vstack([self.H, self.C]))

    def back(self) -> Recursion:
        """Of the sum of later readings: what it adds to each prediction."""
        weighed = self.weighed
        return Recursion(self.L.T, np.zeros(weighed.T.shape), weighed.T, self.PC.T)


def even_rows(
    time: Float, readings: Float, cuts: Sequence[int]
) -> Iterator[tuple[slice, float, Sensors]]:
    """Rows whose next sample has one length [s], with readings of the same sensors, cut at rows."""
    n = len(time)
    steps, step = np.diff(time), clock_step(time)
    ticks = np.append(np.round(steps / step).astype(np.int64), 0)
    if n > 1:
        ticks[-1] = ticks[-2]
    there = np.isfinite(readings)
    changes = (np.diff(ticks) != 0) | np.any(there[1:] != there[:-1], axis=1)
    lengths: dict[int, float] = {}
    edges = np.unique([0, *(np.flatnonzero(changes) + 1).tolist(), *cuts, n]).tolist()
    for start, stop in itertools.pairwise(edges):
        dt = float(steps[min(start, n - 2)]) if n > 1 else 1.0
        # One length to rounding is one.
        dt = lengths.setdefault(int(ticks[start]), dt)
        yield slice(start, stop), dt, np.flatnonzero(there[start])
