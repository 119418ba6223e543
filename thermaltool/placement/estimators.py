"""Weights of many columns: least squares, ridge, elastic net, principal components, PLS.

Each takes columns about their means and scaled to one size, and says how it was tuned: the ridge
by the evidence, the likelihood with the weights integrated out (MacKay 1992); the others by blocks
that are held out in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.components.reduction import METHODS as DIRECTIONS
from thermaltool.fitting.data import Array

Method = Literal["least-squares", "ridge", "elastic-net", "pcr", "pls"]
METHOD_NAMES = get_args(Method)
Folds = Sequence[NDArray[np.bool_]]

# Eigenvalues of the scaled columns below this part of the largest are rounding.
MIN_EIGENVALUE = 1e-12
# Variance of the errors over that of the weights, of which the evidence decides.
RIDGES = 10.0 ** np.arange(-10, 3.1, 0.25)
# Penalties of the elastic net, as parts of the one that leaves no weight; the part of |w| in it.
PENALTIES, ABSOLUTE_PART = 10.0 ** np.arange(-0.5, -7.1, -0.5), 0.5
# Passes of the coordinate descent, and the part of a penalty by which a gradient may exceed it.
MAX_PASSES, GRADIENT_TOLERANCE = 300, 1e-6
# Components that are tried at most.
MAX_COMPONENTS = 20


@dataclass(frozen=True)
class Weighting:
    """Weights of scaled columns.

    Attributes
    ----------
    weights : ndarray, shape (F,)
    freedom : float
        How many of them are free.
    tuning : str
        What was chosen.
    spread : ndarray, shape (F, F)
        Their covariance over the variance of an error.
    """

    weights: Array
    freedom: float
    tuning: str
    spread: Array


def least_squares(x: Array, y: Array, folds: Folds, share: float) -> Weighting:
    """Ordinary least squares, the smallest weights where columns are combinations of others."""
    values, vectors, pull = _eigen(x, y)
    kept = values > MIN_EIGENVALUE * values.max(initial=0.0)
    inverse = np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)
    spread = (vectors * inverse) @ vectors.T
    return Weighting(vectors @ (inverse * pull), float(kept.sum()), "", spread)


def ridge(x: Array, y: Array, folds: Folds, share: float) -> Weighting:
    """Normal weights of one variance; the evidence counts the rows that are independent."""
    values, vectors, pull = _eigen(x, y)
    # Rows whose errors drift together are worth fewer.
    values, pull, power, n = values * share, pull * share, float(y @ y) * share, len(y) * share
    left = power - np.sum(pull[:, None] ** 2 / (values[:, None] + RIDGES), axis=0)
    left = np.maximum(left, MIN_EIGENVALUE * power)
    levels = n * np.log(left / n) + np.sum(np.log1p(values[:, None] / RIDGES), axis=0)
    best = RIDGES[int(np.argmin(levels))]
    spread = (vectors / (values + best)) @ vectors.T * share
    freedom = float(np.sum(values / (values + best)))
    return Weighting(vectors @ (pull / (values + best)), freedom, f"{best / n:.2g}", spread)


def elastic_net(x: Array, y: Array, folds: Folds, share: float) -> Weighting:
    """Least squares with penalties on |w| and w² (Zou and Hastie 2005).

    The output has unit size for it: the penalty on w² is else one of another unit.
    """
    size = float(np.sqrt(np.mean(y**2))) or 1.0

    def path(gram: Array, cross: Array) -> list[Array]:
        start, found = np.zeros(len(cross)), []
        most = np.max(np.abs(cross), initial=0.0) / ABSOLUTE_PART
        for part in PENALTIES:
            start = _descended(gram, cross, part * most, start)
            found.append(start)
        return found

    def weights_of(a: Array, b: Array) -> list[Array]:
        found = path(a @ a.T / len(b), a @ b / len(b) / size)
        return [size * w for w in found]

    weights = weights_of(x, y)[_best_by_folds(x, y, folds, weights_of)]
    own = np.flatnonzero(weights)
    spread = np.zeros((len(weights), len(weights)))
    spread[np.ix_(own, own)] = np.linalg.pinv(x[own] @ x[own].T, hermitian=True)
    return Weighting(weights, float(len(own)), f"{len(own)} columns", spread)


def _descended(gram: Array, cross: Array, penalty: float, start: Array) -> Array:
    """Coordinate descent, which finds signs, and a solution for these (Lee et al. 2007)."""
    w, absolute, square = start.copy(), penalty * ABSOLUTE_PART, penalty * (1 - ABSOLUTE_PART)
    size = np.maximum(np.diag(gram) + square, 1e-300)
    for _ in range(MAX_PASSES):
        for j in range(len(w)):
            pull = cross[j] - gram[j] @ w + gram[j, j] * w[j]
            w[j] = np.sign(pull) * max(abs(pull) - absolute, 0.0) / size[j]
        # Alone it creeps where columns are nearly combinations of each other.
        while len(own := np.flatnonzero(w)):
            signs = np.sign(w[own])
            matrix = gram[np.ix_(own, own)] + square * np.eye(len(own))
            move = np.linalg.solve(matrix, cross[own] - absolute * signs) - w[own]
            turned = signs * (w[own] + move) <= 0
            if not turned.any():
                w[own] += move
                break
            # As far as the first weight that reaches zero: it is left out.
            steps = np.where(turned, -w[own] / np.where(turned, move, 1.0), np.inf)
            w[own] += steps.min() * move
            w[own[np.argmin(steps)]] = 0.0
        out = w == 0
        slope = np.abs(cross - gram @ w)[out]
        if np.max(slope, initial=0.0) <= absolute * (1 + GRADIENT_TOLERANCE):
            break
    return w


def pcr(x: Array, y: Array, folds: Folds, share: float) -> Weighting:
    """Least squares on the first principal components; how many by held-out blocks."""
    return _reduced("pca", x, y, folds)


def pls(x: Array, y: Array, folds: Folds, share: float) -> Weighting:
    """Partial least squares (Wold, Sjöström, Eriksson 2001); how many by held-out blocks."""
    return _reduced("pls", x, y, folds)


def _reduced(kind: Literal["pca", "pls"], x: Array, y: Array, folds: Folds) -> Weighting:
    most = min(MAX_COMPONENTS, len(x))

    def path(a: Array, b: Array) -> list[Array]:
        loadings = DIRECTIONS[kind](a, b)
        return [component_weights(loadings[:, :k], a, b) for k in range(1, most + 1)]

    best = 1 + _best_by_folds(x, y, folds, path)
    loadings = DIRECTIONS[kind](x, y)[:, :best]
    scores = loadings.T @ x
    spread = loadings @ np.linalg.pinv(scores @ scores.T, hermitian=True) @ loadings.T
    weights = component_weights(loadings, x, y)
    return Weighting(weights, float(best), f"{best} components", spread)


def component_weights(loadings: Array, x: Array, y: Array) -> Array:
    """Weights of the columns where only some directions of them are fitted.

    Parameters
    ----------
    loadings : ndarray, shape (F, k)
    x : ndarray, shape (F, n)
    y : ndarray, shape (n,)
    """
    scores = loadings.T @ x
    return np.asarray(loadings @ np.linalg.lstsq(scores.T, y, rcond=None)[0])


def _best_by_folds(
    x: Array, y: Array, folds: Folds, path: Callable[[Array, Array], list[Array]]
) -> int:
    """Which of a path of weights predicts blocks best that it was not fitted to."""
    scores = []
    for held in folds:
        own = path(*_centred(x[:, ~held], y[~held]))
        level = x[:, ~held].mean(axis=1), y[~held].mean()
        errors = [y[held] - level[1] - w @ (x[:, held] - level[0][:, None]) for w in own]
        scores.append([np.log(max(float(np.mean(e**2)), 1e-300)) for e in errors])
    return int(np.argmin(np.mean(scores, axis=0))) if scores else -1


def _centred(x: Array, y: Array) -> tuple[Array, Array]:
    return x - x.mean(axis=1, keepdims=True), y - y.mean()


def _eigen(x: Array, y: Array) -> tuple[Array, Array, Array]:
    values, vectors = np.linalg.eigh(x @ x.T)
    return np.maximum(values, 0.0), vectors, vectors.T @ (x @ y)


def blocks_of(rows: NDArray[np.intp], count: int, size: int) -> Iterator[NDArray[np.bool_]]:
    """Blocks of consecutive rows, as masks of all.

    Parameters
    ----------
    rows : ndarray of int
        Rows that are parted.
    count : int
    size : int
        Number of all rows.
    """
    for part in np.array_split(rows, count):
        held = np.zeros(size, bool)
        held[part] = True
        if len(part):
            yield held


ESTIMATORS: dict[Method, Callable[[Array, Array, Folds, float], Weighting]] = {
    "least-squares": least_squares,
    "ridge": ridge,
    "elastic-net": elastic_net,
    "pcr": pcr,
    "pls": pls,
}
