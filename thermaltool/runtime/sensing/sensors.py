"""The readings of one sensor: taken when good, held while bad, lost when bad for too long."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermaltool.estimation.permanent_effects import StaticMap, apply_maps
from thermaltool.estimation.plausible_change import CHANGE_MARGIN
from thermaltool.model import MARGIN
from thermaltool.runtime.messages import Report
from thermaltool.runtime.sensing.frozen import FrozenCheck
from thermaltool.runtime.settings import ANYTHING, Interval

# Where nothing says how fast a reading can change, a restart on another clock goes on where it
# differs by no more than this part of the range that the calibration has seen.
DISAGREEMENT = 0.1


def widened(span: Interval, part: float) -> Interval:
    """An interval with `part` of its width added on both sides; everything, if it has no width."""
    low, high = span
    width = part * (high - low)
    return (low - width, high + width) if width > 0 else ANYTHING


@dataclass
class SensorChannel:
    """Readings of one sensor channel, with the last good one held in the place of bad ones.

    Attributes
    ----------
    channel : str
    rest : float [unit of the channel]
        The reading at rest; NaN where the first good reading is taken for it.
    calibrated : (float, float) [unit of the channel]
        Readings, relative to rest, that the calibration has seen; to leave it is reported.
    bounds : (float, float) or None
        Readings outside are bad, as is NaN. None for the calibrated range, widened by its own
        width to both sides.
    hold : float [s]
        How long the last good value stands in for bad readings.
    frozen_after : float [s]
        A reading that is bit-identical for longer than this is bad.
    report : callable
        Gets one message per change of state.
    back : tuple of callable
        From a reading to the truth behind it, both relative to rest. Bounds that the user does
        not give, and what the calibration has seen, are of the truth.
    at_rest : bool
        A machine at rest reads rest here.
    surrounds : bool
        A temperature that drives: a machine at rest has that of its surroundings, whatever it is.
    reach : callable
        The largest change that the machine can make within a time [s], in the unit of the channel.
        A reading that changes by more has jumped, and is bad until it jumps back.
    consequence : str
        What comes of a sensor that is lost.
    frozen : FrozenCheck
        Whether readings stand still although they should be noisy.
    value : float
        The last good reading; NaN before the first.
    truth : float
        What is behind it.
    good_at, changed_at : float [s]
        When the last good reading came, and since when readings have been identical.
    jumped : float
        By how much the readings have jumped, and not yet back.
    held, lost, extrapolates : bool
    """

    channel: str
    rest: float = 0.0
    calibrated: Interval = ANYTHING
    bounds: Interval | None = None
    hold: float = 10.0
    frozen_after: float = math.inf
    report: Report = lambda channel, message: None
    back: tuple[StaticMap, ...] = ()
    at_rest: bool = True
    surrounds: bool = False
    reach: Callable[[float], float] = lambda seconds: math.inf
    frozen: FrozenCheck = field(default_factory=FrozenCheck)
    consequence: str = "safe setpoint"
    value: float = field(default=math.nan, init=False)
    truth: float = field(default=math.nan, init=False)
    good_at: float = field(default=-math.inf, init=False)
    changed_at: float = field(default=-math.inf, init=False)
    held: bool = field(default=False, init=False)
    lost: bool = field(default=False, init=False)
    extrapolates: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._low, self._high = self.bounds or ANYTHING
        self._seen = self._usable = ANYTHING
        self._first_rest = self.rest
        # The last number that was read, good or bad, and when it was first read.
        self._read, self._read_at = math.nan, -math.inf
        self.jumped = 0.0
        self._settle(self.rest)

    def _settle(self, rest: float) -> None:
        """Take `rest` for the reading at rest, once it is known."""
        self.rest = rest
        if math.isfinite(rest):
            low, high = widened(self.calibrated, MARGIN)
            self._seen = low + rest, high + rest
            if self.bounds is None:
                low, high = widened(self.calibrated, 1.0)
                self._usable = low + rest, high + rest

    def take(self, time: float, reading: float, fault: str = "") -> None:
        """A reading at `time` [s]; NaN with the `fault` that made it unreadable."""
        truth = self._behind(reading) if self.back else reading
        low, high = self._usable
        inside = self._low <= reading <= self._high and low <= truth <= high
        if not (inside and math.isfinite(truth)):
            self._miss(time, fault or self._fault(reading, truth))
            return
        if self._jumps(time, truth):
            self._miss(
                time,
                f"jumps by {self.jumped:+.3g}, which the machine cannot: bad until it comes back",
            )
            return
        if reading != self.value:
            self.frozen.moves(reading - self.value)
            self.value, self.truth, self.changed_at = reading, truth, time
            if self.rest != self.rest:
                self._settle(reading)
            if self.extrapolates == (self._seen[0] <= truth <= self._seen[1]):
                self._cross(reading)
        elif self.frozen.repeats() or time - self.changed_at > self.frozen_after:
            self._miss(time, f"frozen at {reading!r} for {time - self.changed_at:g} s")
            return
        if self.held:
            self.report(self.channel, "good again")
            self.held = self.lost = False
        self.good_at = time

    def _jumps(self, time: float, truth: float) -> bool:
        """Whether what is behind the reading stands where a jump has put it."""
        # A sensor that stood still may have been frozen: then the machine went on meanwhile.
        step, elapsed = truth - self._read, time - self._read_at
        if step:
            self._read, self._read_at = truth, time
        jumps = abs(step) > self.reach(elapsed)
        if jumps:
            self.jumped += step
        if self.jumped:
            reach, away = self.reach(time - self.good_at), abs(truth - self.truth)
            # It comes back by a jump, after a long silence, or slowly: then while the machine
            # cannot yet have gone half of the way itself.
            half = abs(self.jumped) / 2
            slowly = reach / CHANGE_MARGIN <= half and away <= half
            if away <= reach and (jumps or elapsed > self.hold or slowly):
                self.jumped = 0.0
        return self.jumped != 0.0

    def agrees(self, reading: float, elapsed: float) -> bool:
        """Whether a reading can follow the last good one after so long [s].

        Parameters
        ----------
        reading : float
        elapsed : float [s]
        """
        reach = self.reach(elapsed)
        if reach == math.inf:
            reach = DISAGREEMENT * (self.calibrated[1] - self.calibrated[0])
        return abs(reading - self.value) <= reach

    @property
    def unused(self) -> float:
        """By how much what is read now differs from what is used."""
        return self._read - self.truth

    def clear(self) -> None:
        """Take the reading again, as others confirm it: what jumped was its return."""
        self.jumped = 0.0

    def forget(self) -> None:
        """Nothing has been read yet."""
        self.value = self.truth = self._read = math.nan
        self.good_at = self.changed_at = self._read_at = -math.inf
        self.held = self.lost = self.extrapolates = False
        self.jumped = 0.0
        self.frozen.forget()
        self._settle(self._first_rest)

    def _behind(self, reading: float) -> float:
        """The truth behind a reading; the first one stands for rest where that is not known."""
        rest = reading if math.isnan(self.rest) else self.rest
        return rest + float(apply_maps(self.back, np.array(reading - rest)))

    def _fault(self, reading: float, truth: float) -> str:
        """Why a reading is not used."""
        if not math.isfinite(reading):
            return "not finite"
        if not math.isfinite(truth):
            return f"out of range: no truth gives {reading:g}"
        if not self._low <= reading <= self._high:
            return f"out of range: {reading:g} not in {self._low:g}..{self._high:g}"
        low, high = self._usable
        behind = f" ({truth:g})" if self.back else ""
        return f"out of range: {reading:g}{behind} not in {low:g}..{high:g}"

    def _cross(self, reading: float) -> None:
        """The reading has crossed the border of what the calibration has seen."""
        self.extrapolates = not self.extrapolates
        if self.extrapolates:
            self.report(
                self.channel, f"{reading:g} is outside the calibrated range: the model extrapolates"
            )

    def _miss(self, time: float, fault: str) -> None:
        away = time - self.good_at
        if away > self.hold:
            if not self.lost:
                since = f"no good reading for {away:g} s" if away < math.inf else "none good yet"
                self.report(self.channel, f"{fault}: {since}: {self.consequence}")
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
            "jumped": self.jumped,
            "read": [self._read, self._read_at],
            "frozen": self.frozen.state(),
        }

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from `state`; raises KeyError, TypeError or ValueError where it is none."""
        if state:
            self.value = float(state["value"])
            self.good_at, self.changed_at = float(state["good_at"]), float(state["changed_at"])
            self.jumped = float(state.get("jumped", 0.0))
            if "frozen" in state:
                self.frozen.resume(state["frozen"])
            self._read, self._read_at = map(float, state.get("read", (self.value, self.good_at)))
            self._settle(float(state["rest"]))
            self.truth = self._behind(self.value)

    def shift(self, seconds: float) -> None:
        """The clock was set: past times move along."""
        self.good_at += seconds
        self.changed_at += seconds
        self._read_at += seconds
