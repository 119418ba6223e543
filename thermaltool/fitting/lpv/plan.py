"""Plan of one parameter-varying model for all outputs: levels, powers, modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from thermaltool.errors import FitError
from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.lpv.choose import LEVEL_COUNTS, choose_form
from thermaltool.fitting.lpv.identify import identify_lpv
from thermaltool.fitting.lpv.model import Lpv, LpvOutput, settled
from thermaltool.fitting.network.choose import undelayed_errors
from thermaltool.fitting.output_model import OutputModel
from thermaltool.fitting.selection import Candidate, first_that_fits
from thermaltool.fitting.start_state import with_start
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.record import Record
from thermaltool.units import Reference, drive_reference


@dataclass(frozen=True, kw_only=True)
class LpvPlan(Plan):
    """Loss rate and gains by levels of an input, powers of inputs.

    Attributes
    ----------
    modes : int or None
        None: chosen by held-out data.
    level_counts : sequence of int
        That are tried; two alone are the bilinear model.
    reference : "first", float or None
        What inputs count from, as in the model document.
    rival : bool
        Whether it stands beside a linear model: where nothing goes by a state, there is no fit.
    linear : tuple of TransferModel
        Of all outputs, whose delays are tried; may be empty.
    """

    joint: ClassVar[bool] = True

    modes: int | None = None
    level_counts: Sequence[int] = LEVEL_COUNTS
    reference: Reference | None = None
    rival: bool = False
    linear: tuple[TransferModel, ...] = ()

    @property
    def label(self) -> str:
        return "lpv"

    @staticmethod
    def rivals_of(
        plan: Plan,
        fits: Sequence[Fit],
        reference: Reference | None,
        linear: tuple[TransferModel, ...] = (),
    ) -> list[LpvPlan]:
        """What is tried beside the fits of a linear plan: nothing where the machine is linear.

        Parameters
        ----------
        plan : Plan
        fits : sequence of Fit
        reference, linear
            See the attributes.
        """
        if not any(fit.linearity is not None and fit.linearity.nonlinear for fit in fits):
            return []
        return [LpvPlan(initial=plan.initial, split=plan.split, span=plan.span, budget=plan.budget,
                        reference=reference, rival=True, linear=linear)]  # fmt: skip

    def data_sets(
        self, logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[TrainingData]:
        return [even_training_data(logs, inputs, outputs)]

    def _references(self, data: TrainingData) -> tuple[Reference, ...]:
        own = self.reference
        return tuple(drive_reference(n) if own is None else own for n in data.inputs)

    def start(self, data: TrainingData) -> TrainingData:
        return settled(with_start(data, self.initial, undelayed_errors), self._references(data))

    def fit(self, data: TrainingData) -> tuple[tuple[LpvOutput, ...], tuple[Candidate[Lpv], ...]]:
        references = self._references(data)
        candidates = choose_form(
            data, references, self._delays(data), self.modes, self.level_counts,
            data.may_act_at_once and any(0 in model.orders.nk for model in self.linear),
            self.budget,
        )  # fmt: skip
        form = candidates[0].model.form
        if self.rival and not (form.channel or form.powers):
            raise FitError("no model with states predicts better than a linear one")
        found = first_that_fits(
            (candidate.model for candidate in candidates),
            lambda each: identify_lpv(data, each.form, references, [each.theta]),
        )
        return found.outputs, candidates

    def refitted(self, models: Sequence[OutputModel], data: TrainingData) -> Lpv:
        known = next(model for model in models if isinstance(model, LpvOutput))
        return identify_lpv(data, known.form, self._references(data), [known.theta], judged=False)

    def _delays(self, data: TrainingData) -> list[tuple[int, ...]]:
        """Samples by which inputs act later than at once: none, and those of the linear models."""
        m = len(data.inputs)
        each = [
            tuple(max(k - least, 0)
                  for k, least in zip(model.orders.nk, data.least_delays, strict=True))
            for model in self.linear
        ]  # fmt: skip
        least = tuple(min(own[i] for own in each) for i in range(m)) if each else (0,) * m
        return list(dict.fromkeys([(0,) * m, least]))
