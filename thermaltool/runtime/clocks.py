"""Where the time of a stream's line comes from."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

Fields = Any  # list of bytes (CSV) or dict (NDJSON)


class LineClock:
    """Gives each line its time [s], and can go on where an earlier run stopped."""

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

    def resume(self, state: dict[str, Any], last: float) -> None:
        """Go on from a state, whose last line was at `last` [s]; a clock may need no memory."""


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

    def stamp(self, fields: Fields) -> float:
        text = fields[self.key]
        text = (text.decode() if isinstance(text, bytes) else str(text)).strip()
        moment = (
            datetime.strptime(text, self.pattern) if self.pattern else datetime.fromisoformat(text)
        )
        if self.epoch is None:
            self.epoch = moment
        return (moment - self.epoch).total_seconds()

    def state(self) -> dict[str, Any]:
        return {} if self.epoch is None else {"epoch": self.epoch.isoformat()}

    def resume(self, state: dict[str, Any], last: float) -> None:
        if "epoch" in state:
            self.epoch = datetime.fromisoformat(state["epoch"])


@dataclass
class PeriodClock(LineClock):
    """No clock in the stream: lines come every `period` [s]."""

    period: float
    origin: float = 0.0
    count: int = -1

    def stamp(self, fields: Fields) -> float:
        self.count += 1
        return self.origin + self.count * self.period

    def resume(self, state: dict[str, Any], last: float) -> None:
        self.origin, self.count = last, 0


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

    def resume(self, state: dict[str, Any], last: float) -> None:
        if "wall" in state:
            self.origin = self.monotonic() - max(self.wall() - float(state["wall"]), last)
