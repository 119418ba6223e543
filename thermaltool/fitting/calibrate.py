"""Calibration of responses to measured logs with any known input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from thermaltool.errors import FitError
from thermaltool.fitting.discrepancy import Discrepancy, discrepancy
from thermaltool.fitting.projection import Candidate, Compressed, OutputRecord, Problem
from thermaltool.responses import Response, response_class
from thermaltool.responses.modes import Float, Hold

Loss = Literal["linear", "huber"]

# A rate or shape is not identified when its standard error is above this share of its value;
# a steady state when its standard error is above `UNSETTLED`.
UNIDENTIFIED = 0.5
UNSETTLED = 0.1
# A record shorter than this many of the slowest time constants does not show the steady state:
# its covariance, linear around the fit, is then too narrow to be believed.
SETTLED_PERIODS = 3
# Residuals beyond this many robust standard deviations count linearly (Huber).
HUBER = 2.5


@dataclass(frozen=True)
class Fit:
    """One output, calibrated.

    Attributes
    ----------
    responses : tuple of Response, one for each drive
    names : tuple of str
        The fitted parameters: of each response its searched ones, then all gains, then offsets.
    covariance : ndarray, shape (len(names), len(names))
        From sums of scores over blocks of time, so that slow noise counts.
    offsets : tuple of float, one for each record
    rmse, max_error : float [unit of the output]
    fit_percent : float
        (1 − ‖y − ŷ‖/‖y − ȳ‖)·100.
    unidentified : tuple of str
        What these records do not settle, each a sentence.
    starts : tuple of float
        RMSE that each refined start reached, the best first [unit of the output].
    covered : float
        Slowest time constants that the longest record covers.
    discrepancy : Discrepancy
        Of the searched parameters (by logarithm) and gains, in the order of `names`, then of
        `lags` for every drive.
    lags : tuple of float
        Time constants [s].
    """

    responses: tuple[Response, ...]
    names: tuple[str, ...]
    covariance: Float
    offsets: tuple[float, ...]
    rmse: float
    max_error: float
    fit_percent: float
    unidentified: tuple[str, ...]
    starts: tuple[float, ...]
    covered: float
    discrepancy: Discrepancy
    lags: tuple[float, ...]


def fit_output(
    records: Sequence[OutputRecord],
    kinds: Sequence[str],
    holds: Sequence[Hold],
    fixed: Mapping[str, float] | None = None,
    loss: Loss = "huber",
    starts: int = 6,
    free_start: bool = False,
    progress: Callable[[str], None] = lambda message: None,
) -> Fit:
    """Fit one output to its drives over all records at once.

    Parameters
    ----------
    records : sequence of OutputRecord
        At rest at their first row, unless `free_start`.
    kinds : sequence of str
        Kind of response for each drive.
    holds : sequence of "zero" or "first"
    fixed : mapping of parameter name to value, optional
        Overrides the defaults of parameters that are not fitted (``r0``).
    loss : "linear" or "huber"
        Huber by iterated reweighting.
    starts : int
        How many of the best points of a coarse grid are refined.
    free_start : bool
        The machine came from another level: each gain gets a decay per record.

    Raises
    ------
    FitError
        A drive that never moves, fewer rows than parameters, no start with a finite error.
    """
    classes = tuple(response_class(kind) for kind in kinds)
    constants = tuple({k: (fixed or {}).get(k, v) for k, v in c.fixed.items()} for c in classes)
    candidate = Candidate(classes, constants)
    for record in records:
        if len(record.time) < 2:
            raise FitError(f"a log of {len(record.time)} rows says nothing of a response")
    for k in range(len(kinds)):
        if not any(np.ptp(r.drives[k]) > 0 or np.any(r.drives[k]) for r in records):
            raise FitError("the drive never leaves its reference: nothing to fit")
    problem = Problem.assemble(records, holds, free_start)
    unknowns = sum(len(c.searched) + len(c.gains) for c in classes) + len(records)
    if len(problem.measured) <= unknowns:
        raise FitError(f"{len(problem.measured)} rows are too few for {unknowns} parameters")

    duration = max(float(r.time[-1] - r.time[0]) for r in records)
    period = min(float(np.median(np.diff(r.time))) for r in records)
    boxes = [
        cls.search_box(period, duration, **constant)
        for cls, constant in zip(classes, constants, strict=True)
    ]
    limits = np.log(
        [box[name] for c, box in zip(classes, boxes, strict=True) for name in c.searched]
    )
    bounds = (limits[:, 0], limits[:, 1])
    scale = float(np.std(problem.measured)) * np.sqrt(len(problem.measured)) or 1.0

    def errors(theta: Float, compressed: Compressed) -> Float:
        return problem.project(candidate.unit_weights(theta, problem.grid), compressed)[0] / scale

    def refine(theta: Float, compressed: Compressed) -> tuple[float, Float]:
        inside = np.clip(theta, bounds[0] + 1e-9, bounds[1] - 1e-9)
        solution = least_squares(
            errors, inside, bounds=bounds, x_scale=0.3, xtol=1e-10, ftol=1e-13, args=(compressed,)
        )
        return float(np.linalg.norm(errors(solution.x, compressed))), solution.x

    weights = np.ones(len(problem.measured))
    compressed = problem.compress(weights)
    grid = [np.log(theta) for theta in _joint_starts(classes, constants, period, duration)]
    sizes = np.array([np.linalg.norm(errors(theta, compressed)) for theta in grid])
    order = [k for k in np.argsort(sizes) if np.isfinite(sizes[k])][:starts]
    if not order:
        raise FitError("no start of the search has a finite error")
    reached = []
    for number, k in enumerate(order):
        progress(f"start {number + 1} of {len(order)}")
        reached.append(refine(grid[k], compressed))
    reached.sort(key=lambda result: result[0])
    theta = reached[0][1]
    if loss == "huber":
        for _ in range(8):
            residual = _residual(problem, candidate, theta, compressed)[0]
            spread = 1.4826 * float(np.median(np.abs(residual)))
            new = np.minimum(1.0, HUBER * spread / np.maximum(np.abs(residual), 1e-300))
            if spread == 0 or np.max(np.abs(new - weights)) < 1e-3:
                break
            weights, compressed = new, problem.compress(new)
            theta = refine(theta, compressed)[1]
    rmses = tuple(size * scale / np.sqrt(len(problem.measured)) for size, _ in reached)
    return _describe(problem, candidate, theta, compressed, weights, duration, rmses)


def _joint_starts(
    classes: tuple[type[Response], ...],
    constants: tuple[dict[str, float], ...],
    period: float,
    duration: float,
) -> list[tuple[float, ...]]:
    """Starts of every response side by side; several drives share their place in the grid."""
    lists = [
        cls.starts(period, duration, **constant)
        for cls, constant in zip(classes, constants, strict=True)
    ]
    longest = max(map(len, lists))
    return [sum((each[k % len(each)] for each in lists), ()) for k in range(longest)]


def _residual(
    problem: Problem, candidate: Candidate, theta: Float, compressed: Compressed
) -> tuple[Float, Float]:
    """Residual of every row, and the linear part."""
    unit = candidate.unit_weights(theta, problem.grid)
    _, linear = problem.project(unit, compressed)
    return problem.measured - problem.design @ (problem.combine(unit) @ linear), linear


def _describe(
    problem: Problem,
    candidate: Candidate,
    theta: Float,
    compressed: Compressed,
    weights: Float,
    duration: float,
    starts: tuple[float, ...],
) -> Fit:
    residual, linear = _residual(problem, candidate, theta, compressed)
    gains = sum(len(c.gains) for c in candidate.classes)
    responses = candidate.responses(theta, linear[:gains])
    several = len(responses) > 1
    names = [
        f"{name}[{k}]" if several else name
        for group in ("searched", "gains")
        for k, cls in enumerate(candidate.classes)
        for name in getattr(cls, group)
    ]
    jacobian = _jacobian(problem, candidate, theta, linear)
    covariance = block_covariance(jacobian, residual, problem.record, weights)
    # From logarithms to the parameters themselves.
    factor = np.concatenate([np.exp(theta), np.ones(len(linear))])
    covariance = covariance * np.outer(factor, factor)
    keep = [*range(len(theta) + gains), *range(-problem.records, 0)]
    covariance = covariance[np.ix_(keep, keep)]
    own, free = np.arange(len(theta) + gains), np.arange(len(theta) + gains, jacobian.shape[1])
    n = len(problem.grid.rates)
    # Slower than the record is no shape: it would pass for any drift.
    lags = np.flatnonzero(problem.grid.rates >= 1 / duration)
    bank = problem.design[:, np.concatenate([d * n + lags for d in range(problem.drives)])]
    spread = problem.measured - np.mean(problem.measured)
    variation = float(np.linalg.norm(spread))
    share = float(np.linalg.norm(residual)) / variation if variation else 1.0
    deviation = np.sqrt(np.diag(covariance))
    return Fit(
        responses=responses,
        names=(*names, *(f"offset[{k}]" for k in range(problem.records))),
        covariance=covariance,
        offsets=tuple(linear[-problem.records :].tolist()),
        rmse=float(np.sqrt(np.mean(residual**2))),
        max_error=float(np.max(np.abs(residual))),
        fit_percent=100 * (1 - share),
        unidentified=tuple(
            _unidentified(names, np.exp(theta), deviation)
            + _unsettled(responses, candidate, covariance, duration)
        ),
        starts=starts,
        discrepancy=discrepancy(
            problem.time,
            problem.record,
            residual,
            jacobian[:, own],
            jacobian[:, free],
            bank,
            np.append(np.ones(len(theta)), np.full(gains, np.max(np.abs(linear[:gains])))),
        ),
        lags=tuple((1 / problem.grid.rates[lags]).tolist()),
        covered=duration / max(response.slowest() for response in responses),
    )


def _jacobian(problem: Problem, candidate: Candidate, theta: Float, linear: Float) -> Float:
    """Sensitivity of every row to the logarithms, then to the linear part."""
    columns = []
    for k in range(len(theta)):
        step = np.zeros(len(theta))
        step[k] = 1e-4
        ahead = problem.combine(candidate.unit_weights(theta + step, problem.grid)) @ linear
        behind = problem.combine(candidate.unit_weights(theta - step, problem.grid)) @ linear
        columns.append(problem.design @ ((ahead - behind) / 2e-4))
    unit = candidate.unit_weights(theta, problem.grid)
    return np.column_stack([*columns, problem.design @ problem.combine(unit)])


def block_covariance(jacobian: Float, residual: Float, owner: np.ndarray, weights: Float) -> Float:
    """Covariance of least-squares parameters under noise of unknown colour.

    Sandwich estimator with scores summed over blocks of rows, several times as many as
    parameters, so that noise slower than a sample but faster than a block counts in full.

    Parameters
    ----------
    jacobian : ndarray, shape (rows, p)
    residual : ndarray, shape (rows,)
    owner : ndarray of int, shape (rows,)
        Which record a row belongs to; a block does not cross records.
    weights : ndarray, shape (rows,)
        Huber's weights of the squares: below 1 where a residual counts linearly.
    """
    p = jacobian.shape[1]
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    scaled = jacobian / size
    # A score that has stopped growing with the residual holds no curvature.
    curved = scaled[weights >= 1]
    bread = np.linalg.pinv(curved.T @ curved, rcond=1e-14, hermitian=True)
    blocks = min(max(4 * p, 30), len(residual))
    label = owner * (blocks + 1) + np.arange(len(residual)) * blocks // len(residual)
    starts = np.flatnonzero(np.diff(label, prepend=-1))
    scores = np.add.reduceat(scaled * (weights * residual)[:, None], starts, axis=0)
    meat = scores.T @ scores * len(scores) / max(len(scores) - p, 1)
    return np.asarray(bread @ meat @ bread / np.outer(size, size))


def _unidentified(names: Sequence[str], values: Float, deviation: Float) -> list[str]:
    weak = [
        f"{name} ({value:.3g} ± {error:.2g})"
        for name, value, error in zip(names, values, deviation, strict=False)
        if error > UNIDENTIFIED * value
    ]
    return [f"not identified one by one: {', '.join(weak)}"] if weak else []


def _unsettled(
    responses: tuple[Response, ...], candidate: Candidate, covariance: Float, duration: float
) -> list[str]:
    """Steady states that the records do not reach: the gain's error by linear propagation."""
    found = []
    total = sum(len(c.searched) for c in candidate.classes)
    at, gain_at = 0, total
    for cls, fixed, response in zip(candidate.classes, candidate.fixed, responses, strict=True):
        names = (*cls.searched, *cls.gains)
        index = [*range(at, at + len(cls.searched)), *range(gain_at, gain_at + len(cls.gains))]
        values = {name: getattr(response, name) for name in names}
        gradient = []
        for name in names:
            step = 1e-4 * abs(values[name]) or 1e-6
            ahead = cls(**{**values, name: values[name] + step}, **fixed).dc_gain()
            behind = cls(**{**values, name: values[name] - step}, **fixed).dc_gain()
            gradient.append((ahead - behind) / (2 * step))
        error = float(np.sqrt(max(0.0, gradient @ covariance[np.ix_(index, index)] @ gradient)))
        slowest = response.slowest()
        short = duration < SETTLED_PERIODS * slowest
        if error > UNSETTLED * abs(response.dc_gain()) or short:
            found.append(
                f"the steady state ({response.dc_gain():.4g} ± {error:.2g}) is not settled: the "
                f"record covers {duration / slowest:.2g} of the slowest time constant, "
                f"{slowest:.3g} s"
            )
        at += len(cls.searched)
        gain_at += len(cls.gains)
    return found
