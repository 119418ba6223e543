"""A structure of a transfer function: where the noise enters, and how it is fitted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.signal import lfilter

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.start_state import Initial, StartErrors, with_start
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import search
from thermaltool.record import Record

if TYPE_CHECKING:
    from thermaltool.fitting.transfer.model import TransferModel


@dataclass(frozen=True)
class Structure(ABC):
    """One structure with what it is told beside the orders of the plant.

    A new one is a subclass in a file of its own and a line of the `registry`.

    Attributes
    ----------
    noise : (int, int)
        Orders of C and D, as far as the structure has them.
    real_poles : bool
        Real, stable poles only.
    rough : bool
        Several denominators are searched with less effort: candidates of the choice of orders.
    name : str
        As the command line and documents have it.
    letter : str
        Of the coefficients of a denominator.
    noise_orders : bool
        Whether `noise` means anything.
    shares_denominator : bool
        One denominator for all inputs, or one for each.
    estimates_start : bool
        Whether the state at the first row is estimated or known to be rest; else the first rows
        are taken as they are, from any state.
    searches_real_poles : bool
        Whether the fit itself keeps the poles real where that is wanted.
    """

    noise: tuple[int, int] = (1, 1)
    real_poles: bool = False
    rough: bool = False

    name: ClassVar[str]
    letter: ClassVar[str] = "f"
    noise_orders: ClassVar[bool] = False
    shares_denominator: ClassVar[bool] = False
    estimates_start: ClassVar[bool] = True
    searches_real_poles: ClassVar[bool] = False

    @abstractmethod
    def estimate(self, data: TrainingData, orders: Orders) -> TransferModel:
        """The model of these orders; `fit` has checked what the data carry."""

    def fit(self, data: TrainingData, orders: Orders) -> TransferModel:
        """The model of these orders.

        Raises
        ------
        FitError
            Data that carry no transfer function (`TrainingData.check`), a delay beyond the record,
            more parameters than rows, a fit that integrates.
        """
        data.check()
        check_orders(data, orders)
        return self.estimate(data, orders)

    def orders(self, nb: tuple[int, ...], nf: int | tuple[int, ...], nk: tuple[int, ...]) -> Orders:
        """Orders of the plant.

        Parameters
        ----------
        nb, nk : tuple of int, one for each input
            Coefficients of the numerator; samples of delay before the first.
        nf : int, or tuple of int, one for each input
            Order of the denominator.

        Raises
        ------
        FitError
            An order that is none.
        """
        if any(b < 1 for b in nb) or any(k < 0 for k in nk):
            raise FitError("nb counts from 1, nk from 0")
        each = (nf,) * len(nb) if isinstance(nf, int) else nf
        if any(f < 0 for f in each):
            raise FitError("nf counts from 0")
        if self.shares_denominator:
            return Orders(nb, (max(each),), nk, (tuple(range(len(nb))),))
        return Orders(nb, each, nk, tuple((k,) for k in range(len(nb))))

    def start(self, data: TrainingData, initial: Initial = "auto") -> TrainingData:
        """The data with what is known of the state at the first row of each experiment.

        Parameters
        ----------
        data : TrainingData
        initial : {"auto", "rest", "free"}
            As `with_start`.
        """
        return with_start(data, initial, second_order_errors) if self.estimates_start else data

    @property
    def candidates(self) -> Structure:
        """The structure whose fits decide on the orders: itself."""
        return self

    def admits(self, model: TransferModel) -> bool:
        """Whether the poles of a fit are as they are wanted."""
        # The search over real poles ends at some that only look like pairs to rounding.
        return not self.real_poles or self.searches_real_poles or real_poles(model)

    def residual(self, model: TransferModel, record: Record) -> Array | None:
        """One-step errors, white where the model holds; None where the record is too short.

        They end with the record and begin after the rows that its start takes.

        Parameters
        ----------
        model : TransferModel
        record : Record
            With the inputs and the output.
        """
        orders = model.orders
        if len(record) <= orders.shortest and not record.at_rest:
            return None
        error = record.column(model.target) - model.simulate(record)
        first = 0 if record.at_rest else orders.first
        return one_step(error[first:], model.D, model.C)

    def residual_parameters(self, model: TransferModel) -> int:
        """Parameters that were fitted to the course of the residual."""
        # What the plant has takes nothing from the course of an output's own errors.
        return len(model.C) + len(model.D) - 2

    def labels(self, model: TransferModel) -> list[str]:
        """Names of the model's coefficients: all denominators, then all numerators."""
        several = len(model.names) > 1
        labels = []
        for group, f in zip(model.orders.groups, model.F, strict=True):
            own = f"[{model.names[group[0]]}]" if len(model.F) > 1 else ""
            labels += [f"{self.letter}{j}{own}" for j in range(1, len(f))]
        for name, b, nk in zip(model.names, model.B, model.orders.nk, strict=True):
            labels += [f"b{nk + j}" + (f"[{name}]" if several else "") for j in range(len(b))]
        return labels


def one_step(error: Array, D: Array, C: Array, first: int = 0) -> Array:
    """Errors through D/C; NaN where a reading that D takes is missing.

    Behind a hole C goes on as if there had been no innovation.

    Parameters
    ----------
    error : ndarray, shape (n,)
        NaN where the reading is missing.
    D, C : ndarray
        Polynomials, leading 1 included.
    first : int
        Rows that are left out at the start.

    Returns
    -------
    ndarray, shape (n - first,)
    """
    filtered = np.convolve(error, D)[first : len(error)]
    return np.where(np.isfinite(filtered), lfilter([1.0], C, np.nan_to_num(filtered)), np.nan)


def real_poles(model: TransferModel) -> bool:
    """Whether every pole is real and positive: an overdamped system."""
    poles = [np.roots(f) for f in model.F if len(f) > 1]
    return all(bool(np.all((p.imag == 0) & (p.real > 0))) for p in poles)


def check_orders(data: TrainingData, orders: Orders) -> None:
    """Refuse what the record does not carry.

    Raises
    ------
    FitError
        A delay beyond it, a log in pieces too short to say anything, more parameters than rows.
    """
    for name, nk in zip(data.inputs, orders.nk, strict=True):
        if nk >= data.longest:
            raise FitError(
                f"{name}: a delay of {nk} samples is longer than the record ({data.longest})"
            )
    problem = Problem(data.about_levels(orders.first), orders)
    if {data.records[k].origin for k in problem.used} != set(range(data.experiments)):
        (output,) = data.outputs
        raise FitError(
            f"{output}: a log has no run of inputs with more than "
            f"{orders.shortest - orders.first} readings behind the delays, which these orders "
            "need: take lower ones",
            output,
        )
    need = problem.linear_count + sum(orders.nf)
    # What is known from before the record is no row of it.
    before = sum(data.records[k].at_rest for k in problem.used) * orders.first
    rows = problem.rows - before
    if rows < 2 * need:
        raise FitError(
            f"{counted(rows, 'equation')} with all delayed values do not carry orders of "
            f"{counted(need, 'parameter')}: take lower orders or more data"
        )


def check_steady_state(F: Array) -> None:
    """Refuse F(1) = 0: a model that integrates has no steady state (FitError)."""
    if abs(float(F.sum())) < 4 * np.finfo(float).eps * float(np.abs(F).sum()):
        raise FitError("the fit has a pole at 1, it integrates: take a lower order")


def second_order_errors(data: TrainingData) -> StartErrors | None:
    """Errors of an output-error model of second order; None where there are too few rows."""
    inputs, least = range(len(data.inputs)), data.least_delays
    second = tuple(2 for _ in inputs)
    orders = Orders(second, second, least, tuple((k,) for k in inputs))
    problem = Problem(data.about_levels(orders.first), orders)
    if problem.rows <= problem.linear_count + sum(orders.nf):
        return None
    found = search(problem)

    def records() -> list[list[Array]]:
        return [[error for error, _ in problem.errors(problem.project(found.F))]]

    return StartErrors([found.loss / problem.rows], records)
