"""Plan of poles that all outputs share, found by subspace identification: how many."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.cancelling_lags import are_cancelling
from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.lpv.plan import LpvPlan
from thermaltool.fitting.output_model import OutputModel
from thermaltool.fitting.rivals import leaves_dynamics
from thermaltool.fitting.selection import Candidate, first_that_fits
from thermaltool.fitting.start_state import Initial, with_start
from thermaltool.fitting.subspace.choose import again, choose_order, start_errors
from thermaltool.fitting.subspace.modal import fitted_as
from thermaltool.fitting.subspace.model import Subspace, SubspaceOutput
from thermaltool.record import Record
from thermaltool.units import Reference

# Structures with a free start that are tried from rest before all of them are.
MAX_REFITTED = 3

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
        Real poles alone: heat never swings.
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
        return [even_training_data(logs, inputs, outputs, missing="row")]

    def start(self, data: TrainingData) -> TrainingData:
        """Rest, unless a free state is clearly better, and predicts rows held out better, too.

        A free state stands for slow modes at the cost of what follows.
        """
        data = with_start(data, self.initial, start_errors)
        if self.initial != "auto" or all(record.at_rest for record in data.records):
            return data
        rest, score = data.from_rest(), np.inf
        with contextlib.suppress(FitError):
            found = self._known[_starts(data)] = self._candidates(data)
            score = min(candidate.score for candidate in found)
            best = [candidate.model for candidate in found[:MAX_REFITTED]]
            if (
                self.budget.is_over
                or not again(rest, best, self.budget, self.real)[0].score < score
            ):
                return data
        with contextlib.suppress(FitError):
            found = self._candidates(rest)
            # What the user has ended is not compared.
            best_score = min(candidate.score for candidate in found)
            if not self.budget.is_over and best_score < score:
                self._known[_starts(rest)] = found
                return rest
        return data

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[SubspaceOutput, ...], tuple[Candidate[Subspace], ...]]:
        candidates = self._known.get(_starts(data)) or self._candidates(data)
        self._known.clear()
        wanted = [candidate.model for candidate in candidates]
        fitted = partial(fitted_as, data, real=self.real)
        try:
            model = first_that_fits(wanted, lambda each: self._sound(fitted(each), data))
        except FitError:
            # Of many that cancel the best is shown all the same.
            model = first_that_fits(wanted, fitted)
        return model.outputs, candidates

    def _sound(self, model: Subspace, data: TrainingData) -> Subspace:
        """A model whose modes are no more than the data carry.

        Raises
        ------
        FitError
            It is made of lags that cancel.
        """
        moves = [
            max(float(np.ptp(record.matrix([name]))) for record in data.records)
            for name in data.inputs
        ]
        for output in model.outputs if self.real else ():
            # An input that moves it little may do so by lags that cancel.
            if are_cancelling([output.term(k).response for k in range(len(moves))], moves):
                raise FitError(f"{output.target}: modes that cancel")
        return model

    def _candidates(self, data: TrainingData) -> Choices:
        wanted = {} if self.modes is None else {"orders": [self.modes]}
        return choose_order(data, budget=self.budget, real=self.real,
                            combinations=not self.swings, **wanted)  # fmt: skip

    def free(self) -> list[SubspacePlan]:
        """With pairs, where these have real poles."""
        return [replace(self, real=False, swings=True, _known={})] if self.real else []

    def beyond(self, fits: Sequence[Fit], reference: Reference | None) -> Sequence[Plan]:
        if self.linear:
            return ()
        # The start of these fits is as good for others.
        starts = {record.at_rest for record in fits[0].data.records}
        known: dict[frozenset[bool], Initial] = {
            frozenset([True]): "rest", frozenset([False]): "free"
        }  # fmt: skip
        initial = known.get(frozenset(starts), self.initial)
        free = replace(self, initial=initial).free() if leaves_dynamics(fits) else []
        return [*free, *LpvPlan.rivals_of(self, fits, reference)]

    def refitted(self, models: Sequence[OutputModel], data: TrainingData) -> Subspace:
        known = next(model for model in models if isinstance(model, SubspaceOutput))
        return fitted_as(data, Subspace((known,), known.criteria), judged=False, real=self.real)


def _starts(data: TrainingData) -> tuple[bool, ...]:
    return tuple(record.at_rest for record in data.records)
