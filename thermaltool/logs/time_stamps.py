"""Time stamps as seconds: ISO 8601, other patterns, date and time of day apart."""

from __future__ import annotations

import re
from datetime import datetime

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import Clock
from thermaltool.record import Array

# Decimals of a second from the seventh on.
BEYOND_MICROSECONDS = re.compile(r":\d\d[.,]\d{6}(\d+)")
# What a workbook adds to a date without a time of day.
MIDNIGHT = "T00:00:00"


def joined_stamps(dates: list[str | None], times: list[str | None]) -> list[str | None]:
    """Dates and times of day as one stamp, a blank between them; None where one is missing."""
    pairs = zip(dates, times, strict=True)
    return [
        None if a is None or b is None else f"{a.strip().removesuffix(MIDNIGHT)} {b.strip()}"
        for a, b in pairs
    ]


def iso_clock(
    file: str, clock: Clock, stamps: list[str | None], lines: list[int]
) -> tuple[Array, str | None, list[LogError]]:
    """Seconds from the first time stamp; a stamp that cannot be read is NaN and a fault."""
    pattern = clock.format
    what = f"not a time like {pattern}" if pattern else "not an ISO 8601 time"
    moments: list[datetime | None] = []
    faults = []
    for stamp, line in zip(stamps, lines, strict=True):
        moment = None
        if stamp is not None:
            try:
                text = stamp.strip()
                moment = (
                    datetime.strptime(text, pattern) if pattern else datetime.fromisoformat(text)
                )
            except ValueError:
                faults.append(LogError(f"{what}: {stamp!r}", file, line, clock.column))
        moments.append(moment)
    first = next((moment for moment in moments if moment is not None), None)
    if first is None:
        return np.full(len(stamps), np.nan), None, faults
    try:
        time = [(m - first).total_seconds() if m is not None else np.nan for m in moments]
    except TypeError:
        message = "time stamps with and without a time zone"
        return np.full(len(stamps), np.nan), None, [LogError(message, file, None, clock.column)]
    beyond = np.array([_beyond_microseconds(stamp or "") for stamp in stamps])
    start = next(k for k, moment in enumerate(moments) if moment is not None)
    return np.array(time) + (beyond - beyond[start]), first.isoformat(), faults


def _beyond_microseconds(stamp: str) -> float:
    """What a stamp says beyond the sixth decimal of its seconds, which `datetime` drops [s]."""
    found = BEYOND_MICROSECONDS.search(stamp)
    return 0.0 if found is None else float(f"0.000000{found[1]}")
