"""Total variation, and bounds on a heat, by alternating directions (Boyd et al. 2011, sec. 6).

Each step is a Tikhonov problem with constant matrices, so a smoother is made once and run many
times: the constraint moves what the heat is penalized to be near to. Total variation is the sum of
the sizes of a heat's steps: it prefers a few steps to many small changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.penalties import HeatProblem
from thermaltool.responses.modes import Float

# Over-relaxation [1], and when a solution stands still [share of its spread, root mean square].
RELAXATION, TOLERANCE, MAX_ITERATIONS = 1.6, 3e-4, 200


@dataclass(frozen=True)
class Bounds:
    """What a heat cannot be less or more than [unit of the drive]."""

    low: float = -np.inf
    high: float = np.inf

    @property
    def free(self) -> bool:
        """Whether they bound nothing."""
        return bool(self.low == -np.inf and self.high == np.inf)


@dataclass
class SplitState:
    """Where the search stands: both sides of each constraint, over the level."""

    steps: Float
    steps_dual: Float
    held: Float
    held_dual: Float

    @staticmethod
    def of(rows: int) -> SplitState:
        """At rest."""
        return SplitState(*np.zeros((4, rows)))


class ConstrainedProblem:
    """A penalty with bounds, or total variation with or without.

    Parameters
    ----------
    problem : HeatProblem
    readings : ndarray, shape (n, n_sensors)
    order : int or None
        Of the quadratic penalty; None for total variation.
    weight : float
        λ of the quadratic penalty; for total variation of the quadratic step, which sets the pace.
    spread : float
        How sure the heat is without bounds, a standard deviation [unit of the drive]; it sets the
        pace.
    bounds : Bounds
    """

    def __init__(
        self,
        problem: HeatProblem,
        readings: Float,
        order: int | None,
        weight: float,
        spread: float,
        bounds: Bounds,
    ) -> None:
        self.problem, self.readings, self.bounds = problem, readings, bounds
        self.total_variation, self.weight = order is None, weight
        self.tolerance = TOLERANCE * spread / problem.level
        pinned = None if bounds.free else (problem.level / spread) ** 2
        space, start = problem.space(1 if order is None else order, weight, pinned)
        self.smoother = EvenSmoother(space, start, len(readings))

    def solve(self, variation: float, state: SplitState) -> tuple[Float, bool]:
        """The heat, and whether it stood still.

        Parameters
        ----------
        variation : float
            Weight of Σ |Δu| / level [1]; no part of a quadratic penalty.
        state : SplitState
            Where the search begins; left where it ends.

        Returns
        -------
        heat : ndarray, shape (n,)
        converged : bool
        """
        level, shift, heat = self.problem.level, np.zeros(len(self.readings)), state.held
        low, high = self.bounds.low / level, self.bounds.high / level
        for _ in range(MAX_ITERATIONS):
            before, taken = heat, self.readings
            if self.total_variation:
                shift = np.cumsum(state.steps - state.steps_dual)
                taken = taken - self.problem.simulated(level * shift)
            if not self.bounds.free:
                pinned = state.held - state.held_dual - shift
                taken = np.hstack([taken, level * pinned[:, None]])
            heat = shift + self.smoother.run(taken)[0][:, 0] / level
            moved = heat - before
            if self.total_variation:
                steps = np.diff(heat, prepend=0.0)
                over = RELAXATION * steps + (1 - RELAXATION) * state.steps + state.steps_dual
                # Twice the weight counts in the quadratic step: χ², not its half.
                state.steps = _shrunk(over, variation / self.weight)
                state.steps_dual = over - state.steps
            if not self.bounds.free:
                over = RELAXATION * heat + (1 - RELAXATION) * state.held + state.held_dual
                held = np.clip(over, low, high)
                moved = np.concatenate([moved, held - state.held, held - heat])
                state.held, state.held_dual = held, over - held
            if np.sqrt(np.mean(moved**2)) < self.tolerance:
                break
            if not self.total_variation and self.bounds.free:
                break
        else:
            return self._given(heat), False
        return self._given(heat), True

    def _given(self, heat: Float) -> Float:
        return self.problem.level * np.clip(
            heat, self.bounds.low / self.problem.level, self.bounds.high / self.problem.level
        )


def _shrunk(values: Float, by: float) -> Float:
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - by, 0.0))
