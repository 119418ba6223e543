"""RowReader in, setpoints out: estimator, held readings, safe state. No input or output here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from thermaltool.control.setpoint import Setpoint
from thermaltool.model import NOT_AT_REST, away_from_rest
from thermaltool.responses.modes import CLOCK_STEP
from thermaltool.runtime.records import Row
from thermaltool.runtime.sensors import Report, Sensor
from thermaltool.runtime.stepper import Steps

Pass = Callable[[list[float]], list[float]]

# A clock that jumps ahead by more than this [s] is doubted, as one that goes back.
DOUBTED_PAUSE = 7200.0
# A pause beyond this [s] is none: the clock was set.
LONGEST_PAUSE = 1e7


@dataclass(frozen=True)
class Policy:
    """What the compensator does in which case.

    Attributes
    ----------
    sign : float
        The setpoint is `sign` times the deflection.
    safe : float [unit of the setpoint] or None
        The safe setpoint; None holds the one before.
    hold : float [s]
        A clock that went back is refused for this long, then followed.
    max_gap : float [s]
        A longer pause is told.
    slew_gap : float [s]
        A longer pause counts as this long for the slew rate.
    settled : bool
        The machine has stood at the first readings for long; else it is at rest there.
    """

    sign: float = -1.0
    safe: float | None = 0.0
    hold: float = 10.0
    max_gap: float = math.inf
    slew_gap: float = math.inf
    settled: bool = False


class Compensator:
    """The state of a stream.

    Parameters
    ----------
    stepper : Steps
    sensors : sequence of Sensor
        In the order of the estimator.
    followed : sequence of int
        Which estimates the setpoints cancel.
    setpoints : sequence of Setpoint
        One per entry of `followed`.
    policy : Policy
    report : callable
        Gets (channel, message) once per change of state.
    inputs, told : callable
        From the readings of a sample to what the estimator takes, and from its estimates to what
        is told and followed.

    Attributes
    ----------
    time : float [s] or None
        Of the last record that was accepted.
    accepted : int
        RowReader that moved the clock.
    estimates : list of float
    """

    def __init__(
        self,
        stepper: Steps,
        sensors: Sequence[Sensor],
        followed: Sequence[int],
        setpoints: Sequence[Setpoint],
        policy: Policy,
        report: Report,
        inputs: Pass = lambda values: values,
        told: Pass = lambda values: values,
    ) -> None:
        self.stepper, self.sensors, self.setpoints = stepper, sensors, setpoints
        self.policy, self.report, self._told = policy, report, told
        self._inputs = inputs
        self._targets = list(zip(followed, setpoints, strict=True))
        self.time: float | None = None
        self.accepted = 0
        self.estimates: list[float] = stepper.rest()
        self._started = False
        self._moved_at = -math.inf
        self._refused_from: float | None = None

    def take(self, record: Row) -> None:
        """Advance by one record; a refused one leaves everything as it is."""
        time = record.time
        ticks = 0
        if time is None:
            self.report("", "no time on this line: ignored")
            return
        if self.time is not None:
            ticks = self._ticks(time)
            if not ticks:
                return
        self.time = time
        self.accepted += 1
        lost = False
        for sensor, reading, fault in zip(
            self.sensors, record.readings, record.faults, strict=True
        ):
            sensor.take(time, reading, fault)
            lost = lost or sensor.lost
        readings = [sensor.truth - sensor.rest for sensor in self.sensors]
        self._estimate(ticks, readings)
        self._move(time, lost or not self._started)

    def _estimate(self, ticks: int, readings: list[float]) -> None:
        """Go on, or start from rest as soon as every sensor has given a reading."""
        inputs = self._inputs(readings)
        if self._started:
            self.estimates = self._told(self.stepper.step(ticks, inputs))
            if math.isfinite(sum(self.estimates)):
                return
            self.report("", "the estimates are not finite: started again from rest")
        self._started = all(map(math.isfinite, inputs))
        if not self._started:
            self.estimates = self.stepper.rest()
            return
        self.estimates = self._told(self.stepper.start(inputs, self.policy.settled))
        settled = self.policy.settled
        for sensor, reading in zip(self.sensors, readings, strict=True):
            if not settled and sensor.at_rest and away_from_rest(reading, sensor.calibrated):
                self.report(sensor.channel, f"{sensor.value:g} at the start {NOT_AT_REST}")

    def _ticks(self, time: float) -> int:
        """Clock steps since the last record; 0 where the record has to be refused.

        A clock that stays refused for longer than the hold was set anew, and is followed.
        """
        assert self.time is not None
        pause = time - self.time
        if CLOCK_STEP / 2 < pause < DOUBTED_PAUSE:
            self._refused_from = None
            if pause > self.policy.max_gap:
                self.report("", f"a pause of {pause:g} s")
            return round(pause / CLOCK_STEP)
        if self._refused_from is None or time < self._refused_from:
            self._refused_from = time
            self.report("", f"time {time:.15g} s after {self.time:.15g} s: line ignored")
        elapsed = time - self._refused_from
        if not self.policy.hold < elapsed < DOUBTED_PAUSE:
            return 0
        if 0 < pause < LONGEST_PAUSE:
            self.report("", f"a pause of {pause:g} s")
            self._refused_from = None
            return round(pause / CLOCK_STEP)
        self.report("", f"the clock was set from {self.time:.15g} s to {time:.15g} s: followed")
        for sensor in self.sensors:
            sensor.shift(self._refused_from - self.time)
        self._moved_at += self._refused_from - self.time
        self._refused_from = None
        return round(elapsed / CLOCK_STEP)

    def _move(self, time: float, safe: bool) -> None:
        dt = min(max(time - self._moved_at, 0.0), self.policy.slew_gap)
        self._moved_at = time
        for at, setpoint in self._targets:
            target = self._safe(setpoint) if safe else self.policy.sign * self.estimates[at]
            setpoint.move(target, dt)

    def _safe(self, setpoint: Setpoint) -> float:
        return setpoint.value if self.policy.safe is None else self.policy.safe

    def silence(self, elapsed: float) -> float | None:
        """Move towards the safe setpoint, `elapsed` [s] after the last record.

        Returns the time that this answers for.
        """
        if self.time is None:
            return None
        self._move(self.time + elapsed, True)
        return self.time + elapsed

    @property
    def at_safe(self) -> bool:
        """Whether every setpoint has reached the safe one."""
        return all(s.ramp == s.limits.clip(self._safe(s)) for s in self.setpoints)

    def finish(self) -> None:
        """The safe setpoint at once: nothing comes after it."""
        for setpoint in self.setpoints:
            setpoint.jump(self._safe(setpoint))

    def values(self) -> list[float]:
        return [setpoint.value for setpoint in self.setpoints]

    def state(self) -> dict[str, Any]:
        """All that a restart needs, as JSON."""
        return {
            "time_s": self.time,
            "started": self._started,
            "estimator": self.stepper.state(),
            "estimates": self.estimates,
            "sensors": [sensor.state() for sensor in self.sensors],
            "setpoints": [[s.value, s.ramp] for s in self.setpoints],
        }

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from `state`.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not one of this compensator.
        """
        self.stepper.resume(state["estimator"])
        self.estimates = [float(value) for value in state["estimates"]]
        self._started = bool(state["started"])
        for sensor, kept in zip(self.sensors, state["sensors"], strict=True):
            sensor.resume(kept)
        for setpoint, (value, ramp) in zip(self.setpoints, state["setpoints"], strict=True):
            setpoint.resume(float(value), float(ramp))
        self.time = None if state["time_s"] is None else float(state["time_s"])
        self._moved_at = -math.inf if self.time is None else self.time
