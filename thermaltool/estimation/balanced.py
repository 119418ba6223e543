"""Balanced truncation of responses with many close modes, for estimators.

The exponentials of a diffusive response are as many as its range of rates asks for, and nearly
dependent: covariances over them are rounding where the noise is small. States that hardly pass
anything from input to output are left out when an estimator is designed; design, log and stream
then run the same recursion (Moore 1981; the bound is that of Glover 1984 and Enns 1984).
"""

from __future__ import annotations

import numpy as np

from thermaltool.responses.modes import Float, Modes

# So few states are no trouble.
MIN_STATES = 6


def balanced(modes: Modes, tolerance: float) -> tuple[Modes, float]:
    """A response of fewer modes.

    Parameters
    ----------
    modes : Modes
        With real single poles; any other is left as it is.
    tolerance : float [unit of the response]
        How far the response may be off for an input of one, at any frequency.

    Returns
    -------
    modes : Modes
    error : float [unit of the response]
        The bound that it keeps: twice the sum of the Hankel singular values that are left out.
    """
    rates, at = np.unique(-modes.poles.real, return_inverse=True)
    plain = not (np.any(modes.poles.imag) or np.any(modes.double) or modes.direct)
    if len(rates) <= MIN_STATES or not plain or rates[0] <= 0:
        return modes, 0.0
    weights = np.zeros(len(rates))
    np.add.at(weights, at, modes.weights.real)
    # The fastest first: pivots fall.
    rates, weights = rates[::-1], weights[::-1]
    root = _gramian_root(rates)
    # One input and one output: the observability Gramian is W Wc W, so that the product of the
    # roots is symmetric and its eigenvalues are the Hankel singular values with a sign.
    signed, U = np.linalg.eigh(root.T @ (weights[:, None] * root))
    order = np.argsort(-np.abs(signed))
    signed, U = signed[order], U[:, order]
    left = 2 * np.append(np.cumsum(np.abs(signed)[::-1])[::-1], 0.0)
    count = max(int(np.argmax(left <= tolerance)), 1)
    if count == len(rates):
        return modes, 0.0
    scale = 1 / np.sqrt(np.abs(signed[:count]))
    states = root @ U[:, :count] * scale
    costates = weights[:, None] * states * np.sign(signed[:count])
    poles, vectors = np.linalg.eig(-costates.T @ (rates[:, None] * states))
    taken = (weights @ states) @ vectors * np.linalg.solve(vectors, costates.sum(axis=0) + 0j)
    upper = poles.imag >= 0
    poles, taken = poles[upper] + 0j, np.where(poles.imag == 0, taken.real, taken)[upper] + 0j
    return Modes(poles, taken), float(left[count])


def _gramian_root(rates: Float) -> Float:
    """Cholesky root of the controllability Gramian 1/(rᵢ + rⱼ), shape (n, n).

    Schur complements of a Cauchy matrix are known in closed form (Demmel 1999): no digit is lost
    however close the rates are.
    """
    rest = 1 / (rates[:, None] + rates)
    root = np.zeros(rest.shape)
    for k, rate in enumerate(rates):
        root[k:, k] = rest[k:, k] / np.sqrt(rest[k, k])
        apart = (rates - rate) / (rates + rate)
        rest = rest * apart[:, None] * apart
    return root
