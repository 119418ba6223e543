"""Plan of few components of many inputs: how many, through which lags."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from thermaltool.fitting.components.choose import choices_of, ranked
from thermaltool.fitting.components.model import ComponentOutput, output_of
from thermaltool.fitting.components.problem import ComponentProblem
from thermaltool.fitting.components.reduction import Reduction, moving_inputs
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.start_state import MIN_EVIDENCE, begins_idle


@dataclass(frozen=True, kw_only=True)
class ComponentPlan(Plan):
    """Few components of many inputs, through lags, with a ridge.

    Attributes
    ----------
    reduction : Reduction
    """

    reduction: Reduction = field(default_factory=Reduction)

    def start(self, data: TrainingData) -> TrainingData:
        if self.initial != "auto":
            return data.from_rest() if self.initial == "rest" else data
        if all(begins_idle(data.measured(k)) for k in range(len(data.outputs))):
            return data.from_rest()
        return data if self._gain_of_free_start(data) > MIN_EVIDENCE else data.from_rest()

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

    def _gain_of_free_start(self, data: TrainingData) -> float:
        """Twice the logarithm of the evidence for an unknown state at the start, over rest.

        The errors are coloured there: a slow drift is no reason for a free state.
        """
        data = data.driven_by(moving_inputs(data))
        levels = []
        for each in (data.from_rest(), data):
            problem = ComponentProblem(each, Reduction("none"))
            found = problem.fit(np.ones(len(problem.output), bool), list(choices_of(problem)))
            levels.append(len(problem.output) * min(weights.level for weights in found))
        return levels[0] - levels[1]
