"""Outputs that are fitted together: what a search over shared parameters leaves of each, and how
sure it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import freqz, lfilter

from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.error_model import FREQUENCIES, ar_error_model
from thermaltool.fitting.output_model import OutputModel
from thermaltool.signals.agreement import Agreement
from thermaltool.signals.criteria import Criteria
from thermaltool.signals.gauss_newton import inverse_of

Index = NDArray[np.intp]
M = TypeVar("M", bound=OutputModel)
# A loss below this share of the signal is rounding.
MIN_LOSS = 1e-13
# Times that the noise which a fit has absorbed is found anew: of twelve slow columns fitted to 1000
# rows in AR(1) noise of 0.8 the variances are 0.83, 1.01, 1.04 and 1.05 of the true ones after none
# to three.
ABSORBED_ROUNDS = 2


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

    def carried_on(self, split: Split) -> Array:
        """Free runs over what is held out, shape (p, n); see `OutputModel.carried_on`."""
        return np.array([output.carried_on(split) for output in self.outputs])


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
    records: Callable[[], Iterable[Sensitivities]],
    own: int,
    taken: int = 0,
) -> tuple[list[Array], list[float]]:
    """Covariance of the parameters of every output, and the variance of its errors.

    Parameters
    ----------
    projected : sequence of ProjectedOutput
    errors : sequence of sequence of ndarray
        Of every output in each record; NaN where no row counts.
    records : callable
        Gives the sensitivities of every record.
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
    9.4). The errors of a fit lack what its parameters took of the noise, of slow noise most: its
    expectation is added to their autocovariance before the colour is taken.
    """
    n, outputs = len(projected[0].pull), range(len(projected))
    freedom = [max(f.rows - len(f.linear) - taken - n / len(outputs), 1.0) for f in projected]
    variances = [f.loss / free for f, free in zip(projected, freedom, strict=True)]
    information = sum((f.reduced / v for f, v in zip(projected, variances, strict=True)),
                      np.zeros((n, n)))  # fmt: skip
    bread = inverse_of(information)
    inverses = [inverse_of(f.gram) for f in projected]
    linears = [(record.place, record.linear) for record in records()]
    colours = [
        with_absorbed(colour, inverses[k], [(place, own[k]) for place, own in linears])
        for k, colour in enumerate(map(_colour, errors))
    ]
    filters, noise = [ar for ar, _ in colours], _driving_covariance(colours, errors)
    of_searched, of_linear = np.zeros((n, n)), np.zeros((len(outputs), own, own))
    mixed = np.zeros((len(outputs), own, n))
    for record in records():
        slopes, linear = (
            [np.asarray(lfilter([1.0], filters[k], part[k][:, ::-1])) for k in outputs]
            for part in (record.slopes, record.linear)
        )
        # How the searched follow what drives the errors of each output, and its covariance with
        # that.
        effects = np.array([bread @ slopes[k] / variances[k] for k in outputs])
        joint = np.tensordot(noise, effects, 1)
        for k in outputs:
            direct = inverses[k][:own, record.place] @ linear[k]
            of_searched += effects[k] @ joint[k].T
            mixed[k] += direct @ joint[k].T
            of_linear[k] += noise[k, k] * direct @ direct.T
    covariances = []
    for k, f in enumerate(projected):
        # Linear parameters at given searched ones, then as these move.
        turn = np.eye(n + own)
        turn[n:, :n] = -f.by_searched[:own]
        parts = np.block([[of_searched, mixed[k].T], [mixed[k], of_linear[k]]])
        # Errors of the fit are smaller than the noise by the parameters that they were taken for;
        # with a colour the linear ones are counted in it.
        left = f.rows - freedom[k] - (len(f.linear) if len(filters[k]) > 1 else 0)
        covariances.append(turn @ parts @ turn.T * (f.rows / (f.rows - left)))
    return covariances, variances


def _colour(errors: Sequence[Array]) -> tuple[Array, float]:
    """AR polynomial of the errors of one output, and the variance of what drives them."""
    return ar_error_model(errors) or (np.ones(1), float(np.nanmean(np.concatenate(errors) ** 2)))


def with_absorbed(
    given: tuple[Array, float], inverse: Array, records: Sequence[tuple[Index, Array]]
) -> tuple[Array, float]:
    """The colour of the noise from that of the errors e = (I − P) v that a fit leaves of it.

    Parameters
    ----------
    given : (ndarray, float)
        AR polynomial of the errors and the variance of what drives them.
    inverse : ndarray, shape (L, L)
        Of the normal equations of the linear columns.
    records : sequence of (ndarray of int, ndarray of shape (l, rows))
        Places of the columns of each record among all, and these columns.

    Returns
    -------
    (ndarray, float)
        Of the noise.

    Notes
    -----
    The covariance of e is R − PR − RP + PRP, with that of the noise R and the projection P on the
    linear columns: what it lacks is found with the R at hand, and added.
    """
    order, rows = len(given[0]) - 1, sum(linear.shape[1] for _, linear in records)
    if not order:
        return given
    colour, lags = given, range(order + 1)
    left = _autocovariance(*given, order)
    for _ in range(ABSORBED_ROUNDS):
        ar, variance = colour
        once = [np.asarray(lfilter([1.0], ar, linear[:, ::-1])) for _, linear in records]
        score = np.zeros_like(inverse)
        for (place, _), white in zip(records, once, strict=True):
            score[np.ix_(place, place)] += variance * white @ white.T
        both, lacking = inverse @ score @ inverse, np.zeros(order + 1)
        for (place, linear), white in zip(records, once, strict=True):
            covered = variance * np.asarray(lfilter([1.0], ar, white[:, ::-1]))
            weights = inverse[np.ix_(place, place)] @ linear
            twice, n = both[np.ix_(place, place)] @ linear, linear.shape[1]
            for k in lags:
                ahead, behind = slice(k, None), slice(0, max(n - k, 0))
                lacking[k] += np.sum(weights[:, behind] * covered[:, ahead])
                lacking[k] += np.sum(covered[:, behind] * weights[:, ahead])
                lacking[k] -= np.sum(twice[:, behind] * linear[:, ahead])
        if not abs(lacking[0]) < left[0] * rows:
            return given  # a fit without noise: what is left is rounding
        whole = left + lacking / rows
        ahead_of = solve_toeplitz(whole[:-1], whole[1:])
        colour = np.append(1.0, -ahead_of), float(whole[0] - ahead_of @ whole[1:])
        if not (colour[1] > 0 and np.all(np.abs(np.roots(colour[0])) < 1)):
            return given
    return colour


def _autocovariance(ar: Array, variance: float, lags: int) -> Array:
    """Autocovariance of an AR process at lags from zero on, shape (lags + 1,)."""
    _, density = freqz([1.0], ar, FREQUENCIES, whole=True)
    return np.asarray(variance * np.fft.ifft(np.abs(density) ** 2).real[: lags + 1])


def _driving_covariance(
    colours: Sequence[tuple[Array, float]], errors: Sequence[Sequence[Array]]
) -> Array:
    """Covariance of what drives the errors of all outputs."""
    white = np.array([
        np.concatenate([lfilter(ar, [1.0], np.nan_to_num(error)) for error in own])
        for (ar, _), own in zip(colours, errors, strict=True)
    ])  # fmt: skip
    white /= np.sqrt(np.maximum(np.sum(white**2, axis=1), 1e-300))[:, None]
    deviations = np.sqrt([variance for _, variance in colours])
    return np.asarray(white @ white.T * np.outer(deviations, deviations))
