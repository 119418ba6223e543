"""Guesses of a foreign clock: which column, its unit or the pattern of its stamps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import pairwise

import numpy as np

from thermaltool.logs.columns import Clock
from thermaltool.logs.foreign_units import known_unit
from thermaltool.logs.time_stamps import MIDNIGHT, joined_stamps
from thermaltool.record import Array
from thermaltool.units import UNITS, clock_unit

Texts = Sequence[str | None]

_NAMES = re.compile(
    r"time|zeit|date|datum|uhr|stamp|elapsed|epoch|x_value|(^|\.)ts?$|^t_(m?s|min|h)$|^t ?[\[(/]|"
    r"^x$|params\.1$|^(temps|dur[eé]e|heure|tempo|tiempo|hora|tid|tijd)\b",
    re.IGNORECASE,
)
_DATES = (
    *("%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y"),
    *("%d.%m.%y", "%d/%m/%y", "%m/%d/%y", "%Y%m%d"),
)
_TIMES = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
_BETWEEN = (" ", "-", ", ", "_", "T")
# Counted since 1970: numbers above, and their unit.
_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (5e8, "s"))
# Days as a workbook and as MATLAB count them, in this century.
_DAYS = ((36_000.0, 60_000.0), (730_000.0, 770_000.0))
# A clock goes back in this part of its steps at most.
MOST_BACKWARD = 0.05
# Stamps that a pattern is tried on.
MAX_TRIED = 200


def guess_clock(
    texts: Mapping[str, Texts], numbers: Mapping[str, Array]
) -> tuple[Clock, str] | None:
    """The clock among the columns, and why; None where there is none.

    Parameters
    ----------
    texts : mapping of str to sequence of str or None
        Columns that hold no numbers.
    numbers : mapping of str to ndarray, shape (n,)
    """
    unit = clock_unit([*texts, *numbers])
    own = None if unit is None else "time" if unit == "iso" else f"time_{unit}"
    by_name = [name for name in (*texts, *numbers) if _NAMES.search(name)]
    by_name.sort(key=lambda name: name != own)
    others = [name for name in texts if name not in by_name]
    for name in (*by_name, *others):
        if name in numbers:
            found = _of_numbers(name, numbers[name])
        else:
            found = _pair(name, texts) or _of_stamps(name, None, texts[name])
        if found is not None:
            return found
    return None


def _of_numbers(name: str, values: Array) -> tuple[Clock, str] | None:
    present = values[np.isfinite(values)]
    # What goes back now and then is a clock of which `check` says so.
    backward = float(np.mean(np.diff(present) < 0)) if len(present) > 1 else 1.0
    if (unit := clock_unit([name])) not in (None, "iso"):
        return Clock(name, unit), f"{unit} by its name"
    if backward > MOST_BACKWARD or present[0] == present[-1]:
        return None
    first, step = float(present[0]), float(np.median(np.diff(present)))
    for word in reversed(re.findall(r"[A-Za-zµμ]+", name)):
        found = known_unit(word)
        if found is None or word.lower() == name.lower():
            continue
        if UNITS[found[0]][0] == "time":
            return Clock(name, found[0]), f"{found[0]} by its name"
        if UNITS[found[0]][0].startswith("temperature"):
            return None
    for limit, own in _EPOCHS:
        if first > limit:
            return Clock(name, own), f"guessed: {own} since 1970 from {first:.10g}"
    if step < 1 and any(low < first < high for low, high in _DAYS):
        return Clock(name, "d"), f"guessed: days from {first:.10g}"
    return Clock(name, "s"), f"guessed: s from steps of {step:g}"


def _pair(name: str, texts: Mapping[str, Texts]) -> tuple[Clock, str] | None:
    """A date in one column and the time of day in another."""
    dates = _some(texts[name])
    if not dates or any(re.search(r"\d:\d", each.removesuffix(MIDNIGHT)) for each in dates):
        return None
    for other, times in texts.items():
        some = _some(times)
        if other != name and some and all(re.match(r"\d?\d:\d\d", each) for each in some):
            joined = joined_stamps(list(texts[name]), list(times))
            if (found := _of_stamps(name, other, joined)) is not None:
                return found
    return None


def _of_stamps(name: str, joined: str | None, stamps: Texts) -> tuple[Clock, str] | None:
    tried = _some(stamps)
    if not tried:
        return None
    if _moments(tried, None) is not None:
        return Clock(name, "iso", joined=joined), "ISO 8601"
    found: dict[str, list[datetime]] = {}
    for date in (*_DATES, ""):
        for between in _BETWEEN if date else ("",):
            for time in _TIMES:
                pattern = f"{date}{between}{time}"
                if (moments := _moments(tried, pattern)) is not None:
                    found[pattern] = moments
    if not found:
        return None
    # A day for a month leaps, or goes back: the shortest increasing record is the right one.
    best = min(found, key=lambda each: (_backward(found[each]), _length(found[each])))
    alike = any(
        other != best
        and (_backward(m), _length(m)) == (_backward(found[best]), _length(found[best]))
        for other, m in found.items()
    )
    reason = f"guessed from {tried[0]!r}" + (": is that day before month?" if alike else "")
    return Clock(name, "iso", format=best, joined=joined), reason


def _some(texts: Texts) -> list[str]:
    stamps = [each.strip() for each in texts if each is not None and each.strip()]
    if len(stamps) <= MAX_TRIED:
        return stamps
    return stamps[: MAX_TRIED // 2] + stamps[-MAX_TRIED // 2 :]


def _moments(stamps: Sequence[str], pattern: str | None) -> list[datetime] | None:
    try:
        if pattern is None:
            return [datetime.fromisoformat(each) for each in stamps]
        return [datetime.strptime(each, pattern) for each in stamps]
    except ValueError:
        return None


def _backward(moments: Sequence[datetime]) -> int:
    return sum(after < before for before, after in pairwise(moments))


def _length(moments: Sequence[datetime]) -> float:
    return abs((moments[-1] - moments[0]).total_seconds())
