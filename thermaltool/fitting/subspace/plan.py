"""Plan of poles that all outputs share, found by subspace identification: how many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.lpv.plan import LpvPlan
from thermaltool.fitting.output_model import OutputModel
from thermaltool.fitting.rivals import MIN_GAIN
from thermaltool.fitting.selection import Candidate, first_that_fits
from thermaltool.fitting.start_state import with_start
from thermaltool.fitting.subspace.choose import choose_order, start_errors
from thermaltool.fitting.subspace.modal import fitted_as
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.record import Record
from thermaltool.units import Reference

Choices = tuple[Candidate[Subspace], ...]


@dataclass(frozen=True, kw_only=True)
class SubspacePlan(Plan):
    """Poles, real or complex, that all outputs share, with feedthrough where it predicts better.

    Attributes
    ----------
    modes : int or None
        Number of poles. None: chosen by held-out data.
    linear : bool
        Whether this is wanted, even where others may predict better.
    real : bool
        Whether orders with real poles are taken unless pairs are decisively better: heat never
        swings.
    """

    joint: ClassVar[bool] = True

    modes: int | None = None
    linear: bool = True
    real: bool = False
    _known: dict[tuple[bool, ...], Choices] = field(default_factory=dict, repr=False, compare=False)

    @property
    def label(self) -> str:
        return "subspace"

    def data_sets(
        self, logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[TrainingData]:
        return [even_training_data(logs, inputs, outputs, parted=True)]

    def start(self, data: TrainingData) -> TrainingData:
        """Rest, unless a free state is clearly better, and predicts rows held out better, too.

        A free state stands for slow modes at the cost of what follows.
        """
        data = with_start(data, self.initial, start_errors)
        if self.initial != "auto" or all(record.at_rest for record in data.records):
            return data
        scores = []
        for each in (data, data.from_rest()):
            try:
                found = self._candidates(each)
            except FitError:
                scores.append(np.inf)
                continue
            if scores and self.budget.is_over:
                return data  # what the user has ended is not compared
            self._known[_starts(each)] = found
            scores.append(found[0].score)
            if self.budget.is_over:
                return data
        return data.from_rest() if scores[1] < scores[0] else data

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[SubspaceOutput, ...], tuple[Candidate[Subspace], ...]]:
        candidates = self._known.get(_starts(data)) or self._candidates(data)
        self._known.clear()
        model = first_that_fits(
            (candidate.model for candidate in candidates),
            partial(fitted_as, data),
        )
        return model.outputs, candidates

    def _candidates(self, data: TrainingData) -> Choices:
        wanted = {} if self.modes is None else {"orders": [self.modes]}
        found = choose_order(data, budget=self.budget, **wanted)
        if not self.real:
            return found
        overdamped = [c for c in found if c.score <= found[0].score + MIN_GAIN and _is_real(c)]
        return (*overdamped, *(c for c in found if all(c is not own for own in overdamped)))

    def beyond(self, fits: Sequence[Fit], reference: Reference | None) -> Sequence[Plan]:
        return () if self.linear else LpvPlan.rivals_of(self, fits, reference)

    def refitted(self, models: Sequence[OutputModel], data: TrainingData) -> Subspace:
        known = next(model for model in models if isinstance(model, SubspaceOutput))
        return fitted_as(data, Subspace((known,), known.criteria), judged=False)


def _is_real(candidate: Candidate[Subspace]) -> bool:
    return not np.any(candidate.model.outputs[0].poles.imag)


def _starts(data: TrainingData) -> tuple[bool, ...]:
    return tuple(record.at_rest for record in data.records)
