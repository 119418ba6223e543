"""Models whose poles each take one combination of the inputs: grown pole by pole, and refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import joint_covariances
from thermaltool.fitting.subspace.identify import identify_subspace, output_of, problem_of
from thermaltool.fitting.subspace.modal_problem import ModalPoint, ModalProblem, ModalStart
from thermaltool.fitting.subspace.model import Subspace
from thermaltool.fitting.subspace.search import (
    ADDED_POLES,
    FOLLOWED_STARTS,
    LIKELIHOOD_TOLERANCE,
    MAX_ITERATIONS,
    MAX_START_ROWS,
    MAX_STEP,
    ROUGH_TOLERANCE,
    bounded,
)
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import Minimum, minimize

METHOD = "output error, each taking one combination of the inputs"


def grown(data: TrainingData, largest: int, direct: bool = False) -> Iterator[Subspace]:
    """Models of one pole, two, and so on, each from the one before.

    Parameters
    ----------
    data : TrainingData
        On an even clock, of several inputs and outputs.
    largest : int
        Number of poles, at most.
    direct : bool
        Whether outputs may follow the inputs of the same row.
    """
    start = ModalStart(np.zeros(0), np.zeros((0, len(data.inputs))))
    for order in range(1, largest + 1):
        try:
            problem = _problem(data, order, direct)
        except FitError:
            return
        rates = np.log(1 / np.geomspace(0.3, data.longest / 2, ADDED_POLES))
        starts = problem.one_more(problem.project(start), rates)
        ends = [_refined(problem, each, ROUGH_TOLERANCE) for each in starts[:FOLLOWED_STARTS]]
        best = min(ends, key=lambda end: end.point.criterion)
        start = best.point.start
        yield _model(best, judged=False)


def identify_modal(data: TrainingData, known: Subspace, judged: bool = True) -> Subspace:
    """The same poles and participations, refined on given data.

    Parameters
    ----------
    data : TrainingData
        On an even clock.
    known : Subspace
        With participations.
    judged : bool
        Whether covariances are wanted; else they are zero, and the search ends sooner.

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), more poles than the data carry.
    """
    assert known.participations is not None
    problem = ModalProblem(problem_of(data, known.order, known.has_direct))
    own = known.participations * problem.scales
    own = own / np.linalg.norm(own, axis=1, keepdims=True)
    start = ModalStart(np.array([section.theta[0] for section in known.sections]), own)
    tolerance = LIKELIHOOD_TOLERANCE if judged else ROUGH_TOLERANCE
    return _model(_refined(problem, start, tolerance), judged)


def fitted_as(
    data: TrainingData, known: Subspace, judged: bool = True, real: bool = False
) -> Subspace:
    """A model of the same structure, from the same poles, fitted to given data.

    Parameters
    ----------
    data, known, judged, real
        As for `identify_modal` and `identify_subspace`, which `known` comes from.

    Raises
    ------
    FitError
        As these.
    """
    if known.participations is not None:
        return identify_modal(data, known, judged)
    return identify_subspace(
        data, known.order, known.has_direct, [known.sections], judged=judged, real=real
    )


def _problem(data: TrainingData, order: int, direct: bool) -> ModalProblem:
    """The problem on as many rows as starts are compared on."""
    whole = problem_of(data, order, direct)
    return ModalProblem(replace(whole, stride=max(whole.stride, data.rows // MAX_START_ROWS)))


def _refined(problem: ModalProblem, start: ModalStart, tolerance: float) -> Minimum[ModalPoint]:
    """Damped Gauss-Newton over the logarithms of the rates and the participations."""
    longest = problem.data.longest

    def normal_equations(here: ModalPoint) -> tuple[Array, Array]:
        parts = here.linearized
        matrix = sum(f.rows / f.loss * f.reduced for f in parts)
        return np.asarray(matrix), np.asarray(sum(f.rows / f.loss * f.pull for f in parts))

    def stepped(here: ModalPoint, step: Array) -> ModalPoint:
        step, n = np.clip(step, -MAX_STEP, MAX_STEP), len(here.start.rates)
        there = ModalStart(here.start.rates + step[:n], np.zeros((0, 0)))
        rates = np.array([each.theta[0] for each in bounded(there.sections, longest)])
        turned = np.einsum("nt,ntm->nm", step[n:].reshape(n, -1), here.tangents)
        turned += here.start.participations
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        return problem.project(ModalStart(rates, turned))

    return minimize(
        problem.project(start),
        lambda here: 2 * here.criterion,
        normal_equations,
        stepped,
        lambda here: 2 * tolerance,
        MAX_ITERATIONS,
    )


def _model(found: Minimum[ModalPoint], judged: bool) -> Subspace:
    point, data = found.point, found.point.problem.data
    n, m = point.start.participations.shape
    # By the inputs in their units.
    turned = point.start.participations / point.problem.scales
    sizes = np.linalg.norm(turned, axis=1, keepdims=True)
    tangents = point.tangents / point.problem.scales
    d = m * point.problem.problem.direct
    zero = np.zeros((n + n * m + d, n + n * m + d))
    covariances, variances = [zero] * len(point.linear), (point.losses / point.rows).tolist()
    if judged:
        own = [point.errors_of(piece) @ piece.values for piece in point.pieces]
        own = [point.problem.problem.spread(j, each, np.nan) for j, each in enumerate(own)]
        errors = [[each[k] for each in own] for k in range(len(point.linear))]
        taken = sum(piece.taken.shape[1] for piece in point.pieces)
        found_covariances, variances = joint_covariances(
            point.linearized, errors, point.sensitivities, n + d, taken
        )
        covariances = []
        for linear, covariance in zip(point.linear, found_covariances, strict=True):
            # From rates, tangents and weights by pole to rates and weights by pole and input.
            turn = np.zeros((n + n * m + d, n * m + n + d))
            turn[n + n * m :, n * m + n :] = np.eye(d)
            turn[:n, :n] = np.eye(n)
            for k in range(n):
                place = slice(n + k * m, n + (k + 1) * m)
                turn[place, n + k * (m - 1) : n + (k + 1) * (m - 1)] = linear[k] * tangents[k].T
                turn[place, n * m + k] = turned[k]
            covariances.append(turn @ covariance @ turn.T)
    outputs = tuple(
        output_of(
            point.problem.problem, point, k, sections=point.start.sections,
            weights=(linear[:n, None] * turned).ravel(), direct=linear[n : n + d],
            covariance=covariances[k], sigma2=variances[k], method=METHOD,
            converged=found.converged, participations=turned / sizes,
        )
        for k, linear in enumerate(point.linear)
    )  # fmt: skip
    linear_count = sum(len(linear) for linear in point.linear)
    # Candidates are compared as of all rows, also where some of them are fitted.
    whole = 2 * point.criterion * data.rows / point.rows
    return Subspace(outputs, Criteria(whole, n * m + linear_count, data.rows))
