"""A stretch of a log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.log import Log


def between(log: Log, start: float | None, stop: float | None) -> Log:
    """The rows from `start` up to and including `stop` [s]; open where None.

    Raises
    ------
    LogError
        Where no row is left.
    """
    low = 0 if start is None else int(np.searchsorted(log.time, start, side="left"))
    high = len(log) if stop is None else int(np.searchsorted(log.time, stop, side="right"))
    if low == 0 and high == len(log):
        return log
    if low >= high:
        raise LogError(f"no row between {start} s and {stop} s", log.name)
    rows = slice(low, high)
    cut = [slice(max(s.start, low) - low, min(s.stop, high) - low) for s in log.segments]
    return replace(
        log,
        time=log.time[rows],
        columns={name: values[rows] for name, values in log.columns.items()},
        lines=log.lines[rows],
        segments=tuple(s for s in cut if s.stop > s.start),
    )
