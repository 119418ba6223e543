"""Outputs that are fitted together: what a search over shared parameters leaves of each, and how
sure it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import ar_error_model, runs_of
from thermaltool.fitting.output_model import OutputModel
from thermaltool.signals.agreement import Agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import inverse_of

Index = NDArray[np.intp]
M = TypeVar("M", bound=OutputModel)
# A loss below this share of the signal is rounding.
MIN_LOSS = 1e-13


@dataclass(frozen=True)
class ProjectedOutput:
    """One output with its linear parameters projected out.

    Attributes
    ----------
    linear : ndarray, shape (L,)
        Those parameters.
    loss : float
        Sum of its squared errors.
    rows : int
    by_searched : ndarray, shape (L, N)
        How `linear` follows the N searched parameters, with opposite sign.
    gram, reduced : ndarray, shape (L, L), (N, N)
        Of the linear columns; of what they leave of the slopes by the searched parameters.
    pull : ndarray, shape (N,)
        Of those slopes with the error.
    """

    linear: Array
    loss: float
    rows: int
    by_searched: Array
    gram: Array
    reduced: Array
    pull: Array


@dataclass(frozen=True)
class Sensitivities:
    """How one record of every output follows the parameters.

    Attributes
    ----------
    place : ndarray of int, shape (l,)
        Of the record's linear columns among all.
    slopes : sequence of ndarray, shape (N, rows), one for each output
        What the linear columns leave of the slopes by the searched parameters; zero where no row
        counts.
    linear : sequence of ndarray, shape (l, rows), one for each output
        The linear columns; zero where no row counts.
    """

    place: Index
    slopes: Sequence[Array]
    linear: Sequence[Array]


@dataclass(frozen=True)
class JointModel(Generic[M]):
    """Models of all outputs that were fitted together.

    Attributes
    ----------
    outputs : tuple of OutputModel, one for each output
    criteria : Criteria
        Of all outputs together.
    """

    outputs: tuple[M, ...]
    criteria: Criteria

    @property
    def parameters(self) -> int:
        """Everything that was fitted: shared parameters once, those of each output."""
        return self.criteria.parameters

    def fit(self, data: TrainingData) -> list[Agreement]:
        """Agreement of the free run of every output with it, over all records."""
        return [output.fit(data.only(k)) for k, output in enumerate(self.outputs)]

    def run(self, data: TrainingData) -> Array:
        """Free runs over all records in a row, shape (p, n)."""
        return np.array([output.run(data) for output in self.outputs])


def criterion(found: Iterable[tuple[float, int]]) -> float:
    """Negative logarithm of the likelihood of outputs whose noise is not known: ½ Σ n ln(loss/n).

    Parameters
    ----------
    found : iterable of (loss, rows)
    """
    return float(sum(0.5 * n * np.log(loss / n) for loss, n in found if n))


def joint_covariances(
    projected: Sequence[ProjectedOutput],
    errors: Sequence[Sequence[Array]],
    records: Iterable[Sensitivities],
    own: int,
    taken: int = 0,
) -> tuple[list[Array], list[float]]:
    """Covariance of the parameters of every output, and the variance of its errors.

    Parameters
    ----------
    projected : sequence of ProjectedOutput
    errors : sequence of sequence of ndarray
        Of every output in each record; NaN where no row counts.
    records : iterable of Sensitivities
    own : int
        Linear parameters, the first of them, that are wanted.
    taken : int
        Parameters of each output beside these, taken off record by record.

    Returns
    -------
    covariances : list of ndarray, shape (N + own, N + own)
        Of the N searched parameters, then of the linear ones.
    variances : list of float [unit²]

    Notes
    -----
    The estimates are linear in the errors near the optimum. The colour of the errors is an AR model
    for each output; rows that are filtered backwards by it have the products with white noise that
    the rows have with the errors. What drives the outputs' errors may be correlated (Ljung 1999,
    9.4).
    """
    n, outputs = len(projected[0].pull), range(len(projected))
    freedom = [max(f.rows - len(f.linear) - taken - n / len(outputs), 1.0) for f in projected]
    variances = [f.loss / free for f, free in zip(projected, freedom, strict=True)]
    information = sum((f.reduced / v for f, v in zip(projected, variances, strict=True)),
                      np.zeros((n, n)))  # fmt: skip
    bread = inverse_of(information)
    inverses = [inverse_of(f.gram)[:own] for f in projected]
    filters, noise = _colours(errors)
    of_searched, of_linear = np.zeros((n, n)), np.zeros((len(outputs), own, own))
    mixed = np.zeros((len(outputs), own, n))
    for record in records:
        slopes, linear = (
            [np.asarray(lfilter([1.0], filters[k], part[k][:, ::-1])) for k in outputs]
            for part in (record.slopes, record.linear)
        )
        # How the searched follow what drives the errors of each output, and its covariance with
        # that.
        effects = np.array([bread @ slopes[k] / variances[k] for k in outputs])
        joint = np.tensordot(noise, effects, 1)
        for k in outputs:
            direct = inverses[k][:, record.place] @ linear[k]
            of_searched += effects[k] @ joint[k].T
            mixed[k] += direct @ joint[k].T
            of_linear[k] += noise[k, k] * direct @ direct.T
    covariances = []
    for k, f in enumerate(projected):
        # Linear parameters at given searched ones, then as these move.
        turn = np.eye(n + own)
        turn[n:, :n] = -f.by_searched[:own]
        parts = np.block([[of_searched, mixed[k].T], [mixed[k], of_linear[k]]])
        # Errors of the fit are smaller than the noise by the parameters that they were taken for.
        covariances.append(turn @ parts @ turn.T * (f.rows / freedom[k]))
    return covariances, variances


def _colours(errors: Sequence[Sequence[Array]]) -> tuple[list[Array], Array]:
    """AR polynomials of the errors of every output, and the covariance of what drives them."""
    filters, deviations = [], []
    for own in errors:
        runs = [run for error in own for run in runs_of(error)]
        colour = ar_error_model(runs)
        if colour is None:
            colour = np.ones(1), float(np.mean(np.concatenate(runs) ** 2))
        filters.append(colour[0])
        deviations.append(colour[1] ** 0.5)
    white = np.array([
        np.concatenate([lfilter(ar, [1.0], np.nan_to_num(error)) for error in own])
        for ar, own in zip(filters, errors, strict=True)
    ])  # fmt: skip
    white /= np.sqrt(np.maximum(np.sum(white**2, axis=1), 1e-300))[:, None]
    return filters, white @ white.T * np.outer(deviations, deviations)
