"""The clock of a log: its period, bursts, gaps and jitter; resampling when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.logs.log import Log
from thermaltool.record import Array
from thermaltool.units import hold_of

# A pause this many periods long ends a burst; a pause GAP_PERIODS long ends a segment.
BURST_PERIODS = 3.0
GAP_PERIODS = 10.0
# Bursts are a way of sampling, not an accident, once they recur and resemble each other.
MIN_BURSTS = 5
MIN_ALIKE_SHARE = 0.8
# Steps on either side of one that say how quick the clock is there.
NEIGHBOURS = 4
# Steps that differ by less than this share of the time itself differ by rounding.
ROUNDING_SHARE = 1e-12


@dataclass(frozen=True)
class Sampling:
    """How a clock ticks.

    Attributes
    ----------
    period : float
        Median step [s] (within bursts, where there are bursts); NaN below two rows.
    jitter : float
        Largest departure of a step from `period` [s], pauses left out.
    burst_rows : int or None
        Rows per burst; None where the sampling is even.
    burst_period : float or None
        Median time from one burst's start to the next [s].
    max_gap : float
        A step above this [s] is a gap: 10 periods, or 10 pauses between bursts.
    """

    period: float
    jitter: float
    burst_rows: int | None
    burst_period: float | None
    max_gap: float


def sampling(time: Array) -> Sampling:
    """Describe the steps of a clock `time` [s], shape (n,); backward steps are left out."""
    steps = np.diff(time)
    forward = steps[steps > 0]
    if not forward.size:
        return Sampling(float("nan"), 0.0, None, None, float("inf"))
    period = float(np.median(forward))
    within = forward[forward <= BURST_PERIODS * period]
    jitter = float(np.max(np.abs(within - period), initial=0.0))
    if jitter < ROUNDING_SHARE * np.nanmax(np.abs(time)):
        jitter = 0.0
    rows, burst_period, pause = _bursts(time, steps, period)
    return Sampling(period, jitter, rows, burst_period, GAP_PERIODS * (pause or period))


def _bursts(
    time: Array, steps: Array, period: float
) -> tuple[int | None, float | None, float | None]:
    """Rows per burst, time between bursts [s] and the pause [s], where bursts recur."""
    ends = np.flatnonzero(steps > BURST_PERIODS * period)
    if len(ends) < MIN_BURSTS:
        return None, None, None
    # The first and the last burst may be cut by the record's ends.
    rows = np.diff(ends)
    pauses = steps[ends]
    usual_rows, usual_pause = int(np.median(rows)), float(np.median(pauses))
    alike = (np.abs(rows - usual_rows) <= 1) & (np.abs(pauses[1:] / usual_pause - 1) <= 0.5)
    if np.mean(alike) < MIN_ALIKE_SHARE:
        return None, None, None
    return usual_rows, float(np.median(np.diff(time[ends + 1]))), usual_pause


def segments(time: Array, max_gap: float | None = None) -> tuple[slice, ...]:
    """Cut a clock [s], shape (n,), at steps above `max_gap` [s] and at backward steps.

    Without `max_gap`: ten median periods, or ten pauses where the log is sampled in bursts; and
    ten of the steps around it, for a clock that slows down has no gaps (`far_from_neighbours`).
    """
    if not len(time):
        return ()
    limit = sampling(time).max_gap if max_gap is None else max_gap
    steps = np.diff(time)
    long = np.flatnonzero(steps > limit)
    if max_gap is None:
        long = far_from_neighbours(steps, long, GAP_PERIODS)
    cuts = np.union1d(long, np.flatnonzero(steps < 0)) + 1
    edges = [0, *cuts.tolist(), len(time)]
    return tuple(slice(a, b) for a, b in pairwise(edges))


def far_from_neighbours(steps: Array, long: NDArray[np.intp], factor: float) -> NDArray[np.intp]:
    """Those of some steps that are longer by a factor than the median of the steps around them.

    On a logarithmic clock, and where a clock changes from dense to sparse, all steps from some
    time on are long.

    Parameters
    ----------
    steps : ndarray, shape (n,) [s]
    long : ndarray of int
        Places of the steps in question.
    factor : float
    """
    if not len(long):
        return long
    around = long[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    inside = (around >= 0) & (around < len(steps))
    near = np.where(inside, steps[np.clip(around, 0, len(steps) - 1)], np.nan)
    return np.asarray(long[steps[long] > factor * np.nanmedian(near, axis=1)])


def resample(log: Log, period: float) -> Log:
    """The log on an even clock, between its rows as its channels are taken everywhere.

    Heats, speeds and other commands are held, temperatures and displacements go along straight
    lines.

    Parameters
    ----------
    log : Log
        Clock increasing.
    period : float
        New sample period [s].

    Returns
    -------
    Log
        Rows at ``time[0] + k period`` that lie inside a segment: a gap stays a gap. Beside a
        missing sample the channel is missing.

    Raises
    ------
    LogError
        Where the clock does not increase.
    """
    if not period > 0:
        raise ValueError(f"period must be above 0 s, not {period}")
    if not np.all(np.diff(log.time) > 0):
        message = "the clock does not increase: it cannot be resampled"
        if np.any(np.diff(log.time) == 0):
            message += " (--duplicates first, mean or spread mends repeated stamps)"
        raise LogError(message, log.name)
    pieces: list[tuple[Array, slice]] = []
    for part in log.segments:
        start, stop = log.time[part][[0, -1]] - log.time[0]
        # A millionth of a period forgives the rounding of the division.
        first, last = np.ceil(start / period - 1e-6), np.floor(stop / period + 1e-6)
        pieces.append((log.time[0] + period * np.arange(first, last + 1), part))
    pieces = [(grid, part) for grid, part in pieces if grid.size]
    time = np.concatenate([grid for grid, _ in pieces]) if pieces else np.empty(0)

    def between(name: str, values: Array, grid: Array, part: slice) -> Array:
        if hold_of(name) == "first":
            return np.interp(grid, log.time[part], values[part])
        rows = np.searchsorted(log.time[part], grid + 1e-6 * period, side="right") - 1
        return values[part][rows]

    columns = {
        name: np.concatenate([between(name, x, *piece) for piece in pieces])
        if pieces
        else np.empty(0)
        for name, x in log.columns.items()
    }
    edges = np.cumsum([0] + [len(grid) for grid, _ in pieces]).tolist()
    cut = tuple(slice(a, b) for a, b in pairwise(edges))
    lines = np.interp(time, log.time, log.lines).astype(np.intp) if time.size else log.lines[:0]
    return replace(log, time=time, columns=columns, segments=cut, lines=lines)
