"""From records and a number of poles to models of all outputs, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import Sensitivities, joint_covariances
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.fitting.subspace.problem import SubspacePoint, SubspaceProblem
from thermaltool.fitting.subspace.realization import Realization, realizations
from thermaltool.fitting.subspace.search import (
    LIKELIHOOD_TOLERANCE,
    METHOD,
    ROUGH_TOLERANCE,
    SubspaceSearchResult,
    search,
)
from thermaltool.fitting.subspace.sections import PoleSection, all_poles
from thermaltool.responses.rational import MAX_POLES
from thermaltool.signals.criteria import Criteria

# Numbers that are held at once, at most: of longer records every so many rows count.
MAX_NUMBERS = 3e7
# Poles of different sections nearer than this share of their size are one, twice.
MERGED_SHARE = 0.02


def identify_subspace(
    data: TrainingData,
    order: int,
    direct: bool = False,
    beside: Sequence[tuple[PoleSection, ...]] = (),
    found: Sequence[Realization] | None = None,
    judged: bool = True,
    real: bool = False,
) -> Subspace:
    """Poles that all outputs share, and the weights of each.

    Parameters
    ----------
    data : TrainingData
        On an even clock.
    order : int
        Number of poles.
    direct : bool
        Whether outputs may follow the inputs of the same row.
    beside : sequence of tuple of PoleSection
        Further starts: of this order, or of one less.
    found : sequence of Realization, optional
        Of these data, where they are there already.
    judged : bool
        Whether covariances are wanted; else they are zero, and the search ends sooner.
    real : bool
        Real poles alone.

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), more poles than the data carry.
    """
    problem = replace(problem_of(data, order, direct), real=real)
    known = realizations(data, order) if found is None else found
    tolerance = LIKELIHOOD_TOLERANCE if judged else ROUGH_TOLERANCE
    return _model(problem, search(problem, known, order, beside, tolerance), judged)


def problem_of(data: TrainingData, order: int, direct: bool) -> SubspaceProblem:
    """The problem of an order.

    Parameters
    ----------
    data : TrainingData
    order : int
    direct : bool

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), more poles than the data carry.
    """
    data.check()
    if not 1 <= order <= MAX_POLES:
        raise FitError(f"{order} modes: it takes 1 to {MAX_POLES}")
    problem = SubspaceProblem(data, direct)
    size = problem.linear_count(order)
    need = size + order + sum(not r.at_rest for r in data.records) * order
    rows = sum(int(known.sum()) for known in problem.known)
    if rows < 2 * need:
        raise FitError(
            f"{data.outputs[0]}: {rows} rows do not carry {counted(order, 'mode')} with "
            f"{need} parameters: {'take fewer modes or ' * (order > 1)}more data"
        )
    return SubspaceProblem(data, direct, max(1, round(data.rows * size / MAX_NUMBERS)))


def _refuse_merged(sections: tuple[PoleSection, ...], dt: float) -> None:
    """Refuse poles of different sections that are the same (FitError)."""
    for k, section in enumerate(sections[:-1]):
        for p in section.poles:
            others = all_poles(sections[k + 1 :])
            if np.any(np.abs(others - p) < MERGED_SHARE * abs(p)):
                raise FitError(
                    f"two of {sum(s.states for s in sections)} modes fall together at a time "
                    f"constant of {-dt / p.real:.4g} s: the data carry fewer"
                )


def _model(problem: SubspaceProblem, found: SubspaceSearchResult, judged: bool) -> Subspace:
    data, point = problem.data, found.point
    _refuse_merged(point.sections, data.period)
    order, own = sum(s.states for s in point.sections), problem.linear_count(0)
    m, gains = len(data.inputs), problem.linear_count(order) - own
    kept = gains + m * problem.direct
    if judged:
        covariances, variances = subspace_covariances(problem, point, kept)
    else:
        covariances = [np.zeros((order + kept, order + kept))] * len(data.outputs)
        variances = (point.losses / point.rows).tolist()
    outputs = tuple(
        output_of(
            problem, point, k, sections=point.sections, weights=linear[:gains],
            direct=linear[gains:kept], covariance=covariances[k], sigma2=variances[k],
            method=METHOD, converged=found.converged,
        )
        for k, linear in enumerate(point.linear)
    )  # fmt: skip
    parameters = order + sum(output.parameters - order for output in outputs)
    return Subspace(outputs, Criteria(2 * point.criterion, parameters, data.rows))


class _SearchEnd(Protocol):
    """What a search of either kind ends with."""

    @property
    def rows(self) -> int: ...
    @property
    def linear(self) -> Array: ...
    @property
    def losses(self) -> Array: ...


def output_of(problem: SubspaceProblem, point: _SearchEnd, k: int, **own: Any) -> SubspaceOutput:
    """The model of output k.

    Parameters
    ----------
    problem : SubspaceProblem
    point : SubspacePoint or ModalPoint
        Where its search has ended; the last of its linear parameters are the offsets.
    k : int
    **own
        What the search alone knows.
    """
    data = problem.data
    zeros = point.linear[k, -data.experiments :] + problem.centres[k]
    return SubspaceOutput(
        names=data.inputs, target=data.outputs[k], dt=data.period, holds=data.holds,
        levels=data.levels, zeros=tuple(zeros.tolist()), rows=point.rows,
        loss=float(point.losses[k]), **own,
    )  # fmt: skip


def subspace_covariances(
    problem: SubspaceProblem, point: SubspacePoint, own: int
) -> tuple[list[Array], list[float]]:
    """Covariance of the sections and of the first `own` linear parameters of every output.

    Parameters
    ----------
    problem : SubspaceProblem
    point : SubspacePoint
    own : int

    Returns
    -------
    covariances : list of ndarray, shape (N + own, N + own)
    variances : list of float [unit²]
    """
    projected = problem.linearized(point)
    place = np.arange(len(point.gram))

    def records() -> Iterator[Sensitivities]:
        for j, columns in enumerate(point.columns):
            slopes = [
                whole - f.by_searched.T @ columns
                for whole, f in zip(problem.slopes(j, point), projected, strict=True)
            ]
            slopes = [problem.spread(j, own) for own in slopes]
            yield Sensitivities(place, slopes, [problem.spread(j, columns)] * len(projected))

    errors = problem.errors_on_clock(point)
    taken = sum(starts.shape[1] for starts in point.starts)
    return joint_covariances(projected, errors, records, own, taken)
