"""One output from its data to a model that is judged: start, orders, fit, free runs, residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError, ModelError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.selection import first_that_fits
from thermaltool.fitting.transfer.choose import Choice, choose
from thermaltool.fitting.transfer.continuation import Continued, continued
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.residuals import ResidualTests, residual_tests
from thermaltool.fitting.transfer.structure import Initial, Structure
from thermaltool.fitting.validation import validate, validation_zero
from thermaltool.signals.agreement import Agreement
from thermaltool.units import hold_of


@dataclass(frozen=True)
class Plan:
    """What is wanted of every output.

    Attributes
    ----------
    structure : Structure
    orders : tuple of (nb, nf, nk) or None
        For all inputs or one for each; empty, or None among them: chosen by held-out data.
    initial : {"auto", "rest", "free"}
        State at the first row.
    split : float or None
        Share of the rows that are fitted; the rest validates.
    """

    structure: Structure
    orders: tuple[tuple[int, int, int] | None, ...] = ()
    initial: Initial = "auto"
    split: float | None = None


@dataclass(frozen=True)
class Identified:
    """One output, identified and judged.

    Attributes
    ----------
    model : TransferModel
    data : TrainingData
        What it was fitted to.
    training, validation : Agreement
        Of free runs; `validation` is None where no data were kept for it.
    improvement : float or None
        Share by which the model would have reduced the mean deviation of the validation data [%]
        (Mareš et al.: imp).
    tests : ResidualTests
    choice : Choice or None
        Where the orders were chosen.
    continued : tuple of Continued or str
        The way of each input in continuous time, or why there is none.
    """

    model: TransferModel
    data: TrainingData
    training: Agreement
    validation: Agreement | None
    improvement: float | None
    tests: ResidualTests
    choice: Choice | None
    continued: tuple[Continued | str, ...]

    @property
    def variance(self) -> float:
        """Of the training output [unit²]."""
        return float(np.var(self.data.output()))


def run(data: TrainingData, plan: Plan, fresh: TrainingData | None = None) -> Identified:
    """Fit and judge one output.

    Parameters
    ----------
    data : TrainingData
    plan : Plan
    fresh : TrainingData, optional
        Of another log, for validation.

    Raises
    ------
    FitError
        As `identify`, `choose` and `validate`, with the name of the output.
    """
    (target,), held = data.outputs, fresh
    try:
        if plan.split is not None:
            data, held = data.split(plan.split)
        data = plan.structure.start(data, plan.initial)
        model, choice = _fitted(data, plan)
        if not plan.structure.admits(model):
            raise FitError("not all poles are real: take lower orders, or --structure oe")
    except FitError as error:
        raise FitError(f"{target}: {error}") from error
    training, validation, gained = model.fit(data), None, None
    if held is not None:
        zero = validation_zero(target, fresh is not None)
        validation, gained = validate(held, 0, model.run(held, zero), zero, model.offsets,
                                      sum(model.orders.nf))  # fmt: skip
    return Identified(
        model,
        data,
        training,
        validation,
        gained,
        residual_tests(model, data),
        choice,
        tuple(_continued(model, k) for k in range(len(model.names))),
    )


def _fitted(data: TrainingData, plan: Plan) -> tuple[TransferModel, Choice | None]:
    """The model, and where its orders were chosen how."""
    structure = plan.structure
    given = [each for each in plan.orders if each is not None]
    if given and len(given) == len(plan.orders):
        each = given * len(data.inputs) if len(given) == 1 else given
        nb, nf, nk = zip(*each, strict=True)
        return structure.fit(data, structure.orders(nb, nf, nk)), None
    choice = choose(data, structure.candidates)
    orders = (candidate.orders(structure) for candidate in choice.candidates)
    return first_that_fits(orders, lambda each: structure.fit(data, each)), choice


def _continued(model: TransferModel, k: int) -> Continued | str:
    try:
        return continued(model, k, hold_of(model.names[k]))
    except ModelError as error:
        return str(error)
