"""Record: the only stretch of samples between a reader and a result."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError, UnitError, counted
from thermaltool.units import parse_channel

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

# A step may differ from the period by this share of it before the clock counts as uneven.
MAX_UNEVENNESS = 0.02
# A clock of larger numbers counts from 1970 [s].
SINCE_1970 = 5e8


# A key of TOML without quotes.
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
# Gaps that are printed one by one.
MAX_PRINTED_GAPS = 5


@dataclass(frozen=True)
class ChannelSummary:
    """One channel: what its name says, its range, and the share of missing values."""

    name: str
    quantity: str
    unit: str
    minimum: float
    maximum: float
    missing: float


@dataclass(frozen=True, repr=False)
class Record:
    """Named channels against one clock.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
        Increasing.
    columns : mapping of str to ndarray, shape (n,)
        Channels in the units of their names; NaN where missing.
    segments : tuple of slice
        Stretches between pauses, in order; they cover every row. The whole by default.
    digest : str
        SHA-256 of the input bytes: identifies the record in provenance and in effects that belong
        to one record alone.
    name : str
        What messages call it.
    at_rest : bool
        Settled at its first inputs when it begins; else its state there is unknown.
    origin : int
        The experiment it is a part of: parts of one experiment have one zero.
    """

    time: Array
    columns: Mapping[str, Array]
    segments: tuple[slice, ...] = ()
    digest: str = ""
    name: str = "<record>"
    at_rest: bool = False
    origin: int = 0

    def __post_init__(self) -> None:
        for channel, values in self.columns.items():
            if values.shape != self.time.shape:
                raise LogError(
                    f"{channel} has shape {values.shape}, the clock {self.time.shape}", self.name
                )
        if not self.segments and len(self.time):
            object.__setattr__(self, "segments", (slice(0, len(self.time)),))

    def __repr__(self) -> str:
        """Rows, period, gaps and channels with their ranges and units."""
        count = len(self.segments)
        size = f"{counted(len(self), 'row')}, {self.duration if len(self) else 0.0:g} s"
        lines = [f"{self.name}: {size}, {count} segment{'' if count == 1 else 's'}"]
        if len(self) > 1:
            lines.append(f"period {self.period:.6g} s")
        starts = [part.start for part in self.segments[1:]]
        for k in starts[:MAX_PRINTED_GAPS]:
            gap = self.time[k] - self.time[k - 1]
            lines.append(f"gap of {gap:g} s after {self.time[k - 1]:.10g} s")
        if len(starts) > MAX_PRINTED_GAPS:
            lines.append(f"{len(starts) - MAX_PRINTED_GAPS} more gaps")
        return "\n".join([*lines, *channel_table(self.channel_summaries())])

    def __len__(self) -> int:
        return len(self.time)

    def column(self, channel: str) -> Array:
        """Samples of `channel`, shape (n,), in the unit of its name.

        Raises
        ------
        LogError
            Where there is no such channel; the message names the near ones.
        """
        if channel not in self.columns:
            raise LogError(f"no column {channel}{hint(channel, self.columns)}", self.name)
        return self.columns[channel]

    def line(self, row: int) -> int | None:
        """The line of a row in the file that it was read from; None where there is no file."""
        return None

    def channel_summaries(self) -> tuple[ChannelSummary, ...]:
        """Range and share of missing values of each channel."""
        return tuple(_summary(name, values) for name, values in self.columns.items())

    def matrix(self, channels: Sequence[str]) -> Array:
        """Samples of several channels, shape (channels, n); raises as `column`."""
        rows = [self.column(channel) for channel in channels]
        return np.array(rows).reshape(len(rows), len(self))

    @cached_property
    def period(self) -> float:
        """Median sample period [s]; NaN below two rows."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else float("nan")

    @property
    def row_readings(self) -> int:
        """Readings that a row stands for: more than one where rows are averages."""
        return 1

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def source(self) -> dict[str, str]:
        """Name and digest, as the provenance of a document has them."""
        return {"name": self.name, "sha256": self.digest}

    @property
    def elapsed(self) -> Array:
        """Time since the first row, shape (n,) [s]."""
        return self.time - self.time[0]

    def with_columns(self, columns: Mapping[str, Array]) -> Self:
        """The same clock with more or other channels."""
        return replace(self, columns={**self.columns, **columns})

    def rows(self, part: slice) -> Self:
        """Consecutive rows; those that follow the first begin in an unknown state."""
        low, high, _ = part.indices(len(self))
        cut = [slice(max(s.start, low) - low, min(s.stop, high) - low) for s in self.segments]
        return self._cut(slice(low, high), cut, low == 0)

    def where(self, keep: Rows) -> Self:
        """The rows of a mask, shape (n,); segments that lose all of theirs are gone."""
        before = np.concatenate(([0], np.cumsum(keep)))
        cut = [slice(int(before[s.start]), int(before[s.stop])) for s in self.segments]
        return self._cut(keep, cut, bool(keep[:1].all()))

    def _cut(self, rows: slice | Rows, segments: Sequence[slice], first: bool) -> Self:
        """Some rows; `first` tells whether the first row is among them."""
        return replace(
            self,
            time=self.time[rows],
            columns={name: values[rows] for name, values in self.columns.items()},
            segments=tuple(s for s in segments if s.stop > s.start),
            at_rest=self.at_rest and first,
        )

    def with_rows(self, time: Array, columns: Mapping[str, Array]) -> Self:
        """The record with rows between its own; those in a pause are a segment of their own.

        Parameters
        ----------
        time : ndarray, shape (m,) [s]
            Increasing; after the first row, and none that the record has.
        columns : mapping of str to ndarray, shape (m,)
            The other channels are missing there.
        """
        at = np.searchsorted(self.time, time, side="right")
        nothing = np.full(len(time), np.nan)
        starts = [s.start for s in self.segments]
        # Where the rows before a segment start now, and the segment itself.
        bounds = [k + int(at.searchsorted(k, side)) for k in starts for side in _SIDES]
        edges = sorted({*bounds, len(self) + len(time)})
        return replace(
            self,
            time=np.insert(self.time, at, time),
            columns={
                name: np.insert(values, at, columns.get(name, nothing))
                for name, values in self.columns.items()
            },
            segments=tuple(slice(a, b) for a, b in pairwise(edges)),
        )

    def between(self, start: float | None, stop: float | None) -> Self:
        """The rows from `start` up to and including `stop` [s]; open where None.

        Raises
        ------
        LogError
            Where no row is left, or a clock that counts from 1970 was taken to begin at zero.
        """
        if start is not None and len(self) and 0 < start < SINCE_1970 < self.time[0]:
            raise LogError(
                f"its clock counts from 1970: {start:g} s into the log is a start of "
                f"{self.time[0] + start:.10g} s",
                self.name,
            )
        low = 0 if start is None else int(np.searchsorted(self.time, start, side="left"))
        high = len(self) if stop is None else int(np.searchsorted(self.time, stop, side="right"))
        if low == 0 and high == len(self):
            return self
        if low >= high:
            ends = [("from", start), ("to", stop)]
            span = " ".join(f"{word} {end:g} s" for word, end in ends if end is not None)
            there = f": it has {self.time[0]:g} to {self.time[-1]:g} s" if len(self) else ""
            raise LogError(f"no row {span}{there}", self.name)
        return self.rows(slice(low, high))

    def known(self, channels: Iterable[str]) -> Rows:
        """Rows in which all of `channels` have a value, shape (n,)."""
        known = np.ones(len(self), dtype=bool)
        for channel in channels:
            known &= np.isfinite(self.column(channel))
        return known

    def pieces(self, channels: Sequence[str]) -> Iterator[Self]:
        """Parts without a pause in which all of `channels` have a value, of two rows and more."""
        known = self.known(channels)
        for part in self.segments:
            rows = part.start + np.flatnonzero(known[part])
            for piece in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
                if len(piece) > 1:
                    yield self.rows(slice(int(piece[0]), int(piece[-1]) + 1))


def _summary(name: str, values: Array) -> ChannelSummary:
    present = values[np.isfinite(values)]
    low, high = (float(present.min()), float(present.max())) if present.size else (np.nan, np.nan)
    share = 1.0 - present.size / values.size if values.size else 0.0
    try:
        channel = parse_channel(name)
    except UnitError:
        return ChannelSummary(name, "?", "?", low, high, share)
    return ChannelSummary(name, channel.quantity, channel.unit, low, high, share)


def channel_table(channels: Sequence[ChannelSummary]) -> list[str]:
    """Lines of a table: the heading, and one for each channel."""
    width = max((len(channel.name) for channel in channels), default=7)
    return [
        f"{'channel':<{width}}  {'min':>12}  {'max':>12}  {'unit':<5}  missing",
        *(
            f"{c.name:<{width}}  {c.minimum:>12.6g}  {c.maximum:>12.6g}  {c.unit:<5}  "
            f"{100 * c.missing:.3g} %{'  constant' if c.minimum == c.maximum else ''}"
            for c in channels
        ),
    ]


def hint(name: str, known: Iterable[str]) -> str:
    """The names nearest to `name`, as the tail of a message; else all that there are.

    Of the same channel in another unit, the line of a column map that turns it.
    """
    known = list(known)
    for other in in_another_unit(name, known):
        wanted, there = parse_channel(name), parse_channel(other)
        if wanted.dimension == there.dimension:
            return f" (there is {other}; a {map_line(other, name, there.unit)})"
        return f" (there is {other}, which is no {wanted.dimension})"
    near = get_close_matches(name, known, n=3, cutoff=0.6)
    if near:
        return f" (near: {', '.join(near)})"
    return f" (there are: {', '.join(known)})" if known else ""


def map_line(column: str, channel: str, unit: str) -> str:
    """What makes a channel of a column in another unit: a line of a column map, with its place.

    Parameters
    ----------
    column, channel : str
    unit : str
        Of the column.
    """
    key = column if _BARE_KEY.fullmatch(column) else json.dumps(column, ensure_ascii=False)
    line = f'{key} = {{ name = "{channel}", unit = "{unit}" }}'
    return f"line under [columns] of a map turns it: {line}"


def in_another_unit(name: str, known: Iterable[str]) -> list[str]:
    """The channels that are another one in all but the unit.

    Parameters
    ----------
    name : str
    known : iterable of str
        Names that are no channels are none of them.
    """
    found = []
    for other in known:
        try:
            one, two = parse_channel(name), parse_channel(other)
        except UnitError:
            continue
        if (one.quantity, one.place) == (two.quantity, two.place) and one.unit != two.unit:
            found.append(other)
    return found
