"""Logs on an even clock: what a recursion from sample to sample needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.record import MAX_UNEVENNESS, Record

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# What a missing output means: a missing reading of that output; of all outputs of its row; or the
# end of a record, of which each other one begins in a state of its own.
Missing = Literal["reading", "row", "end"]

# A step longer than so many periods parts a record; on a clock that is not even, longer than so
# many of the steps that all but this share of them stay below, but never so many periods.
MAX_STEP_PERIODS, LONG_SHARE, MOST_PERIODS = 1.5, 0.01, 4.0
# A record goes on over so many missing rows. The error of a line between two neighbours is one
# that this share of the readings stays below: a standard deviation.
MAX_FILLED_ROWS, WITHIN_SHARE = 3, 0.68


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


def uneven_steps(log: Record, period: float) -> tuple[int, int, bool]:
    """Steps of a log that are not a `period` [s] long; all steps; whether rows are missing alone.

    Parameters
    ----------
    log : Record
    period : float [s]
    """
    steps = _steps(log)
    uneven = steps[np.abs(steps - period) > MAX_UNEVENNESS * period]
    return len(uneven), len(steps), _on_grid(uneven, period)


def lacks_rows(log: Record, period: float) -> bool:
    """Whether rows of a log are missing on a clock of this `period` [s] that is even beside them.

    Parameters
    ----------
    log : Record
    period : float [s]
    """
    uneven, _, rows_alone = uneven_steps(log, period)
    return bool(uneven) and rows_alone


def interpolation_error(inputs: Array) -> Array:
    """Distance of a reading of each input from the mean of its neighbours, a standard deviation.

    Parameters
    ----------
    inputs : ndarray, shape (m, n)

    Returns
    -------
    ndarray, shape (m, 1)
    """
    if inputs.shape[1] < 3:
        return np.full((len(inputs), 1), np.inf)
    apart = np.abs(np.diff(inputs, n=2)) / 2
    return np.asarray(np.quantile(apart, WITHIN_SHARE, axis=1, keepdims=True))


def _steps(log: Record) -> Array:
    """Steps of the clock between pauses [s]."""
    return np.concatenate([np.empty(0), *(np.diff(log.time[part]) for part in log.segments)])


def _on_grid(steps: Array, period: float) -> bool:
    """Whether all steps, but for the longest, are whole numbers of periods."""
    own = steps[steps <= (MAX_FILLED_ROWS + 1.5) * period] / period
    whole = np.round(own)
    return bool(np.all((whole >= 1) & (np.abs(own - whole) <= MAX_UNEVENNESS)))


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
    missing: Missing = "reading",
) -> Iterator[Record]:
    """A log as records on an even clock: cut at pauses and where inputs are not known.

    Over a few rows that are missing a line is drawn through the inputs, and the outputs have no
    reading. Where the steps are no whole periods a straight line between the readings is taken on
    the even clock, over steps up to `longest_step`. A record without any reading of an output is
    none.

    Parameters
    ----------
    record : Record
    inputs, outputs : sequence of str
    period : float [s]
    missing : {"reading", "row", "end"}
        What a missing output means. "end": over a few rows a line is drawn.
    """
    channels = (*inputs, *outputs)
    columns, m = record.matrix(channels), len(inputs)
    if missing == "end":
        for part in record.segments:
            columns[m:, part] = [_drawn(record.time[part], y) for y in columns[m:, part]]
    lacking = ~np.logical_and.reduce(np.isfinite(columns[m:]), axis=0)
    if missing == "row":
        columns[m:, lacking] = np.nan
    known, longest = record.known(inputs), longest_step(record, period)
    stretches = []
    for part in record.segments:
        ends = ~known[part] | (lacking[part] & (missing == "end"))
        rows = np.flatnonzero(~ends)
        if len(rows):
            stretches.append(
                _Stretch(record.time[part], columns[:, part], m, rows, ends, period, longest)
            )
    for stretch in stretches:
        for time, values in stretch.pieces(missing == "end"):
            if np.isfinite(values[m:]).any():
                yield Record(time, dict(zip(channels, values, strict=True)), name=record.name,
                             origin=record.origin)  # fmt: skip


def _drawn(time: Array, values: Array) -> Array:
    """A channel with straight lines over a few missing rows between two readings."""
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < 2:
        return values
    clock = np.arange(rows[0], rows[-1] + 1)
    run = np.diff(rows)[np.minimum(np.searchsorted(rows, clock, side="right"), len(rows) - 1) - 1]
    found = values.copy()
    own = clock[run <= MAX_FILLED_ROWS + 1]
    found[own] = np.interp(time[own], time[rows], values[rows])
    return found


@dataclass(frozen=True)
class _Stretch:
    """Rows of a log between two pauses.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    columns : ndarray, shape (m + p, n)
        Inputs, outputs.
    inputs : int
        m
    rows : ndarray of int
        Those that count.
    ends : ndarray of bool, shape (n,)
        Rows over which no record goes on.
    period, longest : float [s]
    """

    time: Array
    columns: Array
    inputs: int
    rows: Index
    ends: NDArray[np.bool_]
    period: float
    longest: float

    @cached_property
    def even(self) -> bool:
        """Whether the steps are whole periods."""
        return _on_grid(np.diff(self.time), self.period)

    @cached_property
    def steps(self) -> Array:
        """Steps between the rows that count [periods]."""
        return np.asarray(np.diff(self.time[self.rows]) / self.period)

    @cached_property
    def holes(self) -> Index:
        """Which of these steps are none that the clock makes by itself."""
        limit = MAX_STEP_PERIODS if self.even else self.longest / self.period
        return np.flatnonzero((self.steps > limit) | (np.diff(self._ended) > 0))

    @cached_property
    def _ended(self) -> Index:
        return np.cumsum(self.ends, dtype=np.intp)[self.rows]

    @cached_property
    def filled(self) -> NDArray[np.bool_]:
        """Over which of the holes a record goes on."""
        ended = np.diff(self._ended)[self.holes] > 0
        return np.asarray(~ended & (self.steps[self.holes] <= MAX_FILLED_ROWS + 1.5))

    def pieces(self, drawn: bool) -> Iterator[tuple[Array, Array]]:
        """Clock and channels of each piece, shapes (n,) and (m + p, n).

        Parameters
        ----------
        drawn : bool
            Whether a line is drawn through the outputs over the holes.
        """
        at = 0
        for piece in np.split(np.arange(len(self.rows)), self.holes[~self.filled] + 1):
            own = self.holes[self.filled & (self.holes >= piece[0]) & (self.holes < piece[-1])]
            yield self._piece(self.rows[piece], own - at, drawn)
            at += len(piece)

    def _piece(self, rows: Index, holes: Index, drawn: bool) -> tuple[Array, Array]:
        """One piece, holes counted by its rows."""
        m, time = self.inputs, self.time[rows]
        steps = np.diff(time)
        if not len(steps) or np.max(np.abs(steps - self.period)) <= MAX_UNEVENNESS * self.period:
            return time, self.columns[:, rows]
        if self.even:
            places = np.append(0, np.cumsum(np.round(steps / self.period)))
            clock = np.interp(np.arange(places[-1] + 1), places, time)
        else:
            count = int((time[-1] - time[0]) / self.period + 1e-9) + 1
            clock = time[0] + self.period * np.arange(count, dtype=np.float64)
        values = np.array([np.interp(clock, time, row[rows]) for row in self.columns])
        before = np.searchsorted(time, clock, side="right") - 1
        inside = np.isin(before, holes) & (clock > time[before])
        if not drawn:
            values[m:, inside] = np.nan
        if self.even:
            # No line is drawn through a reading that is missing in a row that is there.
            values[:, np.searchsorted(clock, time - self.period / 2)] = self.columns[:, rows]
        return clock, values
