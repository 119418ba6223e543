"""Where the time of a stream's line comes from."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from thermaltool.errors import counted
from thermaltool.runtime.messages import Report

# The first so many steps between arrivals are compared with the period. What comes within LIVE
# periods is a log that is played; above EVEN it is the period itself.
GAPS, LIVE, EVEN = 20, 0.05, 0.9
Fields = Any  # list of bytes (CSV) or dict (NDJSON)


class Stamp(str):
    """A time as the lines have it, and its `seconds` from the first [s]."""

    __slots__ = ("seconds",)
    seconds: float

    def __new__(cls, text: str, seconds: float) -> Stamp:
        stamp = super().__new__(cls, text)
        stamp.seconds = seconds
        return stamp


class LineClock:
    """Gives each line its time [s], and can go on where an earlier run stopped.

    Attributes
    ----------
    written_name : str
        What a column of its times is called.
    nothing_waited : bool
        The next line has come by itself: the one before was the last that waited.
    """

    written_name = "time_s"
    nothing_waited = False

    def take_back(self) -> None:
        """The last line was no row: where lines are counted, it does not count."""

    def written(self, seconds: float) -> float | Stamp:
        """A time as it is written."""
        return seconds

    def stamp(self, fields: Fields) -> float:
        """Time of a line [s].

        Raises
        ------
        LookupError, TypeError, ValueError
            The line carries no time.
        """
        raise NotImplementedError

    def state(self) -> dict[str, Any]:
        """What `resume` needs, as JSON."""
        return {}

    def resume(self, state: dict[str, Any], last: float, age: float = 0.0) -> None:
        """Go on from a state, whose last line was at `last` [s], and `age` [s] ago.

        A clock may need no memory.
        """

    def tell(self, report: Report) -> None:
        """Where messages of the clock go."""


@dataclass
class ColumnClock(LineClock):
    """A column of numbers, times `factor` in seconds."""

    key: Any
    number: Callable[[Any], float]
    factor: float = 1.0

    def stamp(self, fields: Fields) -> float:
        seconds = self.number(fields[self.key]) * self.factor
        if not math.isfinite(seconds):
            raise ValueError("no time")
        return seconds


@dataclass
class StampClock(LineClock):
    """A column of ISO 8601 time stamps (or of a `strptime` pattern), in seconds from the first."""

    key: Any
    pattern: str | None = None
    epoch: datetime | None = None
    written_name = "time"
    _last: Stamp | None = None

    def stamp(self, fields: Fields) -> float:
        text = fields[self.key]
        text = (text.decode() if isinstance(text, bytes) else str(text)).strip()
        moment = (
            datetime.strptime(text, self.pattern) if self.pattern else datetime.fromisoformat(text)
        )
        if self.epoch is None:
            self.epoch = moment
        if (moment.tzinfo is None) != (self.epoch.tzinfo is None):
            # The same clock on the wall, which says its zone or does not.
            moment = moment.replace(tzinfo=self.epoch.tzinfo)
        seconds = (moment - self.epoch).total_seconds()
        self._last = Stamp(text, seconds)
        return seconds

    def written(self, seconds: float) -> float | Stamp:
        """The stamp of the last line, else one in its style; ISO 8601 for other patterns, too."""
        last = "" if self._last is None or self.pattern else self._last
        if isinstance(last, Stamp) and last.seconds == seconds:
            return last
        if self.epoch is None:
            return seconds
        try:
            moment = self.epoch + timedelta(seconds=seconds)
        except OverflowError:  # no such year
            return Stamp("", seconds)
        text = moment.isoformat(" " if last[10:11] == " " else "T", _digits(last))
        return Stamp(text.replace("+00:00", "Z") if last[-1:] == "Z" else text, seconds)

    def state(self) -> dict[str, Any]:
        return {} if self.epoch is None else {"epoch": self.epoch.isoformat()}

    def resume(self, state: dict[str, Any], last: float, age: float = 0.0) -> None:
        if "epoch" in state:
            self.epoch = datetime.fromisoformat(state["epoch"])


def _digits(stamp: str) -> str:
    """How many digits of a second a stamp has, as `isoformat` calls it."""
    fraction = re.search(r"[.,](\d+)", stamp)
    if fraction is None:
        return "auto"
    return "milliseconds" if len(fraction[1]) <= 3 else "microseconds"


@dataclass
class PeriodClock(LineClock):
    """No clock in the stream: lines come every `period` [s].

    The time of arrival watches over it. A line behind which nothing waits has come in its own
    time: where it is a period late, lines before it are lost, and count. Lines that come too
    quickly may be a log that is played; where they come evenly, a message says so.
    """

    period: float
    origin: float = 0.0
    count: int = -1
    monotonic: Callable[[], float] = time.monotonic
    _report: Report = field(default=lambda channel, message: None, init=False)
    _arrived: float = field(default=math.nan, init=False)
    _begin: float = field(default=math.nan, init=False)
    _begin_count: int = field(default=0, init=False)
    _lost: int = field(default=0, init=False)
    _gaps: list[float] = field(default_factory=list, init=False)

    def stamp(self, fields: Fields) -> float:
        now = self.monotonic()
        gap, before, self._arrived = now - self._arrived, self._arrived, now
        if gap != gap:
            self._begin, self._begin_count = now, self.count
        elif self.nothing_waited and gap > self.period / 2:
            self._catch_up(before)
        self.nothing_waited = False
        if len(self._gaps) < GAPS and gap == gap:
            self._gaps.append(gap)
            self._compare()
        self.count += 1
        return self.origin + self.count * self.period

    def take_back(self) -> None:
        self.count -= 1

    def _catch_up(self, arrived: float) -> None:
        """The line before was the last that waited: by its arrival so many are lost."""
        late = (arrived - self._begin) / self.period - (self.count - self._begin_count - 1)
        if late >= 1:
            self.count += int(late)
            self._lost += int(late)
            self._report("", f"{counted(int(late), 'line')} lost: counted, {self.period:g} s each")
        elif late <= -1 and self._lost:
            # They came after all: this one has no time of its own.
            self.count -= 1
            self._lost -= 1
        elif late < 0:
            self._begin += late * self.period

    def _compare(self) -> None:
        """Say where the first lines came evenly, and more quickly than by the period."""
        if len(self._gaps) == GAPS:
            low, middle, high = (sorted(self._gaps)[k * (GAPS - 1) // 4] for k in (1, 2, 3))
            if LIVE * self.period < middle < EVEN * self.period and high - low < middle / 2:
                self._report(
                    "", f"lines come each {middle:.3g} s, the period is {self.period:g} s: "
                    "a log that is played, or another --period"
                )  # fmt: skip

    def resume(self, state: dict[str, Any], last: float, age: float = 0.0) -> None:
        passed = int(max(age, 0.0) / self.period) if age == age else 0
        self.origin, self.count, self._arrived = last, passed, math.nan

    def tell(self, report: Report) -> None:
        self._report = report


@dataclass
class ArrivalClock(LineClock):
    """The time at which a line arrives, in seconds from the first, on a grid of `step` [s].

    On the grid sample lengths repeat, so their matrices are solved for once.
    """

    step: float
    monotonic: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time
    origin: float | None = field(default=None, init=False)

    def stamp(self, fields: Fields) -> float:
        now = self.monotonic()
        if self.origin is None:
            self.origin = now
        return round(round((now - self.origin) / self.step) * self.step, 9)

    def state(self) -> dict[str, Any]:
        # The monotonic clock does not survive a restart of the machine; the wall clock does.
        if self.origin is None:
            return {}
        return {"wall": self.wall() - (self.monotonic() - self.origin)}

    def resume(self, state: dict[str, Any], last: float, age: float = 0.0) -> None:
        if "wall" in state:
            self.origin = self.monotonic() - max(self.wall() - float(state["wall"]), last)
