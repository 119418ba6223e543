"""What a log is once it has been read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.units import Channel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Log:
    """A table of channels against one clock.

    Attributes
    ----------
    name : str
        The file as the user named it; ``<stdin>`` for a pipe.
    time : ndarray, shape (n,)
        Clock [s]. An ISO 8601 clock counts from its first row.
    columns : dict of str to ndarray, shape (n,)
        The channels in the units of their names, without the clock; NaN where missing.
    channels : dict of str to Channel
        What each column's name says.
    segments : tuple of slice
        The stretches between pauses, in order; they cover every row.
    digest : str
        SHA-256 of the input bytes, for provenance.
    epoch : str or None
        The first time stamp of an ISO 8601 clock, as written.
    lines : ndarray of int, shape (n,)
        The line of each row in the file (in Parquet, which has no lines: its row from 1).
    problems : tuple of LogError
        What a reading with ``strict=False`` found and went around.
    """

    name: str
    time: Array
    columns: dict[str, Array]
    channels: dict[str, Channel]
    segments: tuple[slice, ...]
    digest: str
    epoch: str | None = None
    lines: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    problems: tuple[LogError, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    def column(self, name: str) -> Array:
        """The samples of channel `name`, shape (n,), in the unit of its name.

        Raises
        ------
        LogError
            Where there is no such column; the message names the near ones.
        """
        if name not in self.columns:
            raise LogError(f"no column {name}{hint(name, self.columns)}", self.name)
        return self.columns[name]

    @property
    def period(self) -> float:
        """Median sample period [s]; NaN below two rows."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")


def hint(name: str, known: Iterable[str]) -> str:
    """The names nearest to `name`, as the tail of a message; else all that there are."""
    known = list(known)
    near = get_close_matches(name, known, n=3, cutoff=0.6)
    if near:
        return f" (near: {', '.join(near)})"
    return f" (there are: {', '.join(known)})" if known else ""
