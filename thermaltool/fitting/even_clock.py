"""Logs on an even clock: what a recursion from sample to sample needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.record import MAX_UNEVENNESS, Record

Array = NDArray[np.float64]

# A step longer than so many periods parts a record; on a clock that is not even, longer than so
# many of the steps that all but this share of them stay below, but never so many periods.
MAX_STEP_PERIODS, LONG_SHARE, MOST_PERIODS = 1.5, 0.01, 4.0


def check_period(log: Record, period: float) -> None:
    """Refuse a log of another period than the first (LogError).

    Parameters
    ----------
    log : Record
    period : float [s]
    """
    if abs(log.period - period) > MAX_UNEVENNESS * period:
        raise LogError(
            f"sampled every {log.period:g} s, the first log every {period:g} s", log.name
        )


def uneven_steps(log: Record, period: float) -> tuple[int, int]:
    """How many of a log's steps are not a `period` [s] long, and how many there are."""
    steps = _steps(log)
    return int(np.sum(np.abs(steps - period) > MAX_UNEVENNESS * period)), len(steps)


def _steps(log: Record) -> Array:
    """Steps of the clock between pauses [s]."""
    return np.concatenate([np.empty(0), *(np.diff(log.time[part]) for part in log.segments)])


def longest_step(log: Record, period: float) -> float:
    """The longest step [s] that the clock of a log makes by itself: one above it is a hole.

    Parameters
    ----------
    log : Record
    period : float [s]
    """
    steps = _steps(log)
    usual = np.quantile(steps, 1 - LONG_SHARE, method="lower") if len(steps) else period
    return float(min(MAX_STEP_PERIODS * max(period, usual), MOST_PERIODS * period))


def even_records(
    record: Record,
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
    parted: bool = False,
) -> Iterator[Record]:
    """A log as records on an even clock: cut at pauses and where an input is missing.

    Where an output alone is missing it is NaN, for what drives acts there, too; a record without
    any reading of an output is none. Where the steps are not all `period` a straight line between
    the readings is taken on the even clock; a step above `longest_step` parts the record.

    Parameters
    ----------
    record : Record
    inputs, outputs : sequence of str
    period : float [s]
    parted : bool
        Whether a missing output parts the record, too.
    """
    channels = (*inputs, *outputs)
    columns, known = record.matrix(channels), record.known(channels if parted else inputs)
    longest = longest_step(record, period)
    for part in record.segments:
        rows = part.start + np.flatnonzero(known[part])
        if not len(rows):
            continue
        breaks = np.flatnonzero(np.diff(record.time[rows]) > longest) + 1
        for piece in np.split(rows, breaks):
            time: Array = record.time[piece]
            values = columns[:, piece]
            if len(piece) > 1 and np.max(np.abs(np.diff(time) - period)) > MAX_UNEVENNESS * period:
                count = int((time[-1] - time[0]) / period + 1e-9) + 1
                clock = time[0] + period * np.arange(count, dtype=np.float64)
                values = np.array([np.interp(clock, time, row) for row in values])
                time = clock
            if not np.isfinite(values[len(inputs) :]).any():
                continue
            yield Record(time, dict(zip(channels, values, strict=True)), name=record.name,
                         origin=record.origin)  # fmt: skip
