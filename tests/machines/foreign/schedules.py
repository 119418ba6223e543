"""What machines are told to do: courses of a drive between 0 and 1, and of what goes on beside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Generator = np.random.Generator
# Time [s] and generator in, course out.
Schedule = Callable[[Array, Generator], Array]


def held(time: Array, lengths: Array, levels: Array) -> Array:
    """Levels one after the other, the last one to the end."""
    edges = time[0] + np.cumsum(lengths)
    return np.asarray(levels[np.minimum(np.searchsorted(edges, time, "right"), len(levels) - 1)])


def staircase(time: Array, generator: Generator) -> Array:
    """A designed excitation: rest, six levels in random order, rest, the highest one, rest."""
    levels = generator.permutation(np.linspace(0.2, 1.0, 6))
    shares = [0.03, *(0.62 * generator.dirichlet(np.full(6, 5.0))), 0.1, 0.15, 0.1]
    return held(time, np.ptp(time) * np.array(shares), np.array([0.0, *levels, 0.0, 1.0, 0.0]))


def duty(time: Array, generator: Generator) -> Array:
    """Random levels, one in four off, each held for 2 to 15 % of the log; rest first."""
    return _random(time, generator, 0.02, 0.15, 0.25)


def binary(time: Array, generator: Generator) -> Array:
    """Switched between levels at random, often: 1 to 8 % of the log each."""
    return _random(time, generator, 0.01, 0.08, 0.4)


def spectrum(time: Array, generator: Generator) -> Array:
    """A spectrum of speeds: short levels, long stops (ISO 230-3)."""
    course = _random(time, generator, 0.004, 0.03, 0.1)
    pauses = _random(time, generator, 0.05, 0.15, 0.35) > 0
    return np.where(pauses, course, 0.0)


def ramps(time: Array, generator: Generator) -> Array:
    """Ramps and soaks, as furnaces do; rest first."""
    edges, levels = [0.0, 0.02], [0.0, 0.0]
    while edges[-1] < 1.0:
        level = 0.0 if generator.random() < 0.25 else generator.uniform(0.2, 1.0)
        edges.append(edges[-1] + generator.uniform(0.01, 0.06))
        levels.append(level)
        edges.append(edges[-1] + generator.uniform(0.04, 0.15))
        levels.append(level)
    place = (time - time[0]) / np.ptp(time)
    return np.interp(place, edges, np.array(levels) / max(levels))


def jobs(time: Array, generator: Generator) -> Array:
    """Off and on by turns, hours each, at one of three levels."""
    lengths, levels = [0.03 * np.ptp(time)], [0.0]
    while sum(lengths) < np.ptp(time):
        lengths.append(np.ptp(time) * generator.uniform(0.03, 0.2))
        levels.append(0.0 if levels[-1] else float(generator.choice([0.5, 0.75, 1.0])))
    return held(time, np.array(lengths), np.array(levels))


def switched(time: Array, generator: Generator) -> Array:
    """Off and on by turns, off first: a pump, a fan."""
    return np.sign(_random(time, generator, 0.03, 0.15, 0.45))


def swing(time: Array, generator: Generator) -> Array:
    """A room about its mean: part of a slow swing of size 1 and wandering of 0.3."""
    period = generator.uniform(0.5, 1.5) * np.ptp(time)
    course = np.sin(2 * np.pi * (time / period + generator.random()))
    for _ in range(4):
        faster = np.ptp(time) / generator.uniform(3.0, 12.0)
        course = course + 0.12 * np.sin(2 * np.pi * (time / faster + generator.random()))
    return course


def conditioned(time: Array, generator: Generator) -> Array:
    """A room with a two-point cooler: a saw of 20 to 45 minutes upon half of a slow swing."""
    period, sheds = generator.uniform(1200.0, 2700.0), generator.uniform(0.55, 0.8)
    # It cools oftener by day than by night.
    beat = (time - time[0]) / period + generator.uniform(0.5, 2.0) * np.sin(time / 13750.0)
    saw = np.interp(beat % 1.0, [0.0, sheds, 1.0], [-1.0, 1.0, -1.0])
    return np.asarray(0.5 * saw + 0.5 * swing(time, generator))


def workpieces(time: Array, generator: Generator) -> Array:
    """A part above rest [K]: a new one comes in warm or cold now and then, and settles."""
    course, start = np.zeros_like(time), time[0]
    while start < time[-1]:
        length = np.ptp(time) * generator.uniform(0.1, 0.3)
        arrives, ends = generator.uniform(-5.0, 8.0), generator.uniform(-1.0, 2.0)
        since = (time - start) / (generator.uniform(0.04, 0.12) * np.ptp(time))
        course = np.where(time >= start, ends + (arrives - ends) * np.exp(-np.abs(since)), course)
        start += length
    return course


def _random(time: Array, generator: Generator, low: float, high: float, off: float) -> Array:
    lengths, levels = [0.02], [0.0]
    while sum(lengths) < 1.0:
        lengths.append(float(np.exp(generator.uniform(np.log(low), np.log(high)))))
        rests = bool(levels[-1]) and generator.random() < off
        levels.append(0.0 if rests else float(generator.uniform(0.2, 1.0)))
    course = held(time, np.ptp(time) * np.array(lengths), np.array(levels))
    return course / course.max()
