"""From records and a form to models of all outputs, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import Sensitivities, joint_covariances
from thermaltool.fitting.lpv.form import LpvForm
from thermaltool.fitting.lpv.model import Lpv, LpvOutput, settled
from thermaltool.fitting.lpv.problem import LpvProblem
from thermaltool.fitting.lpv.search import (
    LIKELIHOOD_TOLERANCE,
    ROUGH_TOLERANCE,
    LpvSearchResult,
    search,
)
from thermaltool.signals.criteria import Criteria
from thermaltool.units import Reference

METHOD = "output error, rates and gains by level"


def identify_lpv(
    data: TrainingData,
    form: LpvForm,
    references: tuple[Reference, ...],
    starts: Sequence[Array] = (),
    judged: bool = True,
) -> Lpv:
    """A parameter-varying model of all outputs.

    Parameters
    ----------
    data : TrainingData
        On an even clock.
    form : LpvForm
    references : tuple of "first" or float
        What inputs count from.
    starts : sequence of ndarray, shape (searched,)
        A grid of time constants where there are none.
    judged : bool
        Whether covariances are wanted; else they are zero, and the search ends sooner.

    Raises
    ------
    FitError
        Data that carry no model (`TrainingData.check`), or not so many parameters.
    """
    data.check()
    problem = LpvProblem(settled(data, references), form, references)
    tolerance = LIKELIHOOD_TOLERANCE if judged else ROUGH_TOLERANCE
    return _model(problem, search(problem, starts, tolerance), judged)


def _model(problem: LpvProblem, found: LpvSearchResult, judged: bool) -> Lpv:
    data, form, point = problem.data, problem.form, found.point
    n, own = form.searched, problem.weights
    if judged:
        projected = problem.linearized(point)

        def records() -> Iterator[Sensitivities]:
            for j in range(len(data.records)):
                yield problem.sensitivities(point, projected, j)

        errors = [[each[k] for each in point.errors] for k in range(len(projected))]
        covariances, variances = joint_covariances(projected, errors, records, own)
    else:
        covariances = [np.zeros((n + own, n + own))] * len(data.outputs)
        variances = (point.losses / np.array(point.rows)).tolist()
    shape = (form.modes + form.direct, len(data.inputs), form.shares)
    outputs = tuple(
        LpvOutput(
            names=data.inputs,
            target=data.outputs[k],
            dt=data.period,
            levels=problem.rests,
            zeros=tuple(linear[-data.experiments :].tolist()),
            sigma2=variances[k],
            covariance=covariances[k],
            method=METHOD,
            converged=found.converged,
            rows=point.rows[k],
            loss=float(point.losses[k]),
            form=form,
            scales=problem.scales,
            theta=point.theta,
            weights=linear[:own].reshape(shape),
        )
        for k, linear in enumerate(point.linear)
    )
    parameters = n + sum(output.parameters - n for output in outputs)
    criteria = Criteria(2 * point.criterion, parameters, data.rows)
    return Lpv(outputs, criteria, problem.references)
