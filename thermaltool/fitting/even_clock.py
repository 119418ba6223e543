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
# Missing rows are filled while what that leaves open of an input is no larger a share of its
# variation, in squares: 1 % of an output at most. An input is told by its neighbours as well as
# this share of its readings is.
MAX_OPEN_SHARE, TOLD_SHARE = 1e-4, 0.9


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


def _steps(log: Record) -> Array:
    """Steps of the clock between pauses [s]."""
    return np.concatenate([np.empty(0), *(np.diff(log.time[part]) for part in log.segments)])


def _on_grid(steps: Array, period: float) -> bool:
    """Whether all steps, but for the longest, are whole numbers of periods."""
    own = steps[steps <= (MOST_PERIODS + 0.5) * period] / period
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

    Rows that are missing, or lack an input, are filled as long as the rows around them say what the
    inputs did there (`MAX_OPEN_SHARE`), and have no reading of an output. Where the steps are no
    whole periods a straight line between the readings is taken on the even clock, over steps up to
    `longest_step`. A record without any reading of an output is none.

    Parameters
    ----------
    record : Record
    inputs, outputs : sequence of str
    period : float [s]
    missing : {"reading", "row", "end"}
        What a missing output means. "end": over rows that are not there at all a line is drawn.
    """
    channels = (*inputs, *outputs)
    columns, m = record.matrix(channels), len(inputs)
    lacking = ~np.logical_and.reduce(np.isfinite(columns[m:]), axis=0)
    if missing == "row":
        columns[m:, lacking] = np.nan
    known, longest = record.known(inputs), longest_step(record, period)
    stretches = []
    for part in record.segments:
        ends = lacking[part] & known[part] & (missing == "end")
        rows = np.flatnonzero(known[part] & ~ends)
        if len(rows):
            stretches.append(
                _Stretch(record.time[part], columns[:, part], m, rows, ends, period, longest)
            )
    power, error = _variation(columns[:m, known])
    shares = [each.open_shares(power, error) for each in stretches]
    ranked = np.sort(np.concatenate([np.empty(0), *shares]))
    filled = ranked[np.cumsum(ranked) <= MAX_OPEN_SHARE]
    most = filled[-1] if len(filled) else -1.0
    for stretch, own in zip(stretches, shares, strict=True):
        for time, values in stretch.pieces(own <= most, missing == "end"):
            if np.isfinite(values[m:]).any():
                yield Record(time, dict(zip(channels, values, strict=True)), name=record.name,
                             origin=record.origin)  # fmt: skip


def _variation(inputs: Array) -> tuple[Array, Array]:
    """Squares of the inputs about their means; how far a reading is from its neighbours' mean."""
    if inputs.shape[1] < 3:
        return np.ones((len(inputs), 1)), np.full((len(inputs), 1), np.inf)
    power = np.sum((inputs - inputs.mean(1, keepdims=True)) ** 2, 1, keepdims=True)
    apart = np.abs(np.diff(inputs, n=2)) / 2
    return np.maximum(power, 1e-300), np.quantile(apart, TOLD_SHARE, axis=1, keepdims=True)


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
    def _doubts(self) -> tuple[Array, Array]:
        """By how much the inputs change over every hole, and how far apart lines into it end.

        The lines are those through two rows before and two rows behind it; shapes (m, holes).
        """
        u, steps, k = self.columns[: self.inputs, self.rows], self.steps, self.holes
        change = np.abs(u[:, k + 1] - u[:, k])
        before, behind = np.maximum(k - 1, 0), np.minimum(k + 1, len(steps) - 1)
        slopes = np.diff(u, axis=1) / steps
        half = steps[k] / 2
        apart = np.abs(u[:, k] + slopes[:, before] * half - u[:, k + 1] + slopes[:, behind] * half)
        alone = (before == k) | (behind == k) | np.isin(before, k) | np.isin(behind, k)
        return change, np.where(alone, np.inf, apart)

    def open_shares(self, power: Array, error: Array) -> Array:
        """What every hole leaves open of an input, as a share of its variation in squares.

        Without end where the record does not go on over it at all. An input that is the same before
        and behind it has stood still.

        Parameters
        ----------
        power, error : ndarray, shape (m, 1)
            As `_variation` has them.
        """
        k = self.holes
        if not len(k):
            return np.empty(0)
        change, apart = self._doubts
        doubt = np.where(change > 0, np.maximum(np.minimum(change, apart), error), 0.0)
        shares = doubt**2 * np.maximum(self.steps[k] - 1, 1) / power
        over = (np.diff(self._ended)[k] > 0) | (self.steps[k] > MOST_PERIODS + 0.5)
        return np.where(over, np.inf, np.max(shares, axis=0, initial=0.0))

    def pieces(self, filled: NDArray[np.bool_], drawn: bool) -> Iterator[tuple[Array, Array]]:
        """Clock and channels of each piece, shapes (n,) and (m + p, n).

        Parameters
        ----------
        filled : ndarray of bool
            Which of the holes are.
        drawn : bool
            Whether a line is drawn through the outputs over the holes.
        """
        stands = np.zeros((self.inputs, len(self.rows)), bool)
        if len(self.holes):
            change, apart = self._doubts
            stands[:, self.holes] = change <= apart
        at = 0
        for piece in np.split(np.arange(len(self.rows)), self.holes[~filled] + 1):
            own = self.holes[filled & (self.holes >= piece[0]) & (self.holes < piece[-1])]
            yield self._piece(self.rows[piece], own - at, stands[:, piece], drawn)
            at += len(piece)

    def _piece(
        self, rows: Index, holes: Index, stands: NDArray[np.bool_], drawn: bool
    ) -> tuple[Array, Array]:
        """One piece; holes, and over which of them an input stands still, counted by its rows."""
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
        for k in range(m):
            still = inside & stands[k, before]
            values[k, still] = self.columns[k, rows[before[still]]]
        if not drawn:
            values[m:, inside] = np.nan
        if self.even:
            # An output may have a reading where an input has none.
            between = np.arange(rows[0], rows[-1] + 1)
            on = np.searchsorted(clock, self.time[between] - self.period / 2)
            values[m:, on] = self.columns[m:, between]
        return clock, values
