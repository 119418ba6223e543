"""Receding-horizon control of heaters: heats between zero and full power, planned for cooling.

A heater cannot take heat away, and what it puts in bends the machine for as long as its slowest
time constant. So the heats over a horizon are planned at every sample, and the first of them is
given:

    minimize  Σ w (y/tolerance)² + ω W² + ρ Σ (u/maximum)² + κ Σ (change of u/maximum)²
    over      0 ≤ u ≤ maximum,  |change of u| ≤ slew · time,  every y within a band of width W g,

where y is what NC axes leave of a deflection: each moves to where it is needed, within its range
and at once, so that heat is planned for what an axis cannot reach. It is a quadratic program for
PIQP, an interior-point solver that needs some 20 steps for a small dense one, whatever is active,
and so has a bounded time for each sample. Stretches of constant heat become longer by a constant
ratio, so that a horizon of an hour has as few as one of a minute.

Where nothing is known of how long the machine works, what is foretold counts the less the further
ahead it is: w falls by e in a third of the horizon, and the band grows so (g). The disturbance may
have changed by then, and with equal weights a hold that no heater can keep for all of the horizon
is given up in its first minutes for the sake of its last.

Where the machine works for a known time, the plan ends with it, all of it counts alike (g = 1), and
the band from the first sample on: then the heat is not spent on the first minutes that the last
ones will need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.control.laws import AT_LIMIT, MAX_FAILURES, ControlLaw, Decision, HeatLimits
from thermaltool.control.prediction import ControlPrediction
from thermaltool.errors import FitError
from thermaltool.responses.modes import Float
from thermaltool.status import FAILED, OK, OLD_PLAN, SATURATED

# Stretches of a plan, and in each so many moments at which outputs count.
STRETCHES, MOMENTS = 20, 3
# Weight of full power for all of the horizon, against a deflection of one tolerance.
POWER_WEIGHT = 1e-4
# Weight of a change by full power, from the setpoint as it stands and from stretch to stretch, in
# weights of the band and for each tolerance that the last plan left, but for one at least: it keeps
# noise out of the heats. Weighed the same whatever is left, noise would move heaters over all of
# their range where much is left, for what the heat of a minute matters there.
CHANGE_WEIGHT, LEAST_LEFT = 0.3, 1.0
# Weight of the band of the worst output against the mean square; where the time to work is known
# the band is what counts.
BAND_WEIGHT, BAND_WEIGHT_WITHIN = 1.0, 100.0
# A deflection that is foretold counts less by e for each of so many parts of the horizon.
FADING_PARTS = 3.0
# Keeps the program strictly convex.
REGULARIZATION = 1e-8
# The time that is left is planned on a grid of this ratio, and never less than so many periods.
HORIZON_GRID, LEAST_PERIODS = 1.08, 6


def stretch_ends(first: float, horizon: float, count: int = STRETCHES) -> Float:
    """Ends of stretches from `first` on that grow by a constant ratio up to `horizon` [s].

    Parameters
    ----------
    first : float [s]
        Length of the first.
    horizon : float [s]
    count : int
        So many at the most; fewer where even ones suffice.
    """
    even = max(round(horizon / first), 1)
    if even <= count:
        return first * np.arange(1.0, even + 1)
    low, high = 1.0, horizon / first
    for _ in range(100):
        ratio = (low + high) / 2
        if np.sum(ratio ** np.arange(count)) * first < horizon:
            low = ratio
        else:
            high = ratio
    return np.asarray(first * np.cumsum(high ** np.arange(count)))


def shortened(ends: Float, horizon: float) -> Float:
    """The first of these ends, and `horizon` [s] for the last; no stretch of a mere rest.

    Parameters
    ----------
    ends : ndarray, shape (k,) [s]
    horizon : float [s]
    """
    kept = ends[ends < horizon]
    lengths = np.diff(kept, prepend=0.0)
    if len(kept) > 1 and horizon - kept[-1] < lengths[-1] / 2:
        kept = kept[:-1]
    return np.append(kept, horizon)


def beyond(y: Float, reach: Float) -> Float:
    """What goes beyond a range around zero: y less its part within ±`reach`.

    Parameters
    ----------
    y : ndarray, shape (..., n)
    reach : ndarray, shape (n,)
    """
    return np.asarray(y - np.clip(y, -reach, reach))


@dataclass
class HeatPlan:
    """Heats over stretches, as of the sample at which they were planned.

    Attributes
    ----------
    ends : ndarray, shape (k,) [s]
    powers : ndarray, shape (k, n)
    age : float [s]
    """

    ends: Float
    powers: Float
    age: float = 0.0

    def now(self) -> Float:
        """The heats of the stretch that the plan has reached."""
        return np.asarray(
            self.powers[min(int(np.searchsorted(self.ends, self.age)), len(self.ends) - 1)]
        )


class Program:
    """The quadratic program of one horizon; a state and a few bounds change with each sample.

    Parameters
    ----------
    prediction : ControlPrediction
    bounds : HeatLimits
    tolerance : sequence of float
    ends : ndarray, shape (k,) [s]
        Of the stretches.
    band_weight : float
    fading : float [s]
        A deflection so far ahead counts less by e; infinite where all count alike.
    axes : sequence of float [unit of the output]
        What an NC axis corrects of each output, up and down; 0 where there is none.
    """

    def __init__(
        self,
        prediction: ControlPrediction,
        bounds: HeatLimits,
        tolerance: Sequence[float],
        ends: Float,
        band_weight: float,
        fading: float,
        axes: Sequence[float],
    ) -> None:
        import piqp

        self.ends, self._solved = ends, piqp.PIQP_SOLVED
        starts = np.concatenate([[0.0], ends[:-1]])
        within = np.arange(1, MOMENTS + 1) / MOMENTS
        times = (starts[:, None] + (ends - starts)[:, None] * within).ravel()
        scale = np.array(tolerance)
        self._outputs, self._drives = len(scale), len(bounds.maxima)
        self.free = np.vstack([prediction.free(float(t)) / scale[:, None] for t in times])
        # A stretch of heat is a step at its start, less one at the start of the next.
        steps = prediction.steps(times[:, None] - starts)
        steps[:, :-1] -= steps[:, 1:]
        steps *= bounds.maxima / scale[:, None]
        self.acting = steps.transpose(0, 2, 1, 3).reshape(len(self.free), -1)
        fades = np.exp(-times / fading)
        counts = np.diff(times, prepend=0.0) * fades
        weights = np.repeat(counts / counts.sum(), self._outputs)
        self._change_weight = 2 * CHANGE_WEIGHT * band_weight
        self._reach = np.array(axes) / scale
        self._moving = np.hstack([self.acting, self._offsets()])
        self._weighted = 2 * self._moving.T * weights
        self._heats, self._moved = len(ends) * self._drives, self._moving.shape[1]
        self._n = self._moved + 2 * self._outputs + 1
        P = REGULARIZATION * np.eye(self._n)
        P[: self._moved, : self._moved] += self._weighted @ self._moving
        shares = np.repeat((ends - starts) / ends[-1], self._drives)
        P[: self._heats, : self._heats] += np.diag(2 * POWER_WEIGHT * shares)
        # From stretch to stretch, and of the first from the setpoint.
        differ = np.eye(self._heats) - np.eye(self._heats, k=-self._drives)
        self._differ = differ.T @ differ
        P[-1, -1] += 2 * band_weight
        self._G, self._spans = self._rows(bounds, ends, starts, 1 / fades)
        self._solver: Any = piqp.DenseSolver()
        self._P, self._ready = np.asfortranarray(P), False

    def _offsets(self) -> Float:
        """What offsets of the axes do to the outputs, in parts of their range.

        Each goes straight from the end of a stretch to the end of the next.
        """
        stretches = len(self.ends)
        after = np.tile(np.arange(1, MOMENTS + 1) / MOMENTS, stretches)[:, None]
        begun = np.repeat(np.eye(stretches, stretches + 1), MOMENTS, axis=0)
        ended = np.repeat(np.eye(stretches, stretches + 1, k=1), MOMENTS, axis=0)
        course = (1 - after) * begun + after * ended
        axes = np.diag(self._reach)[:, self._reach > 0]
        return np.asarray(np.kron(course, axes))

    def _rows(
        self, bounds: HeatLimits, ends: Float, starts: Float, grown: Float
    ) -> tuple[Float, Float]:
        """Rows of the inequalities, and the upper bounds of those that never change."""
        outputs, moved = self._outputs, self._moved
        axes = np.kron(grown[:, None], np.eye(outputs))
        none, thin = np.zeros_like(axes), np.zeros((len(axes), 1))
        rows = [
            np.hstack([self._moving, -axes, none, thin]),
            np.hstack([-self._moving, none, -axes, thin]),
            np.hstack([np.zeros((outputs, moved)), np.eye(outputs), np.eye(outputs),
                       -np.ones((outputs, 1))]),
        ]  # fmt: skip
        reach = (bounds.slews / bounds.maxima) * (ends - starts)[:-1, None]
        change = np.zeros((reach.size, self._n))
        at = np.arange(reach.size)
        change[at, at + self._drives], change[at, at] = 1.0, -1.0
        binding = reach.ravel() < 1
        rows += [change[binding], -change[binding]]
        spans = np.concatenate([np.zeros(outputs), *([reach.ravel()[binding]] * 2)])
        return np.asfortranarray(np.vstack(rows)), spans

    def solve(
        self, z: Float, stands: Float, reach: Float, spent: tuple[Float, Float], left: float
    ) -> Float:
        """Heats in parts of full power, shape (k, n).

        Parameters
        ----------
        z : ndarray
        stands, reach : ndarray, shape (n,)
            Where the heats stand, and by how much they can be moved now, in parts of full power.
        spent : (ndarray, ndarray), each shape (number of outputs,) [tolerance]
            How far above and below zero the outputs have been.
        left : float [tolerance]
            The largest deflection that the last plan foretold.

        Raises
        ------
        FitError
            The solver has found none.
        """
        y, drives, heats, moved = self.free @ z, self._drives, self._heats, self._moved
        c = np.zeros(self._n)
        c[:moved] = self._weighted @ y
        weight = self._change_weight * max(left, LEAST_LEFT)
        c[:drives] -= weight * stands
        P = self._P.copy(order="F")
        P[:heats, :heats] += weight * self._differ
        lower, upper = np.zeros(self._n), np.full(self._n, np.inf)
        upper[:moved] = 1.0
        lower[heats:moved] = -1.0
        lower[:drives] = np.clip(stands - reach, 0.0, 1.0)
        upper[:drives] = np.clip(stands + reach, lower[:drives], 1.0)
        lower[moved:-1] = np.concatenate(spent)
        h = np.concatenate([-y, y, self._spans])
        if not self._ready:
            self._solver.setup(P, c, None, None, self._G, None, h, lower, upper)
            self._ready = True
        else:
            self._solver.update(P=P, c=c, h_u=h, x_l=lower, x_u=upper)
        status = self._solver.solve()
        found = np.array(self._solver.result.x[:heats])
        if status != self._solved or not np.all(np.isfinite(found)):
            raise FitError(f"no plan: {status}")
        return np.clip(found, 0.0, 1.0).reshape(-1, drives)

    def foretold(self, z: Float, shares: Float) -> Float:
        """What axes leave at the moments of the plan, shape (m, number of outputs) [tolerance]."""
        y = (self.free @ z + self.acting @ shares.ravel()).reshape(-1, self._outputs)
        return self.beside_axes(y)

    def beside_axes(self, y: Float) -> Float:
        """What axes leave of outputs, shape (..., number of outputs) [tolerance]."""
        return beyond(y, self._reach)


class RecedingHorizonLaw(ControlLaw):
    """The law of this module.

    Parameters
    ----------
    prediction : ControlPrediction
    bounds : HeatLimits
    tolerance : sequence of float
    period : float [s]
    horizon : float [s]
    duration : float or None [s]
        The time that the machine works.
    axes : sequence of float [unit of the output]
        As of `Program`.
    """

    def __init__(
        self,
        prediction: ControlPrediction,
        bounds: HeatLimits,
        tolerance: Sequence[float],
        period: float,
        horizon: float,
        duration: float | None,
        axes: Sequence[float],
    ) -> None:
        self.prediction, self.bounds, self._axes = prediction, bounds, axes
        self._tolerance, self._period = np.array(tolerance), period
        self._horizon, self._duration = horizon, duration
        self._programs: dict[tuple[int, bool], Program] = {}
        self._C = prediction.readout / self._tolerance[:, None]
        self._above = self._below = np.zeros(len(self._tolerance))
        self._plan: HeatPlan | None = None
        self._failures, self._left = 0, 0.0
        self._ends = stretch_ends(period, max(horizon, duration or 0.0))
        self._latest = self._program(0.0)[0]

    def decide(self, z: Float, dt: float, elapsed: float, given: Float) -> Decision:
        program, within = self._program(elapsed)
        self._latest = program
        now = program.beside_axes(self._C @ z)
        if within:
            self._above = np.maximum(self._above, now)
            self._below = np.maximum(self._below, -now)
        else:
            self._above = self._below = np.zeros(len(now))
        maxima = self.bounds.maxima
        stands, reach = given / maxima, self.bounds.slews * dt / maxima
        try:
            shares = program.solve(z, stands, reach, (self._above, self._below), self._left)
        except FitError as error:
            self.reason = str(error)
            return self.go_on(z, dt, given)
        self._failures, self._plan = 0, HeatPlan(program.ends, shares * maxima)
        left = np.abs(program.foretold(z, shares)).max(axis=0)
        self._left, worst = float(left.max()), left * self._tolerance
        at_limit = np.any((shares < AT_LIMIT) | (shares > 1 - AT_LIMIT))
        status = SATURATED if at_limit and np.any(worst > self._tolerance) else OK
        return Decision(shares[0] * maxima, shares[0] * maxima, worst, status)

    def go_on(self, z: Float, dt: float, given: Float) -> Decision:
        """The last plan while it is fresh, then no heat."""
        self._failures += 1
        powers, status = np.zeros(len(self.bounds.maxima)), FAILED
        if self._plan is not None and self._failures <= MAX_FAILURES:
            self._plan.age += dt
            powers, status = self._plan.now(), OLD_PLAN
        program = self._latest
        shares = np.tile(powers / self.bounds.maxima, (len(program.ends), 1))
        worst = np.abs(program.foretold(z, shares)).max(axis=0) * self._tolerance
        return Decision(powers, powers, worst, status)

    def _program(self, elapsed: float) -> tuple[Program, bool]:
        """The program of the horizon at this time, and whether it ends with the work."""
        left = 0.0 if self._duration is None else self._duration - elapsed
        within = left > 0
        horizon = left if within else self._horizon
        horizon = max(horizon, LEAST_PERIODS * self._period)
        at = round(np.log(horizon / self._period) / np.log(HORIZON_GRID))
        if (at, within) not in self._programs:
            weight = BAND_WEIGHT_WITHIN if within else BAND_WEIGHT
            self._programs[at, within] = Program(
                self.prediction, self.bounds, self._tolerance.tolist(),
                shortened(self._ends, self._period * HORIZON_GRID**at), weight,
                np.inf if within else horizon / FADING_PARTS, self._axes,
            )  # fmt: skip
        return self._programs[at, within], within

    def state(self) -> list[Any]:
        """How far above and below zero the outputs have been, and what the last plan left.

        For `resume` [tolerance].
        """
        return [self._above.tolist(), self._below.tolist(), self._left]

    def resume(self, values: Sequence[Any]) -> None:
        """Go on from `values`; ValueError where they are none of these outputs."""
        above, below, left = (np.array(each, float) for each in values)
        if above.shape != self._above.shape or below.shape != above.shape or not left >= 0:
            raise ValueError("not a state of this controller")
        self._above, self._below, self._left = above, below, float(left)
