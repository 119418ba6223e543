"""Least squares: scaled normal equations, and one damped Gauss-Newton loop over them.

Sources: K. Levenberg, Quart. Appl. Math. 2 (1944) 164; D. W. Marquardt, J. SIAM 11 (1963) 431 (the
damping in the scale of each parameter).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgelsd, dgelsd_lwork

from thermaltool.signals.symmetric import eigh

Array = NDArray[np.float64]
P = TypeVar("P")

# Directions of normal equations below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-13
# A column below this size is rounding: its square has no inverse.
MIN_SIZE = 1e-100
# Damping, as a share of the diagonal: at first; after many good steps; where no step is left.
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-12, 1e8
# Factor of the damping after a bad step; its inverse after a good one.
DAMPING_STEP = 10.0


def solve(matrix: Array, right: Array) -> Array:
    """matrix⁻¹ right, scaled to a diagonal of ones first; directions without support stay at zero.

    Parameters
    ----------
    matrix : ndarray, shape (p, p)
        Symmetric, or nearly so.
    right : ndarray, shape (p,) or (p, k)
    """
    if not right.size:
        return np.zeros_like(right)
    size = _sizes(matrix)
    columns = right.reshape(len(matrix), -1) / size[:, None]
    # What numpy's lstsq calls, without its checks: systems of a few unknowns, very many of them.
    work = _work_space(*columns.shape)
    answer, _, _, info = dgelsd(matrix / (size[:, None] * size), columns, *work, MIN_DIRECTION)
    if info:
        raise np.linalg.LinAlgError("the singular values of a linear system do not converge")
    return np.asarray(answer / size[:, None]).reshape(right.shape)


@lru_cache(maxsize=256)
def _work_space(unknowns: int, columns: int) -> tuple[int, int]:
    """Lengths of the arrays that the solution of a linear system works in."""
    real, whole, _ = dgelsd_lwork(unknowns, unknowns, columns, MIN_DIRECTION)
    return int(real), int(whole)


def inverse_of(information: Array) -> Array:
    """Inverse of an information matrix, shape (p, p): directions without support get a huge one.

    Parameters
    ----------
    information : ndarray, shape (p, p)
        Symmetric.
    """
    size = _sizes(information)
    values, vectors = eigh(information / np.outer(size, size))
    least = MIN_DIRECTION * max(float(values[-1]), 1e-300)
    return np.asarray((vectors / np.maximum(values, least)) @ vectors.T / np.outer(size, size))


def _sizes(matrix: Array) -> Array:
    """Square roots of the diagonal, one where it is zero or nearly so."""
    size = np.sqrt(np.abs(matrix.diagonal()))
    size[~(size > MIN_SIZE)] = 1.0
    return np.asarray(size)


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where a search ended.

    Attributes
    ----------
    point : P
    value : float
    converged : bool
        No step is left that gains more than the tolerance.
    """

    point: P
    value: float
    converged: bool


def minimize(
    start: P,
    value: Callable[[P], float],
    normal_equations: Callable[[P], tuple[Array, Array]],
    moved: Callable[[P, Array], P],
    tolerance: Callable[[P], float],
    max_iterations: int,
    abandoned: Callable[[P], bool] = lambda point: False,
) -> Minimum[P]:
    """Minimum of a sum of squares or of a deviance, by damped Gauss-Newton steps.

    Around a point, value(point + d) ≈ value − 2 score·d + d·matrix·d.

    Parameters
    ----------
    start : P
        Any carrier of parameters; it may keep what its evaluation found.
    value : callable
        Not finite where a point is out of bounds.
    normal_equations : callable
        Gauss-Newton matrix (p, p), half the second derivatives, and score (p,), minus half the
        gradient.
    moved : callable
        The point after a step (p,), kept within bounds.
    tolerance : callable
        A step that gains no more than this is not taken, nor one tried that promises no more.
    max_iterations : int
    abandoned : callable
        Whether to give up at a point.
    """
    here, level, damping = start, value(start), FIRST_DAMPING
    for _ in range(max_iterations):
        matrix, score = normal_equations(here)
        enough = tolerance(here)
        if float(score @ solve(matrix, score)) <= enough:
            return Minimum(here, level, True)
        diagonal = np.diag(np.diag(matrix))
        while True:
            there = moved(here, solve(matrix + damping * diagonal, score))
            reached = value(there)
            if reached < level or damping > MAX_DAMPING:
                break
            damping *= DAMPING_STEP
        if not level - reached > enough:
            return Minimum(here, level, True)
        here, level = there, reached
        if abandoned(here):
            return Minimum(here, level, False)
        damping = max(damping / DAMPING_STEP, MIN_DAMPING)
    return Minimum(here, level, False)
