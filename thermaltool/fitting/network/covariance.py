"""Covariance of shared time constants and of each output's weights, under coloured errors."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from thermaltool.fitting.data import Array
from thermaltool.fitting.error_model import ar_error_model, runs_of
from thermaltool.fitting.network.problem import NetworkProblem
from thermaltool.fitting.network.search import NetworkSearchResult
from thermaltool.signals.gauss_newton import inverse_of


def network_covariances(
    problem: NetworkProblem, found: NetworkSearchResult
) -> tuple[list[Array], list[float]]:
    """Covariance of ln τ and the weights of every output, and the variance of its errors.

    Parameters
    ----------
    problem : NetworkProblem
    found : NetworkSearchResult

    Returns
    -------
    covariances : list of ndarray, shape (N + m · N, N + m · N)
        Of the logarithms of the N time constants, then of the weights input by input.
    variances : list of float [unit²]

    Notes
    -----
    The estimates are linear in the errors near the optimum. The colour of the errors is an AR model
    for each output; rows that are filtered backwards by it have the products with white noise that
    the rows have with the errors. What drives the outputs' errors may be correlated (Ljung 1999,
    9.4).
    """
    n, own = len(found.time_constants), len(found.time_constants) * len(problem.data.inputs)
    outputs = range(len(found.projected))
    freedom = [max(f.rows - len(f.linear) - n / len(outputs), 1.0) for f in found.projected]
    variances = [f.loss / free for f, free in zip(found.projected, freedom, strict=True)]
    information = sum((f.reduced / v for f, v in zip(found.projected, variances, strict=True)),
                      np.zeros((n, n)))  # fmt: skip
    bread = inverse_of(information)
    inverses = [inverse_of(f.gram)[:own] for f in found.projected]
    filters, noise = _colours(problem, found)
    of_taus, of_weights = np.zeros((n, n)), np.zeros((len(outputs), own, own))
    mixed = np.zeros((len(outputs), own, n))
    for j, place in enumerate(problem.places(n, False)):
        rows = [problem.sensitivities(j, k, found.time_constants, found.projected[k])
                for k in outputs]  # fmt: skip
        slopes, linear = (
            [np.asarray(lfilter([1.0], filters[k], rows[k][part][:, ::-1])) for k in outputs]
            for part in (0, 1)
        )
        # How ln τ follows what drives the errors of each output, and its covariance with that.
        effects = np.array([bread @ slopes[k] / variances[k] for k in outputs])
        joint = np.tensordot(noise, effects, 1)
        for k in outputs:
            weights = inverses[k][:, place] @ linear[k]
            of_taus += effects[k] @ joint[k].T
            mixed[k] += weights @ joint[k].T
            of_weights[k] += noise[k, k] * weights @ weights.T
    covariances = []
    for k, f in enumerate(found.projected):
        # Weights at given time constants, then as these move.
        turn = np.eye(n + own)
        turn[n:, :n] = -f.by_taus[:own]
        parts = np.block([[of_taus, mixed[k].T], [mixed[k], of_weights[k]]])
        # Errors of the fit are smaller than the noise by the parameters that they were taken for.
        covariances.append(turn @ parts @ turn.T * (f.rows / freedom[k]))
    return covariances, variances


def _colours(problem: NetworkProblem, found: NetworkSearchResult) -> tuple[list[Array], Array]:
    """AR polynomials of the errors of every output, and the covariance of what drives them."""
    errors: list[list[Array]] = [[] for _ in found.projected]
    for k, _, error in problem.errors(found.time_constants, found.projected):
        errors[k].append(error)
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
