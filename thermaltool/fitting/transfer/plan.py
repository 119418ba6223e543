"""Plan of a transfer function for every output: its structure and orders."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError, ModelError
from thermaltool.fitting.cancelling_lags import are_cancelling
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.identification import Plan
from thermaltool.fitting.lpv.plan import LpvPlan
from thermaltool.fitting.output_model import OutputModel
from thermaltool.fitting.rivals import Separate, leaves_dynamics
from thermaltool.fitting.selection import Candidate, Ranked, first_that_fits
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.fitting.transfer.choose import choose
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.overdamped import MIN_TIME_CONSTANT
from thermaltool.fitting.transfer.structure import Structure
from thermaltool.responses import Response
from thermaltool.units import Reference

# Shortest time constant of a lag that is told by rows [sample periods]: above the search's end.
LEAST_LAG = 1.1 * MIN_TIME_CONSTANT


@dataclass(frozen=True, kw_only=True)
class TransferPlan(Plan):
    """A model of one structure for each output.

    Attributes
    ----------
    structure : Structure
    orders : tuple of (nb, nf, nk) or None
        For all inputs or one for each; empty, or None among them: chosen by held-out data.
    linear : bool
        Whether models of this structure are wanted, even where others may predict better.
    rough : bool
        Whether orders are chosen with less effort: of inputs that were taken out of many.
    """

    structure: Structure
    orders: tuple[tuple[int, int, int] | None, ...] = ()
    linear: bool = True
    rough: bool = False

    @property
    def label(self) -> str:
        return f"oe with {'real' if self.structure.real_poles else 'any'} poles"

    @property
    def tells_instants(self) -> bool:
        # Samples of delay that are given count from a held input.
        return not self.orders or None in self.orders

    def beyond(self, fits: Sequence[Fit], reference: Reference | None) -> Sequence[Plan]:
        if self.linear:
            return ()
        rivals: list[Plan] = []
        if leaves_dynamics(fits):
            real = self.structure.real_poles
            if real and all(len(fit.model.names) == 1 for fit in fits):
                # With more inputs that takes long, and a subspace model has any poles, too.
                free = replace(self.structure, real_poles=False)
                rivals.append(replace(self, structure=free, swings=True))
            shared = SubspacePlan(
                initial=self.initial, split=self.split, span=self.span, budget=self.budget,
                real=real,
            )  # fmt: skip
            rivals += [shared, *shared.free()]
        models = tuple(fit.model for fit in fits if isinstance(fit.model, TransferModel))
        return [*rivals, *LpvPlan.rivals_of(self, fits, reference, models)]

    def refitted(self, models: Sequence[OutputModel], data: TrainingData) -> Ranked:
        own = (model for model in models if isinstance(model, TransferModel))
        return Separate(tuple(
            model.structure.fit(data.only(k), model.orders) for k, model in enumerate(own)
        ))  # fmt: skip

    def start(self, data: TrainingData) -> TrainingData:
        return self.structure.start(data, self.initial)

    def fit(
        self, data: TrainingData
    ) -> tuple[tuple[TransferModel], tuple[Candidate[TransferModel], ...]]:
        structure = self.structure
        candidates: tuple[Candidate[TransferModel], ...] = ()
        given = [each for each in self.orders if each is not None]
        if given and len(given) == len(self.orders):
            each = given * len(data.inputs) if len(given) == 1 else given
            nb, nf, nk = zip(*each, strict=True)
            model = structure.fit(data, structure.orders(nb, nf, nk))
        else:
            candidates = choose(data, structure.candidates, self.budget, self.rough)
            chosen = (candidate.model.orders for candidate in candidates)
            wanted = [structure.orders(each.nb, each.nf[0], each.nk) for each in chosen]
            try:
                model = _first_writable(structure, data, wanted)
            except FitError:
                # None can be a model file: the best is shown all the same.
                model = first_that_fits(wanted, lambda orders: structure.fit(data, orders))
        if not structure.admits(model):
            raise FitError("not all poles are real: take lower orders, or --structure oe")
        return (model,), candidates


def _first_writable(
    structure: Structure, data: TrainingData, wanted: Sequence[Orders]
) -> TransferModel:
    """The first that is `writable`, and whose lags the data tell, where there is such a one.

    Raises
    ------
    FitError
        None is writable.
    """
    with contextlib.suppress(FitError):
        return first_that_fits(wanted, lambda orders: writable(structure, data, orders, True))
    return first_that_fits(wanted, lambda orders: writable(structure, data, orders))


def writable(
    structure: Structure, data: TrainingData, orders: Orders, lasting: bool = False
) -> TransferModel:
    """A model of these orders, each term of which has a form in continuous time.

    Parameters
    ----------
    structure : Structure
    data : TrainingData
    orders : Orders
    lasting : bool
        Without real poles at the fast end of their search: what these stand for the data do not
        tell.

    Raises
    ------
    FitError
        There is none, or it is made of lags that cancel.
    """
    model = structure.fit(data, orders)
    try:
        for k in range(len(model.names)):
            response = model.term(k).response
            if structure.real_poles and are_cancelling([response]):
                raise FitError(f"{model.names[k]} → {model.target}: lags that cancel")
            if structure.real_poles and lasting and _shortest_lag(response, model.dt) < LEAST_LAG:
                raise FitError(f"{model.names[k]} → {model.target}: a lag that nothing tells")
    except ModelError as error:
        raise FitError(str(error)) from error
    return model


def _shortest_lag(response: Response, dt: float) -> float:
    """The shortest time constant [sample periods]; without end where there is none."""
    rates = np.abs(response.modes(dt).poles)
    return float(1 / (dt * np.max(rates, initial=1e-300)))
