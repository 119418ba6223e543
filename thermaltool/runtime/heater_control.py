"""A controller document in a stream: temperatures and measured powers in, power setpoints out."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import numpy as np

from thermaltool.control.actuation import TRIAL_POWER, Actuation
from thermaltool.control.blind import BlindPrediction
from thermaltool.control.controller import HeaterController
from thermaltool.control.law_choice import law_of
from thermaltool.control.laws import MAX_FAILURES, ControlLaw, Decision
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.model.validity import thousandth
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.compensator import SetpointProcess
from thermaltool.runtime.messages import Report
from thermaltool.runtime.stepper import Stepper, Steps
from thermaltool.status import FAILED, FAULT, OK, OLD_PLAN, SAFE, SATURATED

# Why there is no plan where temperatures are lost for long.
UNTRUSTED = "what the model foretells is not trusted any more"


class ControlStepper(Steps):
    """Estimator and law as one.

    Estimates are powers and offsets of axes wanted, heats and deflections, what is left.

    Parameters
    ----------
    controller : HeaterController
    estimator : KnownInputEstimator
    given : callable
        The setpoints as they stand: limits, slew rate and the safe state have changed them.
    report : callable
        Gets (channel, message) once per change of state.

    Attributes
    ----------
    held : set of int
        Columns whose last reading is not of this line.
    """

    def __init__(
        self,
        controller: HeaterController,
        estimator: KnownInputEstimator,
        given: Callable[[], list[float]],
        report: Report,
    ) -> None:
        super().__init__()
        self._controller, self._estimator = controller, estimator
        self._given, self._report = given, report
        self._stepper = Stepper(estimator, controller.period)
        self.settling_time = self._stepper.settling_time
        names = list(estimator.estimates)
        self._corrected = [names.index(channel) for channel in controller.axes]
        self._places = [estimator.sensors.index(channel) for channel in controller.channels]
        maxima = np.array([drive.maximum for drive in controller.drives])
        self.actuation = Actuation(maxima, controller.period)
        self._blind = (
            BlindPrediction(
                estimator, list(controller.tolerance), list(controller.tolerance.values()),
                controller.period,
            )
            if isinstance(estimator.inner, KalmanEstimator)
            else None
        )  # fmt: skip
        self._worthless = 0
        self._offsets = [0.0] * len(self._corrected)
        self.held: set[int] = set()
        self._elapsed = 0.0
        self._law: ControlLaw | None = law_of(controller, estimator)
        self.decision = self._nothing()
        self._measured: list[float | None] = []
        self._told = OK
        self._samples = self._saturated = 0
        self._worst = np.zeros(len(controller.tolerance))

    def _nothing(self) -> Decision:
        zero = np.zeros(len(self._controller.drives))
        return Decision(zero, zero, np.zeros(len(self._controller.tolerance)))

    def can_do_without(self, lost: Collection[int]) -> bool:
        """Whether heats can go on without these columns.

        Setpoints stand in for measured powers; for a temperature its prediction does while it is
        worth it, and the last heats for a few lines then.
        """
        temperatures = self._temperatures(lost)
        if not temperatures:
            return True
        if self._blind is None or max(temperatures) >= len(self._estimator.inner.sensors):
            return False
        return self._worthless <= MAX_FAILURES

    @property
    def blind(self) -> bool:
        """Whether the prediction stands in for a temperature."""
        return self._blind is not None and bool(self._blind.lost)

    def cost(self, lost: Collection[int]) -> str:
        """What stands in for columns that are lost, and what it is worth."""
        sensors, said = self._estimator.sensors, []
        temperatures = self._temperatures(lost)
        powers = [sensors[k] for k in sorted({*lost} - {*temperatures})]
        others = [sensors[k] for k in temperatures]
        if powers:
            said.append(
                f"the power of {', '.join(powers)} counts as it is set: a heater that fails is not "
                "seen"
            )
        if others and self._blind is not None:
            if not self._blind.lost:
                self._blind.take(self._controller.period, temperatures)
            bands = zip(self._controller.tolerance, self._blind.band(), strict=True)
            known = ", ".join(f"{channel} to {half:.2g}" for channel, half in bands)
            said.append(
                f"without {', '.join(others)} the model foretells {known}, and is trusted for "
                f"about {self._blind.lasts(self._stepper.now):.3g} s"
            )
        return "; ".join(said)

    def _temperatures(self, lost: Collection[int]) -> list[int]:
        """Those of some columns that are no powers of heaters, in their order."""
        return sorted({*lost} - {*self._places})

    def can_start(self, readings: list[float]) -> bool:
        """Whether all but the powers have been read."""
        others = [x for k, x in enumerate(readings) if k not in self._places]
        return super().can_start(others)

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        heats, left = len(self._controller.drives), len(self._controller.tolerance)
        wanted = heats + len(self._corrected)
        return [0.0] * wanted + self._stepper.rest() + [0.0] * left

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings; see `Stepper.start`."""
        self._elapsed = 0.0
        read, _ = self._with_powers(readings)
        estimates = self._stepper.start(read, settled)
        return self._decided(estimates, read, self._controller.period)

    def at_rest(self, readings: list[float]) -> list[float]:
        """What the temperatures of a machine at rest read; see `Steps.at_rest`."""
        return self._stepper.at_rest(self._with_powers(readings)[0])

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample of `ticks` clock steps (1 ns), which ends with `readings`.

        A measured power is the mean since the sample before.

        Parameters
        ----------
        ticks : int
        readings : list of float
        """
        dt = ticks * CLOCK_STEP
        self._elapsed += dt
        read, measured = self._with_powers(readings)
        for k in self.actuation.take(dt, np.array(self._given()), measured):
            self._change(k, measured[k])
        self._stepper.amend({place: read[place] for place in self._places})
        if self._blind is not None:
            read = self._foretold(dt, read)
        return self._decided(self._stepper.step(ticks, read), read, dt)

    def _foretold(self, dt: float, read: list[float]) -> list[float]:
        """Readings with predictions in the place of temperatures that are lost."""
        assert self._blind is not None
        now, before = self._stepper.now, self._stepper.before
        self._blind.take(dt, self._temperatures(self.out | self.held))
        trusted = not self._blind.lost or self._blind.worth_it(now)
        self._worthless = 0 if trusted else self._worthless + 1
        return self._blind.filled(dt, now, before, read)

    def _with_powers(self, readings: list[float]) -> tuple[list[float], list[float | None]]:
        """Readings with setpoints in the place of powers that are lost, and powers as measured."""
        read, measured, given = list(readings), [], self._given()
        for k, place in enumerate(self._places):
            absent = place in self.out or place in self.held
            known = not absent and np.isfinite(readings[place])
            measured.append(readings[place] if known else None)
            read[place] = readings[place] if known else given[k]
        self._measured = measured
        return read, measured

    def _change(self, k: int, measured: float | None) -> None:
        """A heater has ceased to follow, or follows again: the law is that of the others."""
        channel, stuck = self._controller.channels[k], bool(self.actuation.stuck[k])
        kept = [] if self._law is None else self._law.state()
        self._law = self._law_of_those_that_follow()
        if kept and self._law is not None:
            self._law.resume(kept)
        given = self._given()[k]
        what = f"does not follow: {given:.3g} set, {measured:.3g} measured"
        suspect = thousandth(channel, abs(measured or 0.0), given)
        if suspect is not None:
            what += f" (is it in {suspect.unit}?)"
        rest = "no heater is left" if self._law is None else "the others go on without it"
        self._report(channel, f"{what}: {rest}" if stuck else "follows again")

    def _law_of_those_that_follow(self) -> ControlLaw | None:
        """The law of the heaters that follow their setpoints; None where none does."""
        pairs = zip(self._controller.channels, self.actuation.stuck, strict=True)
        without = frozenset(channel for channel, stuck in pairs if stuck)
        if len(without) == len(self._controller.drives):
            return None
        return law_of(self._controller, self._estimator, without)

    def _decided(self, estimates: list[float], read: list[float], dt: float) -> list[float]:
        decision = self._decide(read, dt)
        self.decision = decision
        if decision.status in (OLD_PLAN, FAILED) and decision.status != self._told:
            then = "the last one goes on" if decision.status == OLD_PLAN else "no heat"
            if self._law is None:
                why = "no heater is left"
                then = f"what gives too little is tried with {TRIAL_POWER:.0%} of full power"
            else:
                why = self._law.reason
            self._report("", f"{why}: {then}")
        elif self._told in (OLD_PLAN, FAILED) and decision.status not in (OLD_PLAN, FAILED):
            self._report("", "planned again")
        self._told = decision.status
        self._samples += 1
        if decision.status == SATURATED:
            self._saturated += 1
            self._worst = np.maximum(self._worst, np.abs(decision.left))
        given = self._given()
        # Without a plan axes go on: they need none, but estimates that can be trusted.
        if not self._worthless:
            self._offsets = [-estimates[k] for k in self._corrected]
        beside = [*self._offsets, *estimates, *decision.left.tolist()]
        if self.gives_nothing:
            return [*[0.0] * len(given), *beside]
        wanted = [
            self.actuation.setpoint(k, power, given[k], self._measured[k])
            for k, power in enumerate(decision.powers)
        ]
        return [*wanted, *beside]

    @property
    def gives_nothing(self) -> bool:
        """Whether there is no plan any more: every heater is off, one that is tried too."""
        return self._law is not None and self.decision.status == FAILED

    def _decide(self, read: list[float], dt: float) -> Decision:
        """What the law gives, for all heaters: those that do not follow get nothing."""
        if self._law is None:
            return replace(self._nothing(), status=FAILED)
        if self._worthless > MAX_FAILURES:
            return replace(self._nothing(), status=FAILED)
        follows = ~self.actuation.stuck
        z = self._law.prediction.state(self._stepper.now, read)
        given = np.array(self._given())[follows]
        if self._worthless:
            self._law.reason = UNTRUSTED
            found = self._law.go_on(z, dt, given)
        else:
            found = self._law.decide(z, dt, self._elapsed, given)
        powers, asked = np.zeros((2, len(follows)))
        powers[follows], asked[follows] = found.powers, found.asked
        if self.blind:
            assert self._blind is not None
            found = replace(found, left=np.abs(found.left) + self._blind.band())
        return replace(found, powers=powers, asked=asked)

    def summary(self) -> str:
        """How long the limits were reached, and what they leave; nothing where they were not."""
        if not self._saturated:
            return ""
        left = ", ".join(
            f"{channel} up to {size:.3g}"
            for channel, size in zip(self._controller.tolerance, self._worst, strict=True)
        )
        share = self._saturated / self._samples
        return (
            f"the limits of {', '.join(self._controller.channels)} were reached in {share:.0%} of "
            f"the samples; left at the most, as foretold there: {left}"
        )

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        law = [] if self._law is None else self._law.state()
        blind = [] if self._blind is None else [sorted(self._blind.lost), self._blind.state()]
        stepped = [self._stepper.state(), self._elapsed, self.actuation.state()]
        return [*stepped, law, blind, self._offsets]

    def resume(self, values: list[Any]) -> None:
        """Raises TypeError or ValueError where `values` are no state of this controller."""
        estimator, elapsed, actuation, law, blind, offsets = values
        if len(offsets) != len(self._offsets):
            raise ValueError("not a state of this controller")
        self._offsets = [float(each) for each in offsets]
        self._stepper.resume(estimator)
        self._elapsed = float(elapsed)
        self.actuation.resume(actuation)
        self._law = self._law_of_those_that_follow()
        if law and self._law is not None:
            self._law.resume(law)
        if self._blind is not None:
            self._blind.resume(blind[1], blind[0])


class ControlProcess(SetpointProcess):
    """The process of a controller: its status also says what the law rests on."""

    stepper: ControlStepper

    def _leave_out(self) -> bool:
        # A temperature that is held is foretold from the first line on: it does not stand still.
        self.stepper.held = {k for k, sensor in enumerate(self.sensors) if sensor.held}
        return super()._leave_out()

    def _wait(self, seconds: float, lost: bool) -> None:
        super()._wait(seconds, lost or self.stepper.blind)

    def _state_of(self, safe: bool) -> str:
        """What a row's reply rests on."""
        status = super()._state_of(safe)
        if status == SAFE:
            return status
        if self.stepper.gives_nothing:
            return SAFE
        if self.stepper.actuation.stuck.any():
            return FAULT
        found = self.stepper.decision.status
        return status if found == OK or (self.stepper.blind and found == SATURATED) else found
