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
# A heat may leave its bounds by so many tolerances before it is cut off there.
APART = 10.0
# The weight of the bounds is looked at every so many turns, and changed by a factor where one of
# what is apart and what moves is so many times the other [1].
BALANCED_EVERY, UNBALANCED, REWEIGHED = 10, 5.0, 3.0


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
    """Where the search stands: both sides of each constraint, over the level.

    `held_dual` counts in units of the weight of its constraint, `pinned`.
    """

    steps: Float
    steps_dual: Float
    held: Float
    held_dual: Float
    pinned: float | None = None

    @staticmethod
    def of(heat: Float, level: float, bounds: Bounds) -> SplitState:
        """At a heat without bounds [unit of the drive]: what no reading tells moves slowly."""
        held = np.clip(heat, bounds.low, bounds.high) / level
        steps, none = np.diff(held, prepend=0.0), np.zeros(len(heat))
        return SplitState(steps, none.copy(), held, none.copy())


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
        self.total_variation, self.order = order is None, 1 if order is None else order
        self.weight, self.spread = weight, spread
        self.pinned = None if bounds.free else (problem.level / spread) ** 2
        self.smoother = self._made()

    def _made(self) -> EvenSmoother:
        space, start = self.problem.space(self.order, self.weight, self.pinned)
        modal = self.problem.estimator.modal
        return EvenSmoother(space, start, len(self.readings), (modal,))

    def solve(
        self, variation: float, state: SplitState, turns: int = MAX_ITERATIONS
    ) -> tuple[Float, bool]:
        """The heat, and whether it stood still.

        Parameters
        ----------
        variation : float
            Weight of Σ |Δu| / level, beside half of the squared residuals over the noise's
            variance [1]; no part of a quadratic penalty.
        state : SplitState
            Where the search begins; left where it ends.
        turns : int
            At most.

        Returns
        -------
        heat : ndarray, shape (n,)
        converged : bool
        """
        level, heat = self.problem.level, state.held
        low, high = self.bounds.low / level, self.bounds.high / level
        still = TOLERANCE * self.spread / level
        if state.pinned not in (None, self.pinned):
            self.pinned = state.pinned
            self.smoother = self._made()
        for turn in range(1, turns + 1):
            before, taken, near = heat, self.readings, None
            if self.total_variation:
                near = level * (state.steps - state.steps_dual)[:, None]
            if not self.bounds.free:
                taken = np.hstack([taken, level * (state.held - state.held_dual)[:, None]])
            heat = self.smoother.run(taken, near)[0][:, 0] / level
            standing, balance = _size(heat - before) < still, 1.0
            if self.total_variation:
                steps, last = np.diff(heat, prepend=0.0), state.steps
                over = RELAXATION * steps + (1 - RELAXATION) * last + state.steps_dual
                state.steps = _shrunk(over, variation / self.weight)
                state.steps_dual = over - state.steps
            if not self.bounds.free:
                last = state.held
                over = RELAXATION * heat + (1 - RELAXATION) * last + state.held_dual
                state.held = np.clip(over, low, high)
                state.held_dual = over - state.held
                apart, moved = _size(heat - state.held), _size(state.held - last)
                standing = standing and apart < APART * still
                balance = _balance(apart, moved)
            if standing:
                return self._within(heat), True
            if self.pinned is not None and turn % BALANCED_EVERY == 0 and balance != 1:
                self.pinned *= balance
                state.pinned = self.pinned
                state.held_dual = state.held_dual / balance
                self.smoother = self._made()
        return self._within(heat), False

    def _within(self, heat: Float) -> Float:
        return np.clip(self.problem.level * heat, self.bounds.low, self.bounds.high)


def _balance(apart: float, moved: float) -> float:
    """By how much to weigh a constraint more, so that both sides come together at one pace."""
    if apart > UNBALANCED * moved:
        return REWEIGHED
    return 1 / REWEIGHED if moved > UNBALANCED * apart else 1.0


def _size(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _shrunk(values: Float, by: float) -> Float:
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - by, 0.0))
