"""Plan of few components of many inputs: how many, through which lags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermaltool.fitting.components.choose import averaged, evidence_choices
from thermaltool.fitting.components.model import ComponentOutput, output_of
from thermaltool.fitting.components.problem import ComponentProblem
from thermaltool.fitting.components.reduction import Reduction, moving_inputs
from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.start_state import MIN_EVIDENCE, idle_experiments
from thermaltool.record import Record


@dataclass(frozen=True, kw_only=True)
class ComponentPlan(Plan):
    """Few components of many inputs, through lags, with a ridge.

    Attributes
    ----------
    reduction : Reduction
    """

    reduction: Reduction = field(default_factory=Reduction)

    @property
    def tells_instants(self) -> bool:
        return False

    def data_sets(
        self, logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[TrainingData]:
        return [even_training_data(logs, inputs, (each,), missing="end") for each in outputs]

    def start(self, data: TrainingData) -> TrainingData:
        if self.initial != "auto":
            return data.from_rest() if self.initial == "rest" else data
        idle = idle_experiments(data)
        unknown = data.from_rest(idle)
        if len(idle) == data.experiments or not self._gains_by(unknown):
            return data.from_rest()
        return unknown

    def fit(self, data: TrainingData) -> tuple[tuple[ComponentOutput], tuple[Candidate[Any], ...]]:
        names = moving_inputs(data)
        idle = tuple(name for name in data.inputs if name not in names)
        problem = ComponentProblem(data.driven_by(names), self.reduction)
        return (output_of(problem, *averaged(problem), idle),), ()

    def _gains_by(self, data: TrainingData) -> bool:
        """Whether there is evidence for unknown states at the start, over rest.

        The errors are coloured there: a slow drift is no reason for a free state.
        """
        data = data.driven_by(moving_inputs(data))
        levels = []
        for each in (data.from_rest(), data):
            problem = ComponentProblem(each, Reduction("none"))
            found = problem.fit(
                np.ones(len(problem.output), bool), list(evidence_choices(problem)), False
            )
            levels.append(len(problem.output) * min(weights.level for weights in found))
        return levels[0] - levels[1] > MIN_EVIDENCE
