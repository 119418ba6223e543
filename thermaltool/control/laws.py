"""Laws that set heats from the state of a machine: inversion, and linear quadratic regulators.

They know nothing of limits: what they ask for beyond them is cut off. The law that plans within
them is `thermaltool.control.receding`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.control.prediction import ControlPrediction
from thermaltool.errors import FitError
from thermaltool.estimation.state_space import predicted_covariance, propagated
from thermaltool.responses.modes import Float
from thermaltool.signals.covariance_root import covariance_root
from thermaltool.status import OK, OLD_PLAN, SATURATED

# A regulator's gain varies slowly with the sample length: it is solved for on this relative grid.
GAIN_GRID = 0.01
# For a regulator a heat that stays decays with so many of the slowest time constants: one that
# never ends has no finite cost.
DISTURBANCE_LIFE = 10.0
# Balanced states whose Hankel singular value is below this part of the largest are left out.
SMALLEST_HANKEL = 1e-4
# After so many of the slowest time constants a step has settled.
SETTLED = 5.0
# Doublings of the sums that make gramians: 2²⁴ samples.
DOUBLINGS = 24
# Beyond a limit by more than this part of full power is more than rounding.
AT_LIMIT = 1e-3

# After so many samples without a plan, or a state to plan from, there is no heat.
MAX_FAILURES = 5


@dataclass(frozen=True)
class HeatLimits:
    """What the control drives can do.

    Attributes
    ----------
    maxima : ndarray, shape (n,) [unit of the drives]
        Each is between 0 and this.
    slews : ndarray, shape (n,) [unit of the drives per s]
    """

    maxima: Float
    slews: Float


@dataclass(frozen=True)
class Decision:
    """What a law gives for a sample.

    Attributes
    ----------
    powers : ndarray, shape (n,)
        Within the limits.
    asked : ndarray, shape (n,)
        Before the limits; negative where heat should be taken away.
    left : ndarray, shape (number of outputs,)
        The largest deflections that are foretold with `powers`.
    status : str
    """

    powers: Float
    asked: Float
    left: Float
    status: str = OK


class ControlLaw(ABC):
    """Powers from the state z of a `ControlPrediction`.

    Attributes
    ----------
    prediction : ControlPrediction
    bounds : HeatLimits
    reason : str
        Why there was no plan.
    """

    prediction: ControlPrediction
    bounds: HeatLimits
    reason = ""

    def state(self) -> list[Any]:
        """What a law remembers, for `resume`, as JSON."""
        return []

    def resume(self, values: Sequence[Any]) -> None:
        """Go on from `values`; ValueError where they are none of this law."""
        if values:
            raise ValueError("not a state of this controller")

    @abstractmethod
    def decide(self, z: Float, dt: float, elapsed: float, given: Float) -> Decision:
        """What to give from now on.

        Parameters
        ----------
        z : ndarray, shape (n,)
        dt : float [s]
            Length of the sample, past and expected.
        elapsed : float [s]
            Since the first sample.
        given : ndarray
            Setpoints as they stand.
        """

    @abstractmethod
    def go_on(self, z: Float, dt: float, given: Float) -> Decision:
        """What to give without a new decision: the last plan, or what is given; else as `decide`.

        Parameters
        ----------
        z : ndarray, shape (n,)
        dt : float [s]
        given : ndarray
        """


class _ClippedLaw(ControlLaw):
    """A law that asks, and is cut off at the limits; what it leaves is foretold after `lead`."""

    def __init__(self, prediction: ControlPrediction, bounds: HeatLimits, lead: float) -> None:
        self.prediction, self.bounds = prediction, bounds
        self._free, self._steps = prediction.free(lead), prediction.steps(np.array(lead))

    def decide(self, z: Float, dt: float, elapsed: float, given: Float) -> Decision:
        asked = self.asks(z, dt)
        powers = np.clip(asked, 0.0, self.bounds.maxima)
        beyond = np.any(np.abs(asked - powers) > AT_LIMIT * self.bounds.maxima)
        left = self._free @ z + self._steps @ powers
        return Decision(powers, asked, left, SATURATED if beyond else OK)

    def go_on(self, z: Float, dt: float, given: Float) -> Decision:
        """What is given stays."""
        return Decision(given, given, self._free @ z + self._steps @ given, OLD_PLAN)

    @abstractmethod
    def asks(self, z: Float, dt: float) -> Float:
        """Powers before the limits."""


class InversionLaw(_ClippedLaw):
    """Feed-forward by inversion of the model: the heats that bring outputs to zero after a lead.

    S(lead) u = −C A(lead) z, with the pseudo-inverse of S where drives and outputs differ in
    number.

    Parameters
    ----------
    prediction : ControlPrediction
    bounds : HeatLimits
    lead : float [s]
    """

    def __init__(self, prediction: ControlPrediction, bounds: HeatLimits, lead: float) -> None:
        super().__init__(prediction, bounds, lead)
        self._gain = -np.linalg.pinv(self._steps) @ self._free

    def asks(self, z: Float, dt: float) -> Float:
        """Powers before the limits."""
        return np.asarray(self._gain @ z)


class RegulatorLaw(_ClippedLaw):
    """Linear quadratic regulator u = −K z, scaled by Bryson's rule.

    The cost of a sample is Σ (y/tolerance)² + Σ (u/maximum)² of the outputs, or with `of_states`
    Σ (x/largest x)² + Σ (u/maximum)² of the states of a balanced realization. A weight of states
    knows nothing of what the states do to the deflection, which is why it holds it badly (Fraser
    1997, section 8.5).

    Parameters
    ----------
    prediction : ControlPrediction
    bounds : HeatLimits
    lead : float [s]
    tolerance : sequence of float, one for each output
    of_states : bool
    levels : sequence of float, one for each disturbance
        Steps that make states as large as they become.
    """

    def __init__(
        self,
        prediction: ControlPrediction,
        bounds: HeatLimits,
        lead: float,
        tolerance: Sequence[float],
        of_states: bool = False,
        levels: Sequence[float] = (),
    ) -> None:
        super().__init__(prediction, bounds, lead)
        self._tolerance, self._of_states, self._levels = tolerance, of_states, levels
        self._gains: dict[int, Float] = {}

    def asks(self, z: Float, dt: float) -> Float:
        """Powers before the limits."""
        at = round(np.log(dt) / GAIN_GRID)
        if at not in self._gains:
            self._gains[at] = self._gain(float(np.exp(at * GAIN_GRID)))
        return -self._gains[at] @ z

    def _gain(self, dt: float) -> Float:
        """K of the steady Riccati equation, in units of full power against tolerances."""
        A, B = self.prediction.transition(dt)
        lasts = np.ones(len(A))
        life = DISTURBANCE_LIFE * self.prediction.slowest()
        lasts[self.prediction.held(np.ones(len(self.prediction.disturbances))) != 0] = np.exp(
            -dt / life
        )
        A, B = lasts[:, None] * A, B * self.bounds.maxima
        rows = self._state_rows(A, B) if self._of_states else self._output_rows()
        R = np.eye(B.shape[1])
        try:
            # The regulator's Riccati equation is the filter's of the transposed system.
            P = predicted_covariance(A.T, B.T, rows.T @ rows, R)
        except FitError as error:
            raise FitError("the regulator's Riccati equation has no steady solution") from error
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        return np.asarray(self.bounds.maxima[:, None] * K)

    def _output_rows(self) -> Float:
        return self.prediction.readout / np.array(self._tolerance)[:, None]

    def _state_rows(self, A: Float, B: Float) -> Float:
        """Balanced states, each over the largest value that a step of an input brings it to."""
        starts = np.array([self.prediction.held(each) for each in np.diag(self._levels)]).T
        inputs, rows, none = np.hstack([B, starts]), self._output_rows(), np.zeros_like(A)
        reached = covariance_root(propagated(A, inputs @ inputs.T, none, 2**DOUBLINGS))
        seen = covariance_root(propagated(A.T, rows.T @ rows, none, 2**DOUBLINGS))
        U, hankel, _ = np.linalg.svd(seen.T @ reached)
        kept = hankel > SMALLEST_HANKEL * hankel[0]
        balanced = (U[:, kept] / np.sqrt(hankel[kept])).T @ seen.T
        settled, heated = self.prediction.transition(SETTLED * self.prediction.slowest())
        steady = np.hstack([heated * self.bounds.maxima, settled @ starts])
        largest = np.max(np.abs(balanced @ steady), axis=1, keepdims=True)
        return np.asarray(balanced / largest)
