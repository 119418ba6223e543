"""What a log is once it has been read: a record, and where its rows stand in the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.logs.faults import Fault
from thermaltool.record import Array, Record, Rows


@dataclass(frozen=True, repr=False)
class Log(Record):
    """A record as it was read.

    Attributes
    ----------
    name : str
        The file as the user named it; ``<stdin>`` for a pipe.
    time : ndarray, shape (n,)
        Clock [s]. An ISO 8601 clock counts from its first row.
    epoch : str or None
        The first time stamp of an ISO 8601 clock, as written.
    lines : ndarray of int, shape (n,)
        The line of each row in the file (in Parquet, which has no lines: its row from 1).
    faults : tuple of Fault
        Readings that were left out as a sensor's faults; their rows count in the log as it was
        read.
    problems : tuple of LogError
        What a reading with ``strict=False`` found and went around.
    unread : mapping
        The first cell of a channel that is no number where nothing needs the channel: such cells
        are missing values.
    spared_map : str or None
        A column map that is not applied, since the file has its names already.
    """

    epoch: str | None = None
    faults: tuple[Fault, ...] = ()
    lines: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    problems: tuple[LogError, ...] = ()
    unread: Mapping[str, LogError] = field(default_factory=dict)
    spared_map: str | None = None

    def line(self, row: int) -> int | None:
        return int(self.lines[row])

    def _cut(self, rows: slice | Rows, segments: Sequence[slice], first: bool) -> Self:
        return replace(super()._cut(rows, segments, first), lines=self.lines[rows])

    def with_rows(self, time: Array, columns: Mapping[str, Array]) -> Self:
        """See `Record.with_rows`; a row that is between others stands where the one before does."""
        at = np.searchsorted(self.time, time, side="right")
        lines = np.insert(self.lines, at, self.lines[at - 1])
        return replace(super().with_rows(time, columns), lines=lines)
