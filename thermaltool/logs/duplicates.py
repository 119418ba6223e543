"""Rows of one time stamp: one row of them, or as many, spread up to the next stamp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.logs.clock import sampling
from thermaltool.logs.columns import DUPLICATES
from thermaltool.logs.log import Log
from thermaltool.record import Array


def merged(log: Log, duplicates: str | None, within: float = 0.0) -> Log:
    """The log with what its rows of one time become; itself where there are none.

    Parameters
    ----------
    log : Log
    duplicates : {"first", "mean", "spread"} or None
        None leaves the rows as they are.
    within : float
        Rows up to so long before or after the first of them count as of its time [s].

    Raises
    ------
    ValueError
        Another word.
    """
    if duplicates is None:
        return log
    if duplicates not in DUPLICATES:
        raise ValueError(f"duplicates {duplicates!r}: one of {', '.join(DUPLICATES)}")
    starts = _starts(log.time, within)
    if len(starts) == len(log):
        return log
    if duplicates == "spread":
        return replace(log, time=_spread(log.time, starts))
    combine = _first if duplicates == "first" else _mean
    columns = {name: combine(values, starts) for name, values in log.columns.items()}
    begins = np.zeros(len(log), dtype=bool)
    begins[starts] = True
    return log.where(begins).with_columns(columns)


def burst_means(log: Log) -> Log:
    """The log with one row for each burst, its mean; itself where it is not sampled in bursts.

    Parameters
    ----------
    log : Log
    """
    clock = sampling(log.time)
    if clock.burst_rows is None or clock.burst_rows < 2 or clock.burst_period is None:
        return log
    return merged(log, "mean", clock.burst_period / 2)


def of_one_time(first: float, now: float, within: float) -> bool:
    """Whether a row counts as of the time of the first of its group.

    Parameters
    ----------
    first, now : float [s]
    within : float [s]
    """
    return abs(now - first) <= within


def _starts(time: Array, within: float) -> NDArray[np.intp]:
    """Where groups of rows of one time begin."""
    if within == 0:
        return np.flatnonzero(np.concatenate([[True], np.diff(time) != 0])[: len(time)])
    starts, first = [], np.inf
    for k, now in enumerate(time.tolist()):
        if not of_one_time(first, now, within):
            starts.append(k)
            first = now
    return np.array(starts, dtype=np.intp)


def _first(values: Array, starts: NDArray[np.intp]) -> Array:
    """The first reading of each group that is none of the missing ones."""
    places = np.where(np.isnan(values), len(values), np.arange(len(values)))
    first = np.minimum.reduceat(places, starts)
    return np.where(first < len(values), np.append(values, np.nan)[first], np.nan)


def _mean(values: Array, starts: NDArray[np.intp]) -> Array:
    present = ~np.isnan(values)
    counts = np.add.reduceat(present.astype(float), starts)
    sums = np.add.reduceat(np.where(present, values, 0.0), starts)
    return np.where(counts > 0, sums / np.where(counts > 0, counts, 1.0), np.nan)


def _spread(time: Array, starts: NDArray[np.intp]) -> Array:
    """The clock with rows of one stamp at even steps up to the next stamp.

    The first stamp and the last may be cut by the record's ends: their rows have the usual step,
    the first's up to the second stamp.
    """
    counts = np.diff(np.append(starts, len(time)))
    stamps = time[starts]
    gaps = np.diff(stamps)
    if not len(gaps) or not np.all(gaps > 0):  # nothing to go by, or a fault of its own
        return time
    inner = slice(1, None) if len(gaps) > 1 else slice(None)
    usual = float(np.median((gaps / counts[:-1])[inner]))
    # A pause behind a stamp is none of its rows' steps.
    steps = np.append(np.minimum(gaps / counts[:-1], _longest(gaps, counts, usual)), usual)
    begins = stamps.copy()
    if counts[0] * usual < gaps[0] <= 1.5 * float(np.median(gaps)):
        begins[0], steps[0] = stamps[1] - counts[0] * usual, usual
    within = np.arange(len(time)) - np.repeat(starts, counts)
    return np.repeat(begins, counts) + within * np.repeat(steps, counts)


def _longest(gaps: Array, counts: NDArray[np.intp], usual: float) -> Array:
    """The longest step of each stamp's rows [s]: the usual one behind which the log pauses."""
    pauses = gaps > 3 * np.median(gaps)
    return np.where(pauses & (counts[:-1] > 1), usual, np.inf)
