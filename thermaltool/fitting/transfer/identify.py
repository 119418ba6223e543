"""From records and orders to a transfer function, by the structure's own estimator."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.transfer.colour import error_colour
from thermaltool.fitting.transfer.equation_error import Regression, armax, arx
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.output_error import Orders, Problem
from thermaltool.fitting.transfer.overdamped import overdamped
from thermaltool.fitting.transfer.polynomials import difference_basis
from thermaltool.fitting.transfer.search import SearchResult, refine, search
from thermaltool.signals.gauss_newton import inverse_of, solve
from thermaltool.timeseries.fit import fit_arma
from thermaltool.timeseries.runs import joined

Structure = Literal["oe", "bj", "arx", "armax"]
STRUCTURES: tuple[Structure, ...] = ("oe", "bj", "arx", "armax")

# Plant and noise of a Box-Jenkins model are alternated at most so often.
ALTERNATIONS = 8


def orders_of(
    structure: Structure, nb: tuple[int, ...], nf: int | tuple[int, ...], nk: tuple[int, ...]
) -> Orders:
    """Orders of a structure: ARX and ARMAX share one denominator, OE and BJ have one per input.

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
    if structure in ("arx", "armax"):
        return Orders(nb, (max(each),), nk, (tuple(range(len(nb))),))
    return Orders(nb, each, nk, tuple((k,) for k in range(len(nb))))


def identify(
    data: TrainingData,
    structure: Structure,
    orders: Orders,
    nc: int = 1,
    nd: int = 1,
    real: bool = False,
) -> TransferModel:
    """Fit one structure of given orders.

    Parameters
    ----------
    data : TrainingData
    structure : {"oe", "bj", "arx", "armax"}
    orders : Orders
    nc, nd : int
        Orders of the noise: C of ARMAX; C and D of BJ.
    real : bool
        Real poles only (OE).

    Raises
    ------
    FitError
        Data that carry no transfer function (`TrainingData.check`), a delay beyond the record, more
        parameters than rows.
    """
    data.check()
    check_orders(data, orders)
    if structure in ("arx", "armax"):
        found = arx(data, orders) if structure == "arx" else armax(data, orders, nc)
        return _equation_model(data, structure, orders, found)
    problem = Problem(data.about_levels(orders.first), orders)
    found_oe = search(problem)
    if structure == "oe":
        found_oe = overdamped(problem, found_oe) if real else found_oe
        return _output_model(problem, found_oe, "oe", data)
    return _box_jenkins(problem, found_oe, data, nc, nd)


def check_orders(data: TrainingData, orders: Orders) -> None:
    """Refuse what the record does not carry (FitError).

    A delay beyond it, a log in pieces too short to say anything, more parameters than rows.
    """
    for name, nk in zip(data.inputs, orders.nk, strict=True):
        if nk >= data.longest:
            raise FitError(
                f"{name}: a delay of {nk} samples is longer than the record ({data.longest})"
            )
    problem = Problem(data.about_levels(orders.first), orders)
    if {data.records[k].origin for k in problem.used} != set(range(data.experiments)):
        raise FitError(
            f"{data.outputs[0]}: a log has no run of more than {orders.shortest} readings without "
            "a gap, which these orders need: take lower ones; --structure network takes holes"
        )
    need = problem.linear_count + sum(orders.nf)
    # What is known from before the record is no row of it.
    before = sum(data.records[k].at_rest for k in problem.used) * orders.first
    rows = problem.rows - before
    if rows < 2 * need:
        raise FitError(
            f"{rows} rows do not carry orders of {need} parameters: take lower orders or more data"
        )


def settles(F: Array) -> None:
    """Refuse F(1) = 0: a model that integrates has no steady state (FitError)."""
    if abs(float(F.sum())) < 4 * np.finfo(float).eps * float(np.abs(F).sum()):
        raise FitError("the fit has a pole at 1, it integrates: take a lower order")


def _numerators(problem: Problem, linear: Array) -> tuple[Array, ...]:
    edges = np.cumsum([0, *problem.orders.nb])
    return tuple(linear[a:b] @ difference_basis(b - a) for a, b in pairwise(edges))


def _output_model(
    problem: Problem, found: SearchResult, structure: Structure, data: TrainingData,
    C: Array | None = None, D: Array | None = None,
) -> TransferModel:  # fmt: skip
    here, orders = found.projection, problem.orders
    slopes = problem.slopes(found.F, here, mixed=False)
    count = slopes.searched + problem.linear_count
    sigma2 = slopes.loss / max(problem.rows - count, 1)
    inverse = inverse_of(slopes.gram)
    if structure == "oe":
        middle = coloured_gram(problem, found, slopes.gram, sigma2)
        covariance = inverse @ middle @ inverse
    else:
        covariance = sigma2 * inverse
    own = sum(orders.nf) + sum(orders.nb)
    edge = sum(orders.nb)
    B = _numerators(problem, here.linear)
    of = {k: found.F[g] for g, inputs in enumerate(orders.groups) for k in inputs}
    for f in found.F:
        settles(f)
    gains = np.array([b.sum() / of[k].sum() for k, b in enumerate(B)])
    return TransferModel(
        structure,
        data.inputs,
        data.outputs[0],
        data.period,
        orders,
        B,
        found.F,
        tuple((here.linear[edge : edge + data.experiments] - data.levels @ gains).tolist()),
        data.levels,
        tuple(here.linear[edge : edge + data.experiments].tolist()),
        sigma2,
        covariance[:own, :own],
        found.method,
        found.converged,
        problem.rows,
        max(slopes.loss, 1e-300),
        np.ones(1) if C is None else C,
        np.ones(1) if D is None else D,
    )


def coloured_gram(problem: Problem, found: SearchResult, gram: Array, sigma2: float) -> Array:
    """Covariance of the score: Z Zᵀ σ² for white errors; else through an AR model of them.

    With e = H·white, E[Z e eᵀ Zᵀ] is the Gram matrix of Z filtered by H backwards in time
    (Ljung 1999, 9.4). The AR order is the best by BIC; zero leaves the plain form.
    """
    here = found.projection
    colour = error_colour([e for e, _ in problem.errors(here)]) if sigma2 > 0 else None
    if colour is None:
        return gram * sigma2
    ar, variance = colour
    result = np.zeros_like(gram)
    for place, rows, _ in problem.instruments(found.F, here):
        shared, free = rows[: len(place)], rows[len(place) :]
        shared = shared - (free @ shared.T).T @ solve(free @ free.T, free)
        Z = lfilter([1.0], ar, shared[:, ::-1])
        result[np.ix_(place, place)] += Z @ Z.T
    return result * variance


def _box_jenkins(
    problem: Problem, found: SearchResult, data: TrainingData, nc: int, nd: int
) -> TransferModel:
    """Refined instrumental variables with a noise model (RIV; Young 2011, chapter 7).

    An ARMA model of the errors whitens all rows of the next plant estimate, until the plant stands.
    Errors that BIC takes for white have none: C and D that nearly cancel, on the unit circle, would
    make the steady state look far surer than it is.
    """
    C = D = np.ones(1)
    for _ in range(ALTERNATIONS):
        plain = replace(problem, whitening=None)
        errors = [e for e, _ in plain.errors(plain.project(found.F))]
        record = joined(errors)
        noise = min((fit_arma(record, p, q, degree=-1) for p, q in ((nd, nc), (0, 0))),
                    key=lambda model: model.entry.criteria.bic)  # fmt: skip
        C = np.concatenate([[1.0], noise.ma])
        D = np.concatenate([[1.0], -noise.ar])
        problem = replace(problem, whitening=(D, C))
        before = found
        found = refine(problem, found.F)
        if all(np.allclose(a, b, rtol=1e-6, atol=1e-9) for a, b in
               zip(found.F, before.F, strict=True)):  # fmt: skip
            break
    return _output_model(problem, found, "bj", data, C, D)


def _equation_model(
    data: TrainingData, structure: Structure, orders: Orders, found: Regression
) -> TransferModel:
    sigma2 = found.loss / max(found.rows - len(found.gram), 1)
    own = orders.parameters
    inverse = inverse_of(found.gram)[:own, :own]
    settles(found.F)
    at_rest = float(found.F.sum())
    offsets = np.array(found.constants) / at_rest
    gains = np.array([b.sum() / at_rest for b in found.numerators])
    return TransferModel(
        structure,
        data.inputs,
        data.outputs[0],
        data.period,
        orders,
        found.numerators,
        (found.F,),
        tuple(offsets.tolist()),
        data.levels,
        tuple((offsets + data.levels @ gains).tolist()),
        sigma2,
        sigma2 * inverse,
        "least squares" if structure == "arx" else "Gauss-Newton from two regressions",
        found.converged,
        found.rows,
        max(found.loss, 1e-300),
        found.C,
    )
