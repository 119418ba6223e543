"""OE: y = Σ B/F u + e, a denominator for each input."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from scipy.signal import lfilter

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import ar_error_model
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.overdamped import overdamped
from thermaltool.fitting.transfer.polynomials import difference_basis
from thermaltool.fitting.transfer.search import SearchResult, search
from thermaltool.fitting.transfer.structure import Structure, check_steady_state
from thermaltool.signals.gauss_newton import inverse_of, solve


@dataclass(frozen=True)
class OeStructure(Structure):
    """White errors at the output; intervals take in their colour."""

    name: ClassVar[str] = "oe"
    searches_real_poles: ClassVar[bool] = True

    def problem(self, data: TrainingData, orders: Orders) -> Problem:
        """What is searched."""
        return Problem(data.about_levels(orders.first), orders)

    def estimate(self, data: TrainingData, orders: Orders) -> TransferModel:
        problem = self.problem(data, orders)
        found = search(problem, self.rough)
        if self.real_poles:
            found = overdamped(problem, found)
        return self.model(problem, found, data)

    def model(self, problem: Problem, found: SearchResult, data: TrainingData) -> TransferModel:
        """The model of a search that has ended."""
        return plant_model(self, problem, found, data, coloured=True)


def search_fields(
    structure: Structure, problem: Problem, found: SearchResult, data: TrainingData, coloured: bool
) -> dict[str, Any]:
    """Fields of a model that a search over denominators gives, whatever its polynomials.

    Parameters
    ----------
    structure : Structure
    problem : Problem
    found : SearchResult
    data : TrainingData
    coloured : bool
        Whether the errors may have a colour that the model does not have.
    """
    slopes = problem.slopes(found.F, found.projection, mixed=False)
    sigma2 = slopes.loss / max(problem.rows - slopes.searched - problem.linear_count, 1)
    inverse, own = inverse_of(slopes.gram), problem.orders.parameters
    covariance = sigma2 * inverse
    if coloured:
        covariance = inverse @ _score_covariance(problem, found, slopes.gram, sigma2) @ inverse
    edge = sum(problem.orders.nb)
    return {
        "structure": structure,
        "names": data.inputs,
        "target": data.outputs[0],
        "dt": data.period,
        "orders": problem.orders,
        "holds": data.holds,
        "lagging": data.lagging,
        "levels": data.levels,
        "zeros": tuple(found.projection.linear[edge : edge + data.experiments].tolist()),
        "sigma2": sigma2,
        "covariance": covariance[:own, :own],
        "method": found.method,
        "converged": found.converged,
        "rows": problem.rows,
        "loss": max(slopes.loss, 1e-300),
        "output_variance": float(np.nanvar(data.output())),
    }


def plant_model(
    structure: Structure, problem: Problem, found: SearchResult, data: TrainingData,
    coloured: bool, **noise: Any,
) -> TransferModel:  # fmt: skip
    """The model whose plant a search has found; `noise` are its polynomials C and D, if any."""
    for f in found.F:
        check_steady_state(f)
    edges = np.cumsum([0, *problem.orders.nb])
    linear = found.projection.linear
    B = tuple(linear[a:b] @ difference_basis(b - a) for a, b in pairwise(edges))
    fields = search_fields(structure, problem, found, data, coloured)
    return TransferModel(B=B, F=found.F, **fields, **noise)


def _score_covariance(problem: Problem, found: SearchResult, gram: Array, sigma2: float) -> Array:
    """Covariance of the score: Z Zᵀ σ² for white errors; else through an AR model of them.

    With e = H·white, E[Z e eᵀ Zᵀ] is the Gram matrix of Z filtered by H backwards in time
    (Ljung 1999, 9.4). The AR order is the best by BIC; zero leaves the plain form.
    """
    here = found.projection
    model = ar_error_model([e for e, _ in problem.errors(here)]) if sigma2 > 0 else None
    if model is None:
        return gram * sigma2
    ar, variance = model
    result = np.zeros_like(gram)
    for k, (place, rows, _) in zip(problem.used, problem.instruments(found.F, here), strict=True):
        rows = problem.white(rows, k)
        shared, free = rows[: len(place)], rows[len(place) :]
        shared = shared - (free @ shared.T).T @ solve(free @ free.T, free)
        Z = lfilter([1.0], ar, shared[:, ::-1])
        result[np.ix_(place, place)] += Z @ Z.T
    return result * variance
