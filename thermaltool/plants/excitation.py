"""Heat inputs for test logs, as functions of time on the samples of a log.

Value k of an input acts from sample k to sample k + 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Levels, and how long each stands [s].
Holds = Iterator[tuple[float, float]]

TRIANGLE_RISE = 300.0  # Fraser (1997), section 6.9: 0 to 1 to 0 over 600 s


def idle(time: Array, seed: int) -> Array:
    """No heat."""
    return np.zeros_like(time)


def step(time: Array, seed: object) -> Array:
    """Full heat from time zero on."""
    return np.where(time >= 0.0, 1.0, 0.0)


def triangle(time: Array, seed: int) -> Array:
    """From zero to one in 300 s, back to zero at 600 s, then nothing."""
    return np.maximum(0.0, 1.0 - np.abs(time / TRIANGLE_RISE - 1.0))


def duty(time: Array, seed: int) -> Array:
    """Random duty cycle: blocks of 1 to 12 min, about one in three off, levels 0.2 to 1."""
    generator = np.random.default_rng([seed, 0])

    def holds() -> Holds:
        while True:
            length = generator.uniform(60.0, 720.0)
            level = generator.uniform(0.2, 1.0) if generator.random() < 2 / 3 else 0.0
            yield round(level, 2), length

    return held(time, holds())


def held(time: Array, holds: Holds) -> Array:
    """Levels one after the other, each with how long it stands [s], from time zero on."""
    course, start = np.zeros_like(time), 0.0
    while start <= time[-1]:
        level, length = next(holds)
        course[time >= start] = level
        start += length
    return course


INPUTS: dict[str, Callable[[Array, int], Array]] = {
    "step": step,
    "idle": idle,
    "triangle": triangle,
    "duty": duty,
}


def sample_times(duration: float, dt: float) -> Array:
    """Times from zero to `duration`, every `dt` [s], without rounding noise in the last digits."""
    times: Array = np.round(dt * np.arange(round(duration / dt) + 1), 9)
    return times


def hold(time: Array, samples: Array, values: Array, before: float) -> Array:
    """Input given as samples, each held until the next.

    Parameters
    ----------
    time : (n,) ndarray
        Where the input is wanted [s].
    samples, values : (m,) ndarray
        Ascending times [s] and the input from each of them on.
    before : float
        Its value before the first sample.
    """
    index = np.searchsorted(samples, time, side="right") - 1
    return np.where(index < 0, before, values[index])
