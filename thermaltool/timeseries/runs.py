"""Even records: runs of consecutive samples, the gaps between them, and differences.

An even record is a `Record` of one channel with a row for every period of each segment, NaN where
a sample is missing. Segments stand for themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.errors import FitError
from thermaltool.record import Record

Array = NDArray[np.float64]

NEW_START = -1  # in place of a number of missing samples: nothing is known of the time between


def even_record(values: ArrayLike, segments: Sequence[slice] = ()) -> Record:
    """Record of consecutive samples of one channel, "x", a second apart.

    Parameters
    ----------
    values : array_like, shape (n,)
        NaN where missing [unit].
    segments : sequence of slice, optional
        Stretches that stand for themselves; the whole by default.
    """
    x = np.asarray(values, dtype=float)
    return Record(np.arange(float(x.size)), {"x": x}, tuple(segments))


def joined(pieces: Sequence[Array]) -> Record:
    """Record of pieces that stand for themselves, one after the other.

    Parameters
    ----------
    pieces : sequence of ndarray, shape (n_i,)
    """
    edges = np.cumsum([0, *(piece.size for piece in pieces)]).tolist()
    return even_record(np.concatenate(pieces), [slice(a, b) for a, b in pairwise(edges)])


def samples(record: Record) -> Array:
    """Samples of the one channel of a record, ndarray (n,), NaN where missing [unit]."""
    (values,) = record.columns.values()
    return values


def with_samples(record: Record, values: Array) -> Record:
    """Record with other samples, ndarray (n,), on the same clock."""
    (channel,) = record.columns
    return replace(record, columns={channel: values})


def runs(record: Record) -> list[slice]:
    """Rows of consecutive samples that are there; a run ends at a hole and with its segment.

    Raises
    ------
    FitError
        No sample at all.
    """
    there = np.isfinite(samples(record))
    first = np.zeros(there.size + 1, dtype=bool)
    first[[part.start for part in record.segments]] = True
    follows = np.concatenate(([False], there[1:] & there[:-1], [False])) & ~first
    starts, stops = np.flatnonzero(there & ~follows[:-1]), np.flatnonzero(there & ~follows[1:]) + 1
    if not starts.size:
        raise FitError("no sample is there: every reading is missing")
    return [slice(a, b) for a, b in zip(starts.tolist(), stops.tolist(), strict=True)]


def pieces(record: Record) -> list[Array]:
    """Samples of every run, ndarray (n_i,) [unit]."""
    values = samples(record)
    return [values[run] for run in runs(record)]


def gaps(record: Record, rows: Sequence[slice]) -> list[int]:
    """Samples missing before each run; `NEW_START` before the first run of a segment."""
    borders = [part.start for part in record.segments]
    segment = np.searchsorted(borders, [run.start for run in rows], side="right").tolist()
    found = [NEW_START]
    for k, (before, after) in enumerate(pairwise(rows)):
        new = segment[k] != segment[k + 1]
        found.append(NEW_START if new else after.start - before.stop)
    return found


def places(record: Record) -> Array:
    """Periods from the first row to each row, pauses included, ndarray (n,)."""
    rows = np.arange(float(len(record)))
    for before, part in pairwise(record.segments):
        pause = record.time[part.start] - record.time[before.stop - 1]
        rows[part.start :] += max(float(np.rint(pause / record.period)) - 1.0, 0.0)
    return rows


def difference(record: Record, order: int) -> Record:
    """Differences of the given order; a run loses its first `order` samples.

    Raises
    ------
    FitError
        No run is longer than `order`.
    """
    if order == 0:
        return record
    values = samples(record)
    changed = np.full(values.size, np.nan)
    for part in record.segments:
        changed[part][order:] = np.diff(values[part], order)
    if not np.isfinite(changed).any():
        raise FitError(f"no run of samples is longer than the difference {order}")
    return with_samples(record, changed)


def bridged(record: Record) -> Record:
    """Record with straight lines over the holes within its segments; itself without any."""
    values, rows = samples(record), np.arange(len(record))
    filled = values.copy()
    for part in record.segments:
        there = part.start + np.flatnonzero(np.isfinite(values[part]))
        if there.size:
            inside = slice(there[0], there[-1] + 1)
            filled[inside] = np.interp(rows[inside], there, values[there])
    return (
        record if np.array_equal(filled, values, equal_nan=True) else with_samples(record, filled)
    )


def without(record: Record, rows: NDArray[np.intp]) -> Record:
    """Record in which the samples in some rows count as missing."""
    if not rows.size:
        return record
    values = samples(record).copy()
    values[rows] = np.nan
    return with_samples(record, values)
