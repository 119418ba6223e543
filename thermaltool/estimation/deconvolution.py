"""Heat of one drive from a whole record, by a method and a parameter that a rule chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from thermaltool.errors import FitError, LogError, ModelError, counted
from thermaltool.estimation.constrained import Bounds, ConstrainedProblem, SplitState
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.function_specification import FunctionSpecification, specification_path
from thermaltool.estimation.parameter_rules import RULES, Path, Rule, RuleChoice, apply_rules
from thermaltool.estimation.penalties import HeatProblem
from thermaltool.estimation.tikhonov import TikhonovPath, tikhonov, tikhonov_path
from thermaltool.responses.modes import Float
from thermaltool.responses.parallel import parallel
from thermaltool.responses.sample_clock import clock_step

Method = Literal["tikhonov0", "tikhonov1", "tikhonov2", "tv", "beck"]
METHODS: tuple[Method, ...] = get_args(Method)

WITHOUT_LIKELIHOOD = "tv", "beck"
# Fewer rows tell no parameter.
MIN_ROWS = 20
# Expected errors within this ratio are equal [1]; the order of merit decides.
EQUAL_ERRORS = 1.02
# Weights of total variation, over that of a Laplace distribution as wide as the steps of the most
# likely random walk [1].
VARIATION_WEIGHTS = np.geomspace(160.0, 0.25, 9)
# The quadratic step of total variation, over the weight of that random walk [1]: the fastest on
# simulated machines.
VARIATION_PACE = 2.0
# Turns of a search at each weight, of which a rule takes one that is then searched to its end: on
# simulated walls the error came within 7 % of that of a grid of ends, in a third of the time.
SCOUTING_TURNS = 40
# A longer record is scouted over its first so many rows, or over more, until they hold their part
# of the changes of the heat: the best weight hangs on noise and steps, not on how long a record is.
SCOUTED_ROWS = 20000
# Residuals that are so many times the noise are told [1].
LARGE_RESIDUAL = 2.0


@dataclass(frozen=True)
class DeconvolutionPlan:
    """What is asked.

    Attributes
    ----------
    method : Method
    rule : Rule or None
        None for that with the least expected error, where that is known; else the first of `RULES`
        that is not refused.
    low, high : float or None
        Bounds of the heat [unit of the drive].
    future : int or None
        Future rows of "beck"; None for what a rule says.
    """

    method: Method
    rule: Rule | None = None
    low: float | None = None
    high: float | None = None
    future: int | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"no method {self.method!r}; there are {', '.join(METHODS)}")
        if self.rule not in (None, *RULES):
            raise ValueError(f"no rule {self.rule!r}; there are {', '.join(RULES)}")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"bounds from {self.low:g} to {self.high:g} leave no heat")
        if self.future is not None and self.method != "beck":
            raise ValueError("future rows go with the method beck")
        if self.future is not None and self.future < 1:
            raise ValueError(f"{self.future} future rows are none")
        if self.future is not None and self.rule is not None:
            raise ValueError("the future rows are given: there is nothing for a rule to choose")


@dataclass(frozen=True)
class Deconvolved:
    """The heat, and how its parameter was chosen.

    Attributes
    ----------
    plan : DeconvolutionPlan
    heat : ndarray, shape (n,) [unit of the drive]
    drive : str
    parameter : float
        λ, or the number of future rows.
    choices : tuple of RuleChoice
        What every rule says; empty where the parameter was given.
    chosen : Rule or None
    reason : str
        Why this one.
    notes : tuple of str
        What a user should know.
    residual_over_noise : float
        Root mean square of the residuals of this heat over that of the noise [1].
    """

    plan: DeconvolutionPlan
    heat: Float
    drive: str
    parameter: float
    choices: tuple[RuleChoice, ...]
    chosen: Rule | None
    reason: str
    notes: tuple[str, ...] = ()
    residual_over_noise: float = np.nan


def deconvolve(
    kalman: KalmanEstimator,
    time: Float,
    readings: Float,
    level: float,
    plan: DeconvolutionPlan,
    acting: Callable[[float], float] = float,
) -> Deconvolved:
    """The heat of the one drive, the machine at rest at the start.

    Parameters
    ----------
    kalman : KalmanEstimator
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        Relative to rest.
    level : float
        The drive's largest size in the calibration [unit of the drive].
    plan : DeconvolutionPlan
    acting : callable
        From a bound to that of the heat that acts.

    Raises
    ------
    ModelError
        More drives than one.
    LogError
        An uneven clock, missing readings, too few rows.
    FitError
        The rule has no answer.
    """
    if plan.rule == "likelihood" and plan.method in WITHOUT_LIKELIHOOD:
        raise FitError(f"--rule likelihood: {plan.method} has no likelihood in closed form")
    problem = _problem(kalman, time, readings, level)
    found = _deconvolved(problem, readings, plan, acting)
    misfit = problem.misfit(readings - problem.simulated(found.heat))
    ratio = float(np.sqrt(misfit / readings.size))
    bounded = (plan.low, plan.high) != (None, None)
    # Beck's method leaves what is quicker than its future rows, whatever the noise.
    if ratio > LARGE_RESIDUAL and (bounded or plan.method != "beck"):
        told = f"the bounds leave residuals of {ratio:.3g} times the noise"
        if not bounded:
            told = (f"the residuals are {ratio:.3g} times the noise: model and machine have "
                    "parted, a sensor is wrong, the noise is larger, or the weight too large "
                    "(--smooth asks which)"
                    )  # fmt: skip
        found = replace(found, notes=(*found.notes, told))
    return replace(found, residual_over_noise=ratio)


def _deconvolved(
    problem: HeatProblem, readings: Float, plan: DeconvolutionPlan, acting: Callable[[float], float]
) -> Deconvolved:
    kalman, level = problem.estimator, problem.level
    ends = sorted(acting(end) for end in (plan.low, plan.high) if end is not None)
    if len(ends) == 2:
        bounds = Bounds(*ends)
    else:
        bounds = Bounds(-np.inf if plan.low is None else ends[0],
                        np.inf if plan.high is None else ends[0])  # fmt: skip
    if plan.future is not None:
        if 2 * plan.future > len(readings):
            raise LogError(f"{plan.future} future rows are more than half of the record's "
                           f"{len(readings)}")  # fmt: skip
        heat = FunctionSpecification(problem, plan.future).run(readings, bounds.low, bounds.high)
        return Deconvolved(plan, heat, kalman.drives[0], plan.future, (), None, "given")
    walk = tikhonov_path(problem, readings, 1)
    if plan.method == "beck":
        path = specification_path(problem, readings, bounds.low, bounds.high)
        path = replace(path, expected_error=walk.expected_error(path.solutions))
        choices, choice, reason = _chosen(path, plan)
        future = round(choice.parameter or 1.0)
        heat = FunctionSpecification(problem, future).run(readings, bounds.low, bounds.high)
        return Deconvolved(plan, heat, kalman.drives[0], future, choices, choice.rule, reason)
    if plan.method == "tv":
        return _varied(problem, readings, walk, plan, bounds)
    order = int(plan.method[-1])
    own = walk if order == 1 else tikhonov_path(problem, readings, order)
    # What the readings themselves make of both priors.
    likelier = max(own, walk, key=lambda each: float(np.max(each.log_likelihood)))
    path = replace(own.path, expected_error=likelier.expected_error(own.path.solutions))
    choices, choice, reason = _chosen(path, plan)
    weight = float(choice.parameter or 1.0)
    notes: tuple[str, ...] = ()
    heat = tikhonov(problem, readings, order, weight)
    if not bounds.free:
        spread = float(np.sqrt(own.variance[round(choice.place or 0.0)]))
        search = ConstrainedProblem(problem, readings, order, weight, spread, bounds)
        heat, converged = search.solve(0.0, SplitState.of(heat, level, bounds))
        notes = () if converged else ("the search within bounds was stopped before it stood still",)
    return Deconvolved(plan, heat, kalman.drives[0], weight, choices, choice.rule, reason, notes)


def _varied(
    problem: HeatProblem,
    readings: Float,
    walk: TikhonovPath,
    plan: DeconvolutionPlan,
    bounds: Bounds,
) -> Deconvolved:
    """Total variation over a grid of weights, each search begun where the last one stopped."""
    weight = float(walk.path.parameter[walk.best])
    spread = float(np.sqrt(walk.variance[walk.best]))
    search = ConstrainedProblem(problem, readings, None, VARIATION_PACE * weight, spread, bounds)
    weights = np.sqrt(2 * weight) * VARIATION_WEIGHTS
    begun = walk.path.solutions[walk.best]
    count = _scouted_rows(begun)
    seen, short = readings[:count], search
    if count < len(readings):
        short = ConstrainedProblem(problem, seen, None, search.weight, spread, bounds)
    state = SplitState.of(begun[:count], problem.level, bounds)
    solutions, steps = np.empty((len(weights), count)), np.empty(len(weights))
    states = []
    for k, each in enumerate(weights):
        solutions[k], _ = short.solve(float(each), state, SCOUTING_TURNS)
        steps[k] = np.count_nonzero(state.steps)
        states.append(replace(state))
    misfit = [problem.misfit(seen - problem.simulated(heat)) for heat in solutions]
    variation = np.sum(np.abs(np.diff(solutions, axis=1, prepend=0.0)), axis=1) / problem.level
    # The degrees of freedom are the steps that are there (Tibshirani and Taylor 2011).
    path = Path(weights, solutions, np.array(misfit), seen.size,
                np.maximum(steps, 1.0), variation**2, is_stepped=True)  # fmt: skip
    choices, choice, reason = _chosen(path, plan)
    at = round(choice.place or 0.0)
    state = states[at]
    if count < len(readings):
        state = SplitState.of(begun, problem.level, bounds)
    heat, converged = search.solve(float(weights[at]), state)
    ratio = float(np.sqrt(problem.misfit(readings - problem.simulated(heat)) / readings.size))
    choices = tuple(
        replace(each, residual_over_noise=ratio) if each == choice else each for each in choices
    )
    notes = () if converged else ("the search was stopped before it stood still",)
    return Deconvolved(plan, heat, problem.estimator.drives[0], float(weights[at]),
                       choices, choice.rule, reason, notes)  # fmt: skip


def _scouted_rows(heat: Float) -> int:
    """Rows over which weights are tried: as many as have their part of the changes."""
    changes = np.cumsum(np.abs(np.diff(heat, prepend=0.0)))
    held = changes >= changes[-1] * np.arange(1, len(heat) + 1) / len(heat)
    held[: SCOUTED_ROWS - 1] = False
    return int(np.argmax(held)) + 1 if held.any() else len(heat)


def _chosen(path: Path, plan: DeconvolutionPlan) -> tuple[tuple[RuleChoice, ...], RuleChoice, str]:
    choices = apply_rules(path)
    if plan.rule is not None:
        choice = next(each for each in choices if each.rule == plan.rule)
        # What is refused by its expected error alone can be had by name.
        if choice.place is None:
            raise FitError(f"--rule {plan.rule}: {choice.reason}")
        return choices, choice, "given"
    usable = [each for each in choices if not each.reason]
    if not usable and path.expected_error is not None:
        place = int(np.argmin(path.expected_error))
        parameter, error = float(path.parameter[place]), float(path.expected_error[place])
        best = RuleChoice(None, float(place), parameter, expected_error=error)
        return choices, best, "the least expected error of the grid; every rule is refused"
    if not usable:
        told = "; ".join(f"{each.rule}: {each.reason}" for each in choices)
        raise FitError(f"no rule has an answer ({told}); give --rule, or another --method")
    if path.expected_error is not None:
        least = min(each.expected_error or np.inf for each in usable)
        near = [each for each in usable if (each.expected_error or np.inf) <= EQUAL_ERRORS * least]
        reason = "the least expected error" if len(near) < 2 else (
            f"the least expected error, as {_listed(near[1:])}")  # fmt: skip
        return choices, near[0], reason
    before = choices[: choices.index(usable[0])]
    refused = f" after {_listed(before)}, refused" if before else ""
    return choices, usable[0], f"the first in the order of merit{refused}"


def _listed(choices: Sequence[RuleChoice]) -> str:
    return ", ".join(str(each.rule) for each in choices)


def _problem(kalman: KalmanEstimator, time: Float, readings: Float, level: float) -> HeatProblem:
    if len(kalman.drives) != 1:
        raise ModelError(
            f"--method takes one drive, and {len(kalman.drives)} are estimated "
            f"({', '.join(kalman.drives)}): --smooth takes several"
        )
    if len(time) < MIN_ROWS:
        raise LogError(
            f"{counted(len(time), 'row')}: too few for --method: give {MIN_ROWS} or more"
        )
    for name, column in zip(kalman.sensors, readings.T, strict=True):
        if len(none := np.flatnonzero(np.isnan(column))):
            raise LogError(
                f"{name} has no reading in {counted(len(none), 'row')}, from {time[none[0]]:g} s "
                "on: --method takes all; --smooth counts what is there"
            )
    steps = np.diff(time)
    period = float(np.median(steps))
    odd = np.flatnonzero(np.abs(steps - period) > clock_step(time))
    if len(odd):
        k = int(odd[0])
        raise LogError(
            f"the clock is uneven: a sample of {steps[k]:g} s at {time[k]:g} s, where {period:g} s "
            "is usual; --method takes an even one, --smooth any"
        )
    return HeatProblem(kalman, period, level)


def followed(kalman: KalmanEstimator, dt: float, heat: Float) -> Float:
    """Heat and what follows it: all estimates of the Kalman form, shape (n, n_estimates).

    Parameters
    ----------
    kalman : KalmanEstimator
        Of one drive.
    dt : float [s]
    heat : ndarray, shape (n,)
    """
    behind = parallel(kalman.followed, ["zero"], len(kalman.outputs), dt)
    return np.column_stack([heat, behind.run(heat[:, None])[0]])
