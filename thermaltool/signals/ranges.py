"""Ranges of a slow signal over stretches of time, with the interval that noise and drift leave."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter, savgol_filter

from thermaltool.signals.intervals import Estimate

Array = NDArray[np.float64]

# Points that a stretch is averaged to at the most: a maximum is found to a thousandth of it.
MAX_POINTS = 2000
# Points that lie within the time over which readings are averaged.
POINTS_IN_AVERAGE = 4
# Repetitions of the noise: a 95 % interval then holds 95 ± 1 %.
REPEATS = 500
LEVEL = 0.95
# Above so many ranges of the noise alone a level has the shape of the signal.
SMALL_NOISE = 4.0
# Below, so many sizes of it are tried.
SIZES = 13


@dataclass(frozen=True, eq=False)
class EvenLevel:
    """A signal averaged to an even clock, and smoothed by parabolas.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
        Around which each bin lies: the first reading, and on to the last.
    step : float [s]
    at : ndarray, shape (m,) [s]
        Where the readings of each bin lie on average; bins without any are left out.
    readings : ndarray, shape (m,)
        In each of these bins.
    half : int
        Bins on either side over which a parabola goes.
    level : ndarray, shape (n,)
    means, counts : ndarray, shape (n,)
        Average of each bin, along lines where it is empty, and its readings.
    """

    time: Array
    step: float
    at: Array
    readings: Array
    half: int
    level: Array
    means: Array
    counts: Array


def even_level(time: Array, values: Array, average: float) -> EvenLevel:
    """Average readings over `average` [s] around each moment, without a lag where they rise.

    Parameters
    ----------
    time : ndarray, shape (n,) [s], increasing
    values : ndarray, shape (n,)
        NaN is left out.
    average : float [s]

    Raises
    ------
    ValueError
        Fewer than two readings.
    """
    known = np.isfinite(values)
    time, values = time[known], values[known]
    if len(time) < 2:
        raise ValueError("fewer than two readings")
    span = float(time[-1] - time[0])
    period = float(np.median(np.diff(time)))
    step = max(period, average / POINTS_IN_AVERAGE, span / MAX_POINTS)
    # Whole periods: bins of as many readings each.
    step = period * math.ceil(step / period * (1 - 1e-9))
    # Bins around moments that begin with the first reading and end with the last.
    bins = max(2, 1 + round(span / step))
    step = span / (bins - 1)
    moments = time[0] + step * np.arange(bins)
    place = np.rint((time - time[0]) / step).astype(np.intp)
    count = np.bincount(place, minlength=bins)
    there = count > 0
    # Where the readings of a bin lie, and not its middle: those at the ends are halves.
    at = np.bincount(place, time, bins)[there] / count[there]
    mean = np.bincount(place, values, bins)[there] / count[there]
    half = max(0, min(round(average / step / 2), (bins - 1) // 2))
    means, counts = _along_lines(moments, at, mean), count.astype(float)
    level = local_parabolas(means, half)
    return EvenLevel(moments, step, at, counts[there], half, level, means, counts)


def _along_lines(moments: Array, at: Array, values: Array) -> Array:
    """Values at other moments, along the lines between them, and on along them at the ends.

    Parameters
    ----------
    moments : ndarray, shape (n,) [s]
    at : ndarray, shape (m,) [s]
        At least two.
    values : ndarray, shape (..., m)
    """
    after = np.clip(np.searchsorted(at, moments), 1, len(at) - 1)
    share = (moments - at[after - 1]) / (at[after] - at[after - 1])
    return np.asarray((1 - share) * values[..., after - 1] + share * values[..., after])


def local_parabolas(values: Array, half: int) -> Array:
    """The value of parabolas through `half` neighbours on either side (Savitzky and Golay 1964).

    A curve that bends evenly keeps its extremes, at its ends too, where the outermost parabola goes
    on to the last value.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    half : int
        Below 2 the values stay as they are.
    """
    if half < 2:
        return values
    return np.asarray(savgol_filter(values, 2 * half + 1, 2, axis=-1, mode="interp"))


def noise_repeats(
    like: EvenLevel, white: float, drift: float, drift_time: float, rng: np.random.Generator
) -> Array:
    """What noise adds to a level, drawn `REPEATS` times, shape (repeats, n).

    Parameters
    ----------
    like : EvenLevel
    white : float
        Standard deviation of a reading.
    drift, drift_time : float
        Standard deviation of an Ornstein-Uhlenbeck process, and its time constant [s].
    rng : Generator
    """
    # Bins as the readings fill them: what lies along lines between them is smoother.
    added = white / np.sqrt(like.readings) * rng.standard_normal((REPEATS, len(like.at)))
    added = _along_lines(like.time, like.at, added)
    if drift > 0:
        keeps = math.exp(-like.step / drift_time)
        pushes = rng.standard_normal(added.shape)
        pushes[:, 1:] *= math.sqrt(1 - keeps**2)
        added += drift * lfilter([1.0], [1.0, -keeps], pushes, axis=1)
    return local_parabolas(added, like.half)


def range_estimate(
    level: Array, curves: Array, noise: Array, unit: str, rows: int | None = None
) -> Estimate:
    """The largest minus the least value of the signal, and its 95 % interval.

    That of the curves that the readings may come from. Where the noise is not small against the
    range, it may as well be nothing: then the interval holds the ranges of these curves, made
    smaller or larger, that with noise lead to what was found.

    Parameters
    ----------
    level : ndarray, shape (n,) [unit]
    curves : ndarray, shape (repeats, n) [unit]
        Draws of the signal without noise.
    noise : ndarray, shape (repeats, n) [unit]
        Draws of what noise adds to the level.
    unit : str
    rows : int, optional
        The largest range within so many rows that follow each other. Default: within all.
    """
    found = float(_ranges(level[None], rows)[0])
    ends = (1 - LEVEL) / 2, (1 + LEVEL) / 2
    drawn = _ranges(curves, rows)
    alone = _ranges(noise, rows)
    if found < SMALL_NOISE * alone.mean():
        # No interval is narrower than what noise alone varies by.
        middle, largest = np.quantile(alone, [0.5, ends[1]])
        sizes = np.linspace(0.0, found + largest, SIZES)
        shapes = curves / np.where(drawn > 0, drawn, 1.0)[:, None]
        with_noise = np.array([_ranges(size * shapes + noise, rows) for size in sizes])
        quantiles = np.quantile(with_noise, [ends[1], 0.5, ends[0]], axis=1)
        rising = np.maximum.accumulate(quantiles, axis=1)
        low, value, high = (float(np.interp(found, each, sizes)) for each in rising)
        return Estimate(value, low, max(high, float(largest - middle)), unit)
    low, value, high = (float(each) for each in np.quantile(drawn, [ends[0], 0.5, ends[1]]))
    return Estimate(value, low, high, unit)


def _ranges(levels: Array, rows: int | None) -> Array:
    n = levels.shape[1]
    if rows is None or rows >= n:
        return np.ptp(levels, axis=1)
    # Windows that lie within the record whole.
    first, last = rows // 2, n - (rows - 1) // 2
    high = maximum_filter1d(levels, rows, axis=1)[:, first:last]
    low = minimum_filter1d(levels, rows, axis=1)[:, first:last]
    return np.asarray((high - low).max(axis=1))


def constant_stretches(values: Array, shortest: int) -> Sequence[slice]:
    """Stretches of at least so many rows over which a commanded value stays as it is.

    Parameters
    ----------
    values : ndarray, shape (n,)
        NaN goes on as the value before.
    shortest : int
    """
    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))
    edges = [0, *(np.flatnonzero(np.diff(values[last])) + 1).tolist(), len(values)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= shortest]
