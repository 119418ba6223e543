"""The readings of one sensor: taken when good, held while bad, lost when bad for too long."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

Report = Callable[[str, str], None]  # (channel, message)


@dataclass
class Sensor:
    """One sensor channel.

    Attributes
    ----------
    channel : str
    low, high : float [unit of the channel]
        Readings outside are bad; so is NaN.
    rest : float [unit of the channel]
        The reading at rest; NaN where the first good reading is taken for it.
    about_rest : (float, float) or None
        `low` and `high` relative to such a first reading.
    hold : float [s]
        How long the last good value stands in for bad readings.
    frozen_after : float [s]
        A reading that is bit-identical for longer than this is bad.
    report : callable
        Gets one message per change of state.
    value : float
        The last good reading; NaN before the first.
    good_at, changed_at : float [s]
        When the last good reading came, and since when readings have been identical.
    """

    channel: str
    low: float = -math.inf
    high: float = math.inf
    hold: float = 10.0
    frozen_after: float = math.inf
    report: Report = lambda channel, message: None
    rest: float = 0.0
    about_rest: tuple[float, float] | None = None
    value: float = math.nan
    good_at: float = -math.inf
    changed_at: float = -math.inf
    held: bool = field(default=False, init=False)
    lost: bool = field(default=False, init=False)

    def take(self, time: float, reading: float, fault: str = "") -> None:
        """A reading at `time` [s]; NaN with the `fault` that made it unreadable."""
        if self.low <= reading <= self.high:
            if reading != self.value:
                self.value, self.changed_at = reading, time
                if self.rest != self.rest:
                    self._settle(reading)
            elif time - self.changed_at > self.frozen_after:
                self._miss(time, f"frozen at {reading!r} for {time - self.changed_at:g} s")
                return
            if self.held:
                self.report(self.channel, "good again")
                self.held = self.lost = False
            self.good_at = time
            return
        if not fault:
            inside = f"not in {self.low:g}..{self.high:g}"
            fault = f"out of range: {reading:g} {inside}" if math.isfinite(reading) else "no number"
        self._miss(time, fault)

    def _settle(self, rest: float) -> None:
        self.rest = rest
        if self.about_rest:
            self.low, self.high = (rest + end for end in self.about_rest)

    def _miss(self, time: float, fault: str) -> None:
        away = time - self.good_at
        if away > self.hold:
            if not self.lost:
                since = f"no good reading for {away:g} s" if away < math.inf else "none good yet"
                self.report(self.channel, f"{fault}: {since}: safe setpoint")
            self.lost = True
        elif not self.held:
            self.report(self.channel, f"{fault}: holding {self.value!r}")
        self.held = True

    def state(self) -> dict[str, Any]:
        """What a restart needs, without infinities: JSON has none."""
        if self.good_at == -math.inf:
            return {}
        return {
            "value": self.value,
            "rest": self.rest,
            "good_at": self.good_at,
            "changed_at": self.changed_at,
        }

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from `state`; raises KeyError, TypeError or ValueError where it is none."""
        if state:
            self.value = float(state["value"])
            self.good_at, self.changed_at = float(state["good_at"]), float(state["changed_at"])
            self._settle(float(state["rest"]))

    def shift(self, seconds: float) -> None:
        """The clock was set: past times move along."""
        self.good_at += seconds
        self.changed_at += seconds
