"""Messages of one sensor each, or other partial lines, to rows: the rule of logs, line by line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from thermaltool.logs.duplicates import of_one_time
from thermaltool.runtime.rows.row import MISSING, Row

# A row that was kept is gone on with where the first message comes within so many periods.
KEPT_PERIODS = 5
# A stream begins amid the messages of a time: so many periods the first whole row is waited for.
START_PERIODS = 5


@dataclass
class Merger:
    """Makes one row of the partial rows of one time, as `merged` does with those of a log.

    A row leaves when every sensor has come, when a message of another time comes, or when the
    computer has waited a period for the rest. What comes after it of its time is left out. Sensors
    that have not come are missing. The first row is a whole one, where one comes soon.

    Parameters
    ----------
    sensors : int
    within : float [s]
        Messages up to so long before or after the first of them are of its time.
    mean : bool
        Whether a row has the mean of what a sensor says in its time; else the first. A row of
        means does not leave before its time has ended.
    period : float [s]
        How long the computer waits.
    now : callable
        Seconds of the computer.

    Attributes
    ----------
    due : float
        When the row that waits has to leave, by `now`; inf where none waits.
    """

    sensors: int
    within: float = 0.0
    mean: bool = False
    period: float = 1.0
    now: Callable[[], float] = monotonic
    due: float = field(default=math.inf, init=False)
    _first: float | None = field(default=None, init=False)
    _sums: list[float] = field(default_factory=list, init=False)
    _counts: list[int] = field(default_factory=list, init=False)
    _faults: list[str] = field(default_factory=list, init=False)
    _waits: bool = field(default=False, init=False)
    _kept: bool = field(default=False, init=False)
    _begin_at: float = field(default=math.nan, init=False)
    _started: bool = field(default=False, init=False)

    def take(self, row: Row) -> list[Row]:
        """The rows that a partial row completes; one without a time is passed on as it is."""
        time = row.time
        if time is None or not math.isfinite(time):
            return [row]
        done = []
        if self._first is None or not of_one_time(self._first, time, self.within):
            if self._kept and not 0 <= time - self._first_time() <= KEPT_PERIODS * self.period:
                # The clock began anew, or after a pause: the row is of another time.
                self._waits = False
            done = self.flush()
            self._begin(time)
        self._kept = False
        if self._waits:
            self._add(row)
            if not self.mean and all(self._counts):
                done += self.flush()
        return done

    def flush(self) -> list[Row]:
        """The row that waits, or none."""
        if not self._waits:
            return []
        self._waits, self.due = False, math.inf
        if not self._starts():
            return []
        readings = [
            total / count if count else math.nan
            for total, count in zip(self._sums, self._counts, strict=True)
        ]
        return [Row(self._first, readings, tuple(self._faults))]

    def _starts(self) -> bool:
        """Whether rows leave: a whole one has, or is about to, or none comes soon."""
        if not self._started:
            late = not 0 <= self._first_time() - self._begin_at < START_PERIODS * self.period
            self._started = all(self._counts) or late
        return self._started

    def _first_time(self) -> float:
        return -math.inf if self._first is None else self._first

    def _begin(self, time: float) -> None:
        self._first, self._waits = time, True
        if math.isnan(self._begin_at):
            self._begin_at = time
        self._sums, self._counts = [0.0] * self.sensors, [0] * self.sensors
        self._faults = [MISSING] * self.sensors
        self.due = self.now() + self.period

    def _add(self, row: Row) -> None:
        for k, (reading, fault) in enumerate(zip(row.readings, row.faults, strict=True)):
            if math.isnan(reading):
                if not self._counts[k] and fault != MISSING:
                    self._faults[k] = fault
            elif not self._counts[k] or self.mean:
                self._sums[k] += reading
                self._counts[k] += 1
                self._faults[k] = ""

    def state(self) -> dict[str, Any] | None:
        """For `resume`, as JSON; None before the first message."""
        if self._first is None:
            return None
        parts = [[*self._sums], [*self._counts], [*self._faults]]
        return {"first": self._first, "waits": self._waits, "parts": parts}

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from a state; raises KeyError, TypeError or ValueError where it is none."""
        sums, counts, faults = state["parts"]
        if not len(sums) == len(counts) == len(faults) == self.sensors:
            raise ValueError("not a state of these sensors")
        self._sums, self._counts = [float(each) for each in sums], [int(each) for each in counts]
        self._faults = [str(each) for each in faults]
        self._first, self._waits = float(state["first"]), bool(state["waits"])
        self._kept = self._started = True
        self.due = self.now() + self.period if self._waits else math.inf
