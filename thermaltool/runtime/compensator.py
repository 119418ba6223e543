"""Rows in, setpoints out: estimator, held readings, safe state. No input or output here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from thermaltool import status
from thermaltool.control.setpoint import Limits, Setpoint
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.clock_check import ClockCheck
from thermaltool.runtime.messages import Report
from thermaltool.runtime.policy import Policy
from thermaltool.runtime.process import Process, Reply
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.sensing.sensors import SensorChannel
from thermaltool.runtime.sensing.vote import Vote
from thermaltool.runtime.stepper import Steps
from thermaltool.runtime.unknown_state import UnknownState, contradicts_rest, where_it_begins

if TYPE_CHECKING:
    from thermaltool.runtime.monitor import Monitor

# A row of such a status says nothing of whether model and machine agree.
NOT_TESTED = status.SAFE, status.HELD, status.REDUCED
Pass = Callable[[list[float]], list[float]]


class SetpointProcess(Process):
    """The process of every stream that moves an actuator.

    Parameters
    ----------
    stepper : Steps
    sensors : sequence of SensorChannel
        In the order of the stepper.
    followed : sequence of int
        Which estimates the setpoints follow.
    setpoints : sequence of Setpoint
        One per entry of `followed`.
    policy : Policy
    clock : ClockCheck
    report : callable
        Gets (channel, message) once per change of state.
    names : sequence of str
        Of the setpoints.
    estimates : sequence of str
        Names of the estimates where they are written too; empty where they are not.
    with_status : bool
        Whether the status is written too.
    patience, clock_advice, digest, summary
        As for `Process`.
    vote, monitor : Vote, Monitor or None
        Of the sensors, where the stepper predicts each from the others.
    reduced : sequence of Limits
        For each set point while a sensor is left out.
    inputs, outputs : callable or None
        From the readings of a sample to what the stepper takes, and from its estimates to those
        that are written and followed; None where they are the same.

    Attributes
    ----------
    estimates : list of float
    """

    actuates = True

    def __init__(
        self,
        stepper: Steps,
        sensors: Sequence[SensorChannel],
        followed: Sequence[int],
        setpoints: Sequence[Setpoint],
        policy: Policy,
        clock: ClockCheck,
        report: Report,
        *,
        names: Sequence[str],
        estimates: Sequence[str] = (),
        with_status: bool = False,
        patience: float = math.inf,
        clock_advice: str = Process.clock_advice,
        digest: str = "",
        summary: Callable[[], str] = lambda: "",
        inputs: Pass | None = None,
        outputs: Pass | None = None,
        vote: Vote | None = None,
        reduced: Sequence[Limits] = (),
        monitor: Monitor | None = None,
    ) -> None:
        self.stepper, self.sensors, self.setpoints = stepper, sensors, setpoints
        self.policy, self.clock, self.report = policy, clock, report
        self.columns = tuple(sensor.channel for sensor in sensors)
        beside = (*estimates, *(monitor.names if monitor else ()))
        self.names = (*names, *beside, *[status.STATUS] * with_status)
        self._estimates_too, self._status_too = bool(estimates), with_status
        self.period, self.patience = policy.period, patience
        self.clock_advice, self.digest, self._summary = clock_advice, digest, summary
        self._inputs, self._outputs = inputs, outputs
        self._vote, self._reduced, self._monitor = vote, reduced, monitor
        self._without: int | None = None
        self._out: set[int] = set()
        self._unsure, self._settles = UnknownState(stepper.settling_time), False
        self._targets = list(zip(followed, setpoints, strict=True))
        self.estimates: list[float] = stepper.rest()
        self._started, self._moved_at = False, -math.inf
        self.begins = where_it_begins(self.sensors, policy.settled)
        self.status = status.SAFE
        # Age [s] of a resumed state, until a row shows that it belongs to it.
        self._age: float | None = None
        self._doubted = math.inf
        clock.on_set = self._shift

    def take(self, row: Row) -> Reply | None:
        """The reply to a row, as `Process.take`; a state that was kept has to fit the first."""
        if self._age is not None and row.time is not None and math.isfinite(row.time):
            if not self._follows(row, row.time, self._age):
                return self.repeat()
            self._age = None
            self.status = status.RESUMED
        return super().take(row)

    def step(self, row: Row, seconds: float) -> Reply:
        """Setpoints, and estimates if they are wanted, after a row."""
        assert row.time is not None
        time = row.time
        for sensor, reading, fault in zip(self.sensors, row.readings, row.faults, strict=True):
            sensor.take(time, reading, fault)
        lost = self._leave_out()
        self._wait(seconds, lost)
        readings = [sensor.truth - sensor.rest for sensor in self.sensors]
        self._estimate(round(seconds / CLOCK_STEP), readings, lost)
        # From a wrong start every filter foretells wrong readings: no sensor is to blame.
        if self._vote is not None and self._started and not self._unsure.lasts:
            self._vote.take(seconds, self.stepper.residuals)
            for k, (sensor, residual) in enumerate(
                zip(self.sensors, self.stepper.residuals, strict=True)
            ):
                if sensor.jumped and self._vote.clears(k, seconds, residual + sensor.unused):
                    sensor.clear()
        safe = lost or not self._started
        self._move(time, safe)
        self.status = self._state_of(safe)
        if self.status == status.SETTLES and not self._settles:
            left = self._unsure.left
            how = f": about {left:.3g} s of readings" if left < math.inf else ", and never ends"
            self.report("", f"the estimate settles{how}")
        self._settles = self._unsure.lasts
        return time, self._written()

    def _leave_out(self) -> bool:
        """Leave out what is lost or voted out; whether the others do not suffice."""
        stepper = self.stepper
        out = {k for k, sensor in enumerate(self.sensors) if sensor.lost}
        against = None if self._vote is None else self._vote.against
        if against is not None:
            out.add(against)
        stepper.out = out
        enough = stepper.can_do_without(out)
        left_out = stepper.left_out if enough and not out else next(iter(out), None)
        if enough and left_out != self._without:
            if left_out is None:
                self.report("", "all sensors count again")
            else:
                sensor = self.sensors[left_out]
                told = left_out == against and not sensor.lost
                why = ": the others contradict it" if told else ""
                self.report(sensor.channel, f"left out{why}, the others go on")
            self._without = left_out
        if enough and out - self._out and (cost := stepper.cost(out)):
            self.report("", cost)
        self._out = out
        return not enough

    def _wait(self, seconds: float, lost: bool) -> None:
        """So long after the sample before: what the estimate may not know of it."""
        # A pause that readings are held over is none, but for a while only.
        assert self.time is not None
        stale = any(
            sensor.held and self.time - sensor.good_at > self.patience
            for k, sensor in enumerate(self.sensors)
            if k not in self.stepper.out
        )
        blind = seconds if lost or stale else max(seconds - self.patience, 0.0)
        if self._started:
            self._unsure.reads(seconds - blind)
            self._unsure.blind(blind)

    def _state_of(self, safe: bool) -> str:
        """What a row's reply rests on."""
        if safe:
            return status.SAFE
        if self._without is not None:
            return status.REDUCED
        if any(sensor.held for sensor in self.sensors):
            return status.HELD
        if self._unsure.lasts:
            return status.SETTLES
        if self._monitor and self._monitor.alarm:
            return status.PARTED
        if self.accepted == 1 and self.status == status.RESUMED:
            return status.RESUMED
        return status.EXTRAPOLATES if any(s.extrapolates for s in self.sensors) else status.OK

    def _follows(self, row: Row, time: float, age: float) -> bool:
        """Whether rows go on from the state that was kept; where they do not, it is forgotten.

        A clock that goes on says so itself. One that begins anew is known by two lines; then the
        wall clock says how long ago the state was, and the readings have to follow from it.
        """
        assert self.time is not None
        if 0 < time - self.time <= self.policy.max_age:
            self.clock.known_pause = self.policy.kept_every + (age if age > 0 else 0.0)
            return True
        after, self._doubted = time - self._doubted, time
        if not 0 < after <= self.policy.max_age:
            self.report("", f"time {time:.15g} s after {self.time:.15g} s: line ignored")
            return False
        pairs = list(zip(self.sensors, row.readings, strict=True))
        read = [(s, x) for s, x in pairs if s.at_rest and math.isfinite(s.value)]
        if 0 <= age <= self.policy.max_age and all(s.agrees(x, age) for s, x in read):
            self.report("", f"another clock: goes on from the state of {age:.3g} s ago")
            shift = time - max(age, after) - self.time
            self._shift(shift)
            self.time += shift
            self.clock.last = self.time
        else:
            self.report("", "the kept state does not fit clock and readings: starts from rest")
            self._forget()
        return True

    def _forget(self) -> None:
        """Nothing is known of the machine; the actuators stand where they stand."""
        self._started, self.estimates = False, self.stepper.rest()
        self._unsure.unknown = 1.0
        self._without = None
        if self._vote is not None:
            self._vote.forget()
        for sensor in self.sensors:
            sensor.forget()
        self.time = self.clock.last = None
        self._moved_at = math.inf

    def _estimate(self, ticks: int, readings: list[float], lost: bool) -> None:
        """Go on, or start from rest as soon as every sensor has given a reading."""
        inputs = self._inputs(readings) if self._inputs else readings
        if self._started:
            estimates = self.stepper.step(ticks, inputs)
            if self._monitor is not None:
                good = self._state_of(lost) not in NOT_TESTED
                self._monitor.step(ticks, inputs, good, self.stepper.out)
            self.estimates = self._outputs(estimates) if self._outputs else estimates
            if math.isfinite(sum(self.estimates)):
                return
            self.report("", "the estimates are not finite: started again from rest")
            self._unsure.unknown = 1.0
        self._started = self.stepper.can_start(inputs)
        if not self._started:
            self.estimates = self.stepper.rest()
            return
        settled = self.policy.settled
        estimates = self.stepper.start(inputs, settled)
        self.estimates = self._outputs(estimates) if self._outputs else estimates
        expected = self.stepper.at_rest(inputs)
        away = not settled and contradicts_rest(self.sensors, readings, expected, self.report)
        if away:
            self._unsure.unknown = 1.0
        if self._monitor:
            self._monitor.start(inputs, "settled" if settled else "free" if away else "rest")

    def _shift(self, seconds: float) -> None:
        """The clock was set: past times move along."""
        for sensor in self.sensors:
            sensor.shift(seconds)
        self._moved_at += seconds

    def _move(self, time: float, safe: bool) -> None:
        dt = min(max(time - self._moved_at, 0.0), self.policy.slew_gap)
        self._moved_at = time
        for k, (at, setpoint) in enumerate(self._targets):
            target = self._safe(setpoint) if safe else self.policy.sign * self.estimates[at]
            if not safe and self._without is not None and self._reduced:
                target = self._reduced[k].clip(target)
            setpoint.move(target, dt)

    def _safe(self, setpoint: Setpoint) -> float:
        return setpoint.value if self.policy.safe is None else self.policy.safe

    def repeat(self) -> Reply:
        """What was last replied, or is about to be."""
        return self.time, self._written()

    def _written(self) -> list[Any]:
        # Adding zero turns -0.0 into 0.0.
        written = [setpoint.value + 0.0 for setpoint in self.setpoints]
        if self._estimates_too:
            written += [estimate + 0.0 for estimate in self.estimates]
        if self._monitor is not None:
            written += self._monitor.values(self.estimates)
        return [*written, self.status] if self._status_too else written

    def silence(self, elapsed: float) -> Reply:
        """Move towards the safe setpoint, `elapsed` [s] after the last row."""
        self.status = status.SAFE
        if self.time is None:
            # No row has told a time: that of the silence does.
            self._move(elapsed, True)
            return None, self._written()
        self._move(self.time + elapsed, True)
        self.clock.known_pause = elapsed
        return self.time + elapsed, self._written()

    @property
    def at_safe(self) -> bool:
        """Whether every setpoint has reached the safe one."""
        if self.policy.safe is None:
            return True
        return all(s.ramp == s.limits.clip(self._safe(s)) for s in self.setpoints)

    def finish(self) -> list[Any] | None:
        """The safe setpoint at once, or none where the last one stays: nothing comes after it."""
        if self.policy.hold_at_end:
            return None
        self.status = status.SAFE
        for setpoint in self.setpoints:
            setpoint.jump(self._safe(setpoint))
        return self._written()

    def summary(self) -> str:
        """What is said at the end."""
        return self._summary()

    def values(self) -> list[float]:
        """The setpoints."""
        return [setpoint.value for setpoint in self.setpoints]

    def stand_at(self, values: Sequence[float]) -> None:
        """Begin where the actuators stand, be it outside the limits; from there at the slew rate.

        Parameters
        ----------
        values : sequence of float
        """
        for setpoint, value in zip(self.setpoints, values, strict=True):
            if value != setpoint.value:
                setpoint.resume(value, value)
        # Since when they stand there, nobody knows: the first row moves nothing.
        self._moved_at = math.inf

    def state(self) -> dict[str, Any]:
        """All that a restart needs, as JSON."""
        return {
            "time_s": self.time,
            "started": self._started,
            "estimator": self.stepper.state(),
            "estimates": self.estimates,
            "sensors": [sensor.state() for sensor in self.sensors],
            "setpoints": [[s.value, s.ramp] for s in self.setpoints],
            "vote": None if self._vote is None else self._vote.state(),
            "unknown": self._unsure.unknown,
            "monitor": self._monitor and self._monitor.state(),
        }

    def resume(self, state: dict[str, Any], age: float = 0.0) -> None:
        """Go on from `state`, which was left `age` [s] ago.

        Parameters
        ----------
        state : dict
        age : float [s]
            NaN where nobody knows.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not one of this compensator.
        """
        self.stepper.resume(state["estimator"])
        if self._vote is not None and state.get("vote"):
            self._vote.resume(state["vote"])
        if self._monitor is not None:
            self._monitor.resume(state.get("monitor"))
        self.estimates = [float(value) for value in state["estimates"]]
        self._started = bool(state["started"])
        self._unsure.unknown = min(max(float(state.get("unknown", 0.0)), 0.0), 1.0)
        for sensor, kept in zip(self.sensors, state["sensors"], strict=True):
            sensor.resume(kept)
        for setpoint, (value, ramp) in zip(self.setpoints, state["setpoints"], strict=True):
            setpoint.resume(float(value), float(ramp))
        self.time = None if state["time_s"] is None else float(state["time_s"])
        self.clock.last = self.time
        self._moved_at = math.inf if self.time is None else self.time
        self._age = None if self.time is None else age
