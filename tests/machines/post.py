"""A post of lumped masses on any clock and from any state, exact between events.

Masses in a row from a floor to a heated head, each with air around it. Between two events (a row,
a switch of the heater, a short step where heat depends on the state) every mode of the symmetric
system decays on its own: no error of a time step, whatever the clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Table = dict[str, Array]
# Heat into every mass [W] beside the heater's, of time [s] and temperatures above the air [K].
Heat = Callable[[float, Array], Array]

MASSES, HEAD, FOOT = 8, 6, 2
DRIVE, NEAR, FAR, RISE, TILT = "Q_head_1", "dT_head_K", "dT_foot_K", "d_z_um", "d_y_um"
SENSORS, DEFLECTIONS = (NEAR, FAR), (RISE, TILT)
# White noise of a reading [K, µm].
WHITE = {NEAR: 0.01, FAR: 0.01, RISE: 0.1, TILT: 0.1}


@dataclass(frozen=True)
class Course:
    """A held input: `levels` from `times` on, none before.

    Attributes
    ----------
    times : ndarray, shape (n,) [s]
        Increasing.
    levels : ndarray, shape (n,)
    """

    times: Array
    levels: Array

    def at(self, time: float) -> float:
        row = int(np.searchsorted(self.times, time + 1e-9, side="right")) - 1
        return float(self.levels[row]) if row >= 0 else 0.0

    def later(self, delay: float) -> Course:
        return Course(self.times + delay, self.levels)


class Post:
    """One of many: every figure is within 20 % of its usual one.

    Parameters
    ----------
    seed : int
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 201])

        def about(usual: float, size: int) -> Array:
            return usual * rng.uniform(0.8, 1.2, size)

        self.capacity = about(400.0, MASSES)  # [J/K]
        self.film = about(0.4, MASSES)  # to the air [W/K]
        link, floor = about(9.0, MASSES - 1), float(about(1.5, 1)[0])  # [W/K]
        self.power = float(about(70.0, 1)[0])  # of the heater [W]
        self.stretch = about(1.1, MASSES)  # [µm/K]
        self.bend = about(0.5, MASSES) * np.linspace(-1.0, 1.0, MASSES)  # [µm/K]
        loss = np.diag(self.film)
        loss[0, 0] += floor
        for k, conductance in enumerate(link):
            ends = np.zeros(MASSES)
            ends[k], ends[k + 1] = 1.0, -1.0
            loss += conductance * np.outer(ends, ends)
        root = np.sqrt(self.capacity)
        self.rates, vectors = np.linalg.eigh(loss / np.outer(root, root))
        self._to_modes, self._to_masses = vectors.T / root, vectors / root[:, None]
        self._in_modes = (vectors * root[:, None]).T

    @property
    def slowest(self) -> float:
        """Slowest time constant [s]."""
        return float(1.0 / self.rates[0])

    def simulate(
        self,
        time: Array,
        heater: Course,
        start: Array | None = None,
        beside: Heat | None = None,
        step: float = 2.0,
    ) -> Array:
        """Temperatures above the air at every row, shape (n, MASSES) [K].

        Parameters
        ----------
        time : ndarray, shape (n,) [s]
        heater : Course
            Relative to full power.
        start : ndarray, shape (MASSES,), optional [K]
            At the first row; cold by default.
        beside : callable, optional
            Held over a `step` [s].
        """
        inner = heater.times[(heater.times > time[0]) & (heater.times < time[-1])]
        short = np.arange(time[0], time[-1], step) if beside is not None else np.zeros(0)
        events = np.unique(np.concatenate([time, inner, short]))
        rows = np.searchsorted(events, time)
        z = self._in_modes @ (np.zeros(MASSES) if start is None else start)
        states = np.empty((len(events), MASSES))
        states[0] = z
        heads = np.zeros(MASSES)
        heads[MASSES - 1] = self.power
        for k, (now, following) in enumerate(itertools.pairwise(events)):
            heat = heads * heater.at(float(now))
            if beside is not None:
                heat = heat + beside(float(now), self._to_masses @ z)
            steady = self._to_modes @ heat / self.rates
            z = steady + (z - steady) * np.exp(-self.rates * (following - now))
            states[k + 1] = z
        temperature: Array = np.asarray(states[rows] @ self._to_masses.T, np.float64)
        return temperature

    def outputs(self, temperature: Array) -> Table:
        """What sensors and probes would read without noise.

        Parameters
        ----------
        temperature : ndarray, shape (n, MASSES) [K]
        """
        return {
            NEAR: temperature[:, HEAD],
            FAR: temperature[:, FOOT],
            RISE: temperature @ self.stretch,
            TILT: temperature @ self.bend,
        }


def read(outputs: Table, seed: int) -> Table:
    """The outputs with white noise.

    Parameters
    ----------
    outputs : dict of channel to ndarray, shape (n,)
    seed : int
    """
    rng = np.random.default_rng([seed, 202])
    return {name: y + WHITE[name] * rng.standard_normal(len(y)) for name, y in outputs.items()}


def even(rows: int = 1500, period: float = 6.0) -> Array:
    """A clock as printed [s], shape (rows,)."""
    return period * np.arange(float(rows))


def uneven(seed: int, rows: int = 1500, period: float = 6.0) -> Array:
    """A clock that jitters by a third, drops one row of twenty and pauses twice, (rows,) [s]."""
    rng = np.random.default_rng([seed, 203])
    steps = period * rng.uniform(0.7, 1.3, rows - 1)
    steps[rng.random(rows - 1) < 0.05] *= 2.0
    steps[rng.integers(rows // 4, rows - 1, 2)] += 40.0 * period
    return np.round(np.append(0.0, np.cumsum(steps)), 3)


def duty(seed: int, time: Array, levels: int = 24) -> Course:
    """Random levels, each held for a random time, switched in rows of the clock; off at first.

    Parameters
    ----------
    seed : int
    time : ndarray, shape (n,) [s]
    levels : int
    """
    rng = np.random.default_rng([seed, 204])
    rows = np.sort(rng.choice(np.arange(5, len(time) - 5), levels, replace=False))
    values = np.round(rng.uniform(0.2, 1.0, levels), 2)
    values[rng.random(levels) < 0.3] = 0.0
    values[rng.integers(levels)] = 1.0
    return Course(time[rows], values)


def logged(course: Course, time: Array) -> Array:
    """The level of a course in every row, shape (n,).

    Parameters
    ----------
    course : Course
    time : ndarray, shape (n,) [s]
    """
    return np.array([course.at(float(t)) for t in time])
