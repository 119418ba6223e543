"""Exact likelihood of white noise plus Ornstein-Uhlenbeck drift at any sample times.

The precision matrix of the drift is tridiagonal for any sample times, so the likelihood costs
O(n). Each block's polynomial is integrated out (restricted likelihood), which takes away the bias
that its coefficients would cause.

Sources: G. B. Rybicki, W. H. Press, Class of fast methods for processing irregularly sampled or
otherwise inhomogeneous one-dimensional data, Phys. Rev. Lett. 74 (1995) 1060; D. A. Harville,
J. Am. Stat. Assoc. 72 (1977) 320 (restricted likelihood).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpttrf, dpttrs
from scipy.optimize import minimize

Array = NDArray[np.float64]

PARAMETER_TOLERANCE = 0.02  # of the simplex [log parameter]: far below standard errors


class ColouredNoise:
    """White noise plus Ornstein-Uhlenbeck drift at given sample times: products with its inverse.

    Parameters
    ----------
    time : ndarray (n,)
        Sample times [s], increasing within each block.
    starts : ndarray (b,) of int
        First sample of each block; blocks are independent.
    weight : ndarray (n,), optional
        White variance of a sample relative to that of a single reading (1/m for a mean of m).
    period : float, optional
        Sample period [s]; the median step by default.
    """

    def __init__(
        self,
        time: Array,
        starts: NDArray[np.int64],
        weight: Array | None = None,
        period: float | None = None,
    ) -> None:
        self.size, self.starts = time.size, starts
        self.weight = np.ones(self.size) if weight is None else weight
        first, last = time[starts], time[np.append(starts[1:], self.size) - 1]
        self.span = float(np.max(last - first))
        steps = np.diff(time)
        joint = np.ones(max(self.size - 1, 0), dtype=bool)
        joint[starts[1:] - 1] = False
        self.period = float(np.median(steps[joint])) if period is None else period
        # Few distinct steps make few exponentials: times printed in decimals repeat theirs.
        rounded = np.round(np.where(joint, steps, self.period) / self.period, 7)
        self.steps, self.which = np.unique(rounded * self.period, return_inverse=True)
        self.counts = np.bincount(self.which[joint], minlength=self.steps.size)
        self.which[~joint] = self.steps.size  # a table's last entry: no coupling

    def factor(self, ratio: float, tau: float) -> Factor:
        """For a drift of variance `ratio` (in units of the white variance) and constant `tau`."""
        logdet = float(np.log(self.weight).sum())
        if ratio <= 0.0:
            return Factor(self.weight, None, logdet)
        decay = np.exp(-self.steps / tau)
        loss = -np.expm1(-2.0 * self.steps / tau)
        coupling = np.append(decay / (loss * ratio), 0.0)[self.which]
        diagonal = 1.0 / self.weight + 1.0 / ratio
        kept = np.append(decay, 0.0)[self.which]
        forward = kept * coupling
        diagonal[:-1] += forward
        diagonal[1:] += forward
        d, e, _ = dpttrf(diagonal, -coupling, overwrite_d=True, overwrite_e=True)
        log_loss = float(np.dot(self.counts, np.log(loss)))
        logdet += float(np.log(d).sum() + self.size * np.log(ratio) + log_loss)
        drift = Drift(
            (d, e),
            kept,
            np.append(-np.expm1(-self.steps / tau), 0.0)[self.which],
            np.append(1.0 / (loss * ratio), 0.0)[self.which],
            self.starts,
            ratio,
        )
        return Factor(self.weight, drift, logdet)


@dataclass(frozen=True)
class Drift:
    """The inverse covariance of an Ornstein-Uhlenbeck drift, as what each step adds.

    Of one drift, or of several in the rows of its arrays. Time runs along the last axis.

    Attributes
    ----------
    triangle : (ndarray, ndarray)
        Factors of its tridiagonal sum with that of the white noise; of several drifts one after
        the other.
    decay, lost : ndarray (..., n - 1)
        What is left of a value at the next sample, and one less that.
    inverse : ndarray (..., n - 1)
        One over the variance of a step; zero between blocks.
    starts : ndarray (b,) of int
    ratio : float or ndarray (..., 1)
        Variance of the first sample of a block.
    """

    triangle: tuple[Array, Array]
    decay: Array
    lost: Array
    inverse: Array
    starts: NDArray[np.int64]
    ratio: float | Array

    def times(self, rows: Array) -> Array:
        """The inverse covariance times `rows`, ndarray (..., n), from differences of neighbours.

        The tridiagonal matrix itself would take nearly equal numbers from each other, and the
        slow signals that are compared here would lose half of their digits.
        """
        steps = self._steps(rows)
        steps *= self.inverse
        result = np.zeros((*steps.shape[:-1], rows.shape[-1]))
        result[..., self.starts] = rows[..., self.starts] / self.ratio
        result[..., 1:] += steps
        steps *= self.decay
        result[..., :-1] -= steps
        return result

    def divided(self, rows: Array) -> Array:
        """The inverse of the tridiagonal sum with the white noise, times `rows` (..., n)."""
        d, e = self.triangle
        # LAPACK wants one system a column: several drifts are one long system without coupling.
        solved, _ = dpttrs(d, e, rows.reshape(-1, d.size).T, overwrite_b=True)
        return np.asarray(solved.T.reshape(rows.shape))

    def whitened(self, rows: Array) -> Array:
        """Rows (..., n) whose products are those of `rows` under the inverse covariance."""
        result = np.empty(rows.shape)
        result[..., 1:] = self._steps(rows) * np.sqrt(self.inverse)
        result[..., self.starts] = rows[..., self.starts] / np.sqrt(self.ratio)
        return result

    def _steps(self, rows: Array) -> Array:
        """What each sample has that the one before does not leave."""
        steps = self.lost * rows[..., :-1]
        steps += rows[..., 1:] - rows[..., :-1]
        return steps


@dataclass(frozen=True)
class Factor:
    """A factored covariance, in units of the white variance.

    Attributes
    ----------
    weight : ndarray (n,)
    drift : Drift or None
        None for white noise alone.
    logdet : float
    """

    weight: Array
    drift: Drift | None
    logdet: float

    def solve(self, columns: Array) -> Array:
        """Inverse covariance times `columns`, ndarray (n, c)."""
        if self.drift is None:
            return columns / self.weight[:, None]
        rows = np.ascontiguousarray(columns.T)
        return np.asarray((self.drift.divided(self.drift.times(rows)) / self.weight).T)

    def whitened(self, columns: Array) -> Array:
        """Rows whose products are those of `columns` (n, c) under the inverse covariance.

        Above what is left beside the drift that explains a column best, below the steps of that
        drift: (2n, c), or (n, c) for white noise alone.
        """
        root = np.sqrt(self.weight)
        if self.drift is None:
            return np.asarray(columns / root[:, None])
        rows = np.ascontiguousarray(columns.T)
        slow = self.drift.divided(rows / self.weight)
        return np.concatenate([(rows - slow) / root, self.drift.whitened(slow)], axis=-1).T


class StackedFactors:
    """Several factored covariances of one noise: one column under all of them at once.

    Parameters
    ----------
    factors : sequence of Factor
        Of one `ColouredNoise`.
    """

    def __init__(self, factors: Sequence[Factor]) -> None:
        self.weight = factors[0].weight
        self.coloured = np.array([f.drift is not None for f in factors])
        drifts = [f.drift for f in factors if f.drift is not None]
        self.drift: Drift | None = None
        if drifts:
            d = np.concatenate([each.triangle[0] for each in drifts])
            e = np.concatenate([np.append(each.triangle[1], 0.0) for each in drifts])[:-1]
            self.drift = Drift(
                (d, e),
                np.stack([each.decay for each in drifts]),
                np.stack([each.lost for each in drifts]),
                np.stack([each.inverse for each in drifts]),
                drifts[0].starts,
                np.array([[each.ratio] for each in drifts]),
            )

    def solve(self, column: Array) -> Array:
        """Inverse covariances times one column (n,), ndarray (factors, n)."""
        result = np.empty((self.coloured.size, column.size))
        result[~self.coloured] = column
        if self.drift is not None:
            result[self.coloured] = self.drift.divided(self.drift.times(column))
        result /= self.weight
        return result


class RestrictedLikelihood:
    """Restricted likelihood of the readings as a function of (q, τ), q = rate² · period / σ_w².

    Parameters
    ----------
    time, values : ndarray (n,)
        Sample times [s], increasing within each block, and readings without NaN [unit].
    starts : ndarray (b,) of int
        First sample of each block; blocks are independent and each has its own polynomial.
    degree : int
        Of the polynomial in each block.
    weight : ndarray (n,), optional
        White variance of a sample relative to that of a single reading (1/m for a mean of m).
    period : float, optional
        Sample period that q refers to [s]; the median step by default.
    """

    def __init__(
        self,
        time: Array,
        values: Array,
        starts: NDArray[np.int64],
        degree: int,
        weight: Array | None = None,
        period: float | None = None,
    ) -> None:
        self.noise = ColouredNoise(time, starts, weight, period)
        self.starts, self.size, self.period = starts, values.size, self.noise.period
        self.span = self.noise.span
        self.dof = self.size - starts.size * (degree + 1)
        lengths = np.diff(np.append(starts, self.size))
        block = np.repeat(np.arange(starts.size), lengths)
        first, last = time[starts], time[np.append(starts[1:], self.size) - 1]
        u = 2.0 * (time - first[block]) / np.maximum(last - first, np.finfo(float).tiny)[block] - 1
        centre = np.add.reduceat(values, starts) / lengths
        columns = [values - centre[block], *(u**k for k in range(degree + 1))]
        self.columns = np.asfortranarray(np.stack(columns, axis=1))

    def _products(self, right: Array) -> Array:
        """Sums over each block of column_j · right_k, ndarray (b, c, c)."""
        c = self.columns.shape[1]
        out = np.empty((self.starts.size, c, c))
        for j in range(c):
            for k in range(j, c):
                product = self.columns[:, j] * right[:, k]
                out[:, j, k] = out[:, k, j] = np.add.reduceat(product, self.starts)
        return out

    def terms(self, walk: float, tau: float) -> tuple[float, float]:
        """Log determinant, and sum of squares in units of σ_w², of the restricted likelihood."""
        # The ratio of the variances, σ_d² / σ_w².
        factor = self.noise.factor(walk * tau / (2.0 * self.period), tau)
        products = self._products(factor.solve(self.columns))
        gram, cross = products[:, 1:, 1:], products[:, 1:, :1]
        fitted = np.einsum("bij,bij->b", cross, np.linalg.solve(gram, cross))
        square = float(np.sum(products[:, 0, 0] - fitted))
        return factor.logdet + float(np.linalg.slogdet(gram)[1].sum()), square

    def negative_log(self, walk: float, tau: float) -> float:
        """Negative logarithm, maximized over σ_w, up to a constant."""
        logdet, square = self.terms(walk, tau)
        return 0.5 * (self.dof * np.log(max(square, 1e-300) / self.dof) + logdet)

    def walk(self, ratio: float, tau: float) -> float:
        """q of a drift of variance `ratio` (in units of the white variance) and constant `tau`."""
        return 2.0 * self.period * ratio / tau


def least_on_grid(
    negative_log: Callable[[float, float], float],
    grid: Iterable[tuple[float, float]],
    bounds: Array,
    steps: tuple[float, float],
    tolerance: float,
    evaluations: int,
) -> tuple[Array, float]:
    """Least of a likelihood of two noise parameters: the best of a grid, then the simplex method.

    Parameters
    ----------
    negative_log : callable
        Of the logarithms of size and time constant of the drift.
    grid : iterable of (float, float)
        Where the search begins.
    bounds : ndarray, shape (2, 2)
        Lowest and highest of each.
    steps : (float, float)
        Size of the first simplex.
    tolerance : float
        Of `negative_log`, at which the simplex ends.
    evaluations : int
        Largest number after the grid.

    Returns
    -------
    point : ndarray, shape (2,)
    value : float
    """
    start = np.array(min(grid, key=lambda point: negative_log(*point)))

    def objective(point: Any) -> float:
        inside = np.clip(point, bounds[:, 0], bounds[:, 1])
        return negative_log(*inside.tolist()) + float(np.sum((point - inside) ** 2))

    found = minimize(
        objective,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": start + np.array([[0.0, 0.0], [steps[0], 0.0], [0.0, steps[1]]]),
            "xatol": PARAMETER_TOLERANCE,
            "fatol": tolerance,
            "maxfev": evaluations,
        },
    )
    return np.clip(found.x, bounds[:, 0], bounds[:, 1]), float(found.fun)
