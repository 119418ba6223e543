"""Plan of poles that all outputs share, found by subspace identification: how many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.selection import Candidate, first_that_fits
from thermaltool.fitting.start_state import with_start
from thermaltool.fitting.subspace.choose import choose_order, start_errors
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.record import Record


@dataclass(frozen=True, kw_only=True)
class SubspacePlan(Plan):
    """Poles, real or complex, that all outputs share, with feedthrough where it predicts better.

    Attributes
    ----------
    modes : int or None
        Number of poles. None: chosen by held-out data.
    """

    joint: ClassVar[bool] = True

    modes: int | None = None

    def data_sets(
        self, logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[TrainingData]:
        return [even_training_data(logs, inputs, outputs, parted=True)]

    def start(self, data: TrainingData) -> TrainingData:
        return with_start(data, self.initial, start_errors)

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[SubspaceOutput, ...], tuple[Candidate[Subspace], ...]]:
        wanted = {} if self.modes is None else {"orders": [self.modes]}
        candidates = choose_order(data, budget=self.budget, **wanted)
        model = first_that_fits(
            (candidate.model for candidate in candidates),
            lambda m: identify_subspace(data, m.order, m.has_direct, [m.sections]),
        )
        return model.outputs, candidates
