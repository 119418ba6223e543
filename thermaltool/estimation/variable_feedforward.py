"""Feedforward through a loss of heat, or a time of its own, that changes with the state."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from thermaltool.effects.effect import Effect, Memory
from thermaltool.estimation.known_inputs import Feedforward, KnownInputEstimator
from thermaltool.estimation.variable_cooling import (
    VariableLossEstimator,
    followed,
    other_clock,
    own_ticks,
    steady_state,
)
from thermaltool.model import state_rates
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import CLOCK_STEP


@dataclass(frozen=True, eq=False, kw_only=True)
class VariableFeedforward(VariableLossEstimator):
    """Deflections of measured drives, through responses that decay faster by a state.

    In a sample e^(-λ dt) becomes e^(-λ dt - r dt); a held input acts, on the mean, half a sample
    later than its first moment: as `run_with_loss`. The state is a column, or an output that
    follows from the drives as the deflections do.
    """

    @property
    def outputs(self) -> tuple[str, ...]:
        """Deflections: without the outputs that tell the state alone."""
        return self.linear.outputs[: len(self.linear.outputs) - self._hidden]

    @property
    def estimates(self) -> tuple[str, ...]:
        """The deflections."""
        return self.outputs

    @property
    def _hidden(self) -> int:
        linear = self.linear
        inner = linear.inner if isinstance(linear, KnownInputEstimator) else linear
        return len(inner.states) if isinstance(inner, Feedforward) else 0

    def recursion(self, dt: float) -> Recursion:
        """At the model's own loss.

        Parameters
        ----------
        dt : float [s]
        """
        r = self.linear.recursion(dt)
        return Recursion(r.F, r.G0, r.G1, r.C[: len(self.outputs)])

    def advance(self, ticks: int, x: Float, first: Float, before: Float, now: Float) -> Float:
        rate, pace = self._rate(ticks, x, first, before)
        exponent = followed(rate * ticks * CLOCK_STEP)
        r, kept = self.linear.recursion(own_ticks(ticks, pace) * CLOCK_STEP), math.exp(-exponent)
        if len(r.F) != len(x):
            raise other_clock(ticks)
        added = r.G0 @ (self._weights(exponent) * before) + r.G1 @ now
        return np.asarray(kept * (r.F @ x) + added)

    def settled(self, dt: float, readings: Float) -> Float:
        return self._settled(dt, readings, readings)

    def start(self, dt: float, readings: Float, settled: bool = False) -> Float:
        if settled or not isinstance(self.linear, KnownInputEstimator):
            return super().start(dt, readings, settled)
        return self._settled(dt, readings, np.where(self.linear.measured, readings, 0.0))

    def _settled(self, dt: float, readings: Float, acting: Float) -> Float:
        """The state in which `acting` leaves a machine whose loss is that of `readings`."""
        ticks = round(dt / CLOCK_STEP)

        def sample(x: Float) -> tuple[Float, Float]:
            rate, pace = self._rate(ticks, x, readings, readings)
            exponent = followed(rate * dt)
            r = self.linear.recursion(own_ticks(ticks, pace) * CLOCK_STEP)
            pushed = r.G0 @ (self._weights(exponent) * acting) + r.G1 @ acting
            return math.exp(-exponent) * r.F, pushed

        return steady_state(self.linear.recursion(dt).settled(acting), sample)

    def _weights(self, exponent: float) -> Float:
        """What of each column that is read before a sample acts at its end."""
        linear = self.linear
        known = linear.known if isinstance(linear, KnownInputEstimator) else ()
        shares = [0.5 if each.hold == "zero" else 1.0 for each in known]
        return np.exp(-exponent * np.array(shares))

    def _rate(self, ticks: int, x: Float, first: Float, now: Float) -> tuple[float, float]:
        """By how much every mode decays faster [1/s], and how much faster its time goes."""
        columns = {name: np.array([first[k], now[k]]) for name, k in self._columns.items()}
        told = self.linear.recursion(ticks * CLOCK_STEP).C @ x
        outputs = {
            name: np.array([0.0, y]) for name, y in zip(self.linear.outputs, told, strict=True)
        }
        each: list[tuple[Effect, Memory]] = [(effect, None) for effect in self.losses]
        rate, pace = state_rates(each, Record(np.arange(2.0), columns), outputs)
        return float(rate[-1]), float(pace[-1])
