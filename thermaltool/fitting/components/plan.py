"""Plan of few components of many inputs: how many, through which lags."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.components.choose import choices_of, ranked
from thermaltool.fitting.components.model import ComponentOutput, output_of
from thermaltool.fitting.components.problem import ComponentProblem
from thermaltool.fitting.components.reduction import Reduction, moving_inputs
from thermaltool.fitting.data import MIN_INDEPENDENCE, TrainingData
from thermaltool.fitting.error_model import runs_of
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.start_state import StartErrors, with_start
from thermaltool.signals.agreement import agreement


@dataclass(frozen=True, kw_only=True)
class ComponentPlan(Plan):
    """Few components of many inputs, through lags, with a ridge.

    Attributes
    ----------
    reduction : Reduction
    """

    reduction: Reduction = field(default_factory=Reduction)

    def start(self, data: TrainingData) -> TrainingData:
        moving = data.driven_by(moving_inputs(data))
        found = with_start(moving.driven_by(_independent(moving)), self.initial, self._errors)
        at_rest = [record.at_rest for record in found.records]
        return replace(data, records=tuple(
            replace(r, at_rest=known) for r, known in zip(data.records, at_rest, strict=True)
        ))  # fmt: skip

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[ComponentOutput], tuple[Candidate[ComponentOutput], ...]]:
        names = moving_inputs(data)
        idle = tuple(name for name in data.inputs if name not in names)
        data = data.driven_by(names)
        problem = ComponentProblem(data, self.reduction)
        found = ranked(problem)
        best = output_of(problem, found[0][0], idle)
        spread = float(np.std(problem.output))
        # One line for each number of components: its best lags.
        candidates, seen = [], set[int]()
        for weights, error, score in found:
            if weights.choice.components not in seen:
                seen.add(weights.choice.components)
                own = best if weights is found[0][0] else output_of(problem, weights)
                fit = 100 * (1 - error / spread)
                candidates.append(Candidate(own, (fit,), score))
        return (best,), tuple(candidates)

    def _errors(self, data: TrainingData) -> StartErrors | None:
        """Errors of the choice of most evidence; None where there are too few rows."""
        try:
            problem = ComponentProblem(data, self.reduction)
        except FitError:
            return None
        found = problem.fit(np.ones(len(problem.output), bool), list(choices_of(problem)))
        model = output_of(problem, min(found, key=lambda each: each.level))
        errors = data.output() - model.run(data)
        rmse = agreement(data.output(), model.run(data)).rmse
        return StartErrors([rmse**2], lambda: [runs_of(errors)])


def _independent(data: TrainingData) -> tuple[str, ...]:
    """Inputs without those that are combinations of the ones before."""
    kept: list[str] = []
    columns = np.hstack([u - u.mean(axis=1, keepdims=True) for u in data.u])
    columns = columns / np.linalg.norm(columns, axis=1, keepdims=True)
    basis = np.zeros((0, columns.shape[1]))
    for name, column in zip(data.inputs, columns, strict=True):
        left = column - basis.T @ (basis @ column)
        size = float(np.linalg.norm(left))
        if size**2 > 10 * MIN_INDEPENDENCE:
            kept.append(name)
            basis = np.vstack([basis, left / size])
    return tuple(kept)
