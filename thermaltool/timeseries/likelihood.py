"""Exact Gaussian likelihood of an ARMA process at the cost of a digital filter.

What the past before a run adds to it enters as a vector c of max(p, q) numbers,
θ(B) a = φ(B) x - c, with c ~ N(0, σ² Ω) (the state of the prediction form at the first sample). A
filter with zero past gives a⁰ = a + H c, H the shifted impulse responses of 1/θ, which decay within
tens of samples. Integrating c out leaves

    S = |a⁰|² - g'(Ω⁻¹ + G)⁻¹ g,   log|Σ| = log|I + Ω G|,   g = H'a⁰, G = H'H:

the same as the Kalman filter's likelihood, but after the decay nothing remains except the filter.
σ² and the regressors (mean, trend) are concentrated out. Over a hole the state is predicted and
its covariance grows; this is the likelihood of the samples that are there.

Own, because `statsmodels.tsa.innovations.arma_innovations.arma_loglike` takes no holes and 6.8 ms
for 10⁵ samples of ARMA(3, 2) where this takes 1.1, and has no exact gradient; the two agree to the
last digit.

Sources: G. Gardner, A. C. Harvey, G. D. A. Phillips, Appl. Statist. 29 (1980) 311 (state form);
G. M. Ljung, G. E. P. Box, Biometrika 66 (1979) 265 (initial values integrated out).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.timeseries.lagged import Shifted, inner, lagged_gram, products_of
from thermaltool.timeseries.polynomials import decayed_response
from thermaltool.timeseries.runs import NEW_START, gaps, places, runs, samples, with_samples
from thermaltool.timeseries.state import (
    accumulated,
    companion,
    expected_gram,
    padded,
    predicted,
    root_of,
    state_covariance,
)

Array = NDArray[np.float64]

GRADIENT_STEP = 1e-7  # of coefficients, for differences of the likelihood where there are holes
MIN_DEVIATION = 1e-13  # of the largest sample: what is left below is rounding


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of one pair of polynomials, with σ² and regressors at their best.

    Attributes
    ----------
    square : float
        S: σ² = S / size [unit²].
    logdet : float
        log|Σ/σ²|.
    coefficients : ndarray (k,)
        Of the regressors (mean first) [unit].
    precision : ndarray (k, k)
        X' (Σ/σ²)⁻¹ X.
    size : int
    """

    square: float
    logdet: float
    coefficients: Array
    precision: Array
    size: int

    @property
    def sigma2(self) -> float:
        """Variance of the innovations [unit²]."""
        return self.square / self.size

    @property
    def deviance(self) -> float:
        """-2 log L, the constant included."""
        return self.size * (float(np.log(2.0 * np.pi * self.sigma2)) + 1.0) + self.logdet


@dataclass(frozen=True)
class Slope:
    """Likelihood at a point with what a step of Gauss and Newton needs.

    Attributes
    ----------
    at : Likelihood
    gradient : ndarray (p + q,)
        Of the deviance.
    curvature : ndarray (p + q, p + q)
        Twice the information: second derivatives of the deviance without those of the innovations.
    """

    at: Likelihood
    gradient: Array
    curvature: Array


class ArmaLikelihood:
    """Likelihood of a record as a function of (ar, ma).

    Parameters
    ----------
    record : Record
        Even, of one channel.
    degree : int
        Of the trend that is estimated along: regressors 1, t, ... with t from 0 to 1; -1 for none.

    Attributes
    ----------
    size : int
        Samples that are there.
    regressors : int
    offset : float
        Mean that was taken off first, so that large numbers keep their digits; coefficients of
        the mean count from it [unit].
    duration : float
        From the first row to the last sample [samples].

    Raises
    ------
    FitError
        No sample at all.
    """

    def __init__(self, record: Record, degree: int) -> None:
        rows = runs(record)
        self._record, self._rows, self._gaps = record, rows, gaps(record, rows)
        values = samples(record)
        there = np.concatenate([values[run] for run in rows])
        self.size, self.regressors = there.size, degree + 1
        self.offset = float(there.mean()) if degree >= 0 else 0.0
        clock = places(record)
        self.duration = max(float(clock[rows[-1].stop - 1]), 1.0)
        trend = [(clock / self.duration) ** k for k in range(degree + 1)]
        whole = np.stack([values - self.offset, *trend])
        self._columns = [np.ascontiguousarray(whole[:, run]) for run in rows]

    @property
    def runs(self) -> int:
        """Runs without a hole: each costs a filter of its own."""
        return len(self._columns)

    @cached_property
    def detrended(self) -> Record:
        """Record without its regressors (least squares).

        Raises
        ------
        FitError
            Nothing is left: constant, or an exact line.
        """
        values = samples(self._record)
        there = np.concatenate([values[run] for run in self._rows])
        columns = np.concatenate(self._columns, axis=1)
        products = products_of(columns)
        best = np.asarray(np.linalg.solve(products[1:, 1:], products[1:, 0]), float)
        x = _without(columns, best)
        if np.sqrt(inner(x, x) / x.size) <= MIN_DEVIATION * float(np.abs(there).max()):
            shape = "constant" if self.regressors < 2 else "a straight line"
            raise FitError(f"the series is {shape}: it has no order")
        left = np.full(values.size, np.nan)
        left[np.isfinite(values)] = x
        return with_samples(self._record, left)

    def at(self, ar: Array, ma: Array) -> Likelihood:
        """Exact likelihood at `ar` (stationary) and `ma` (invertible)."""
        steps = self._filtered(ar, ma)
        products = np.sum([step.products for step in steps], axis=0)
        return _concentrated(products, sum(step.logdet for step in steps), self.size)

    def innovations(self, ar: Array, ma: Array, coefficients: Array) -> Array:
        """Innovations of all runs in a row, ndarray (size,) [unit].

        The state before each run is the most likely one, given the run.
        """
        steps = self._filtered(ar, ma)
        return np.concatenate([_without(step.innovations, coefficients) for step in steps])

    def final_state(self, ar: Array, ma: Array) -> tuple[Array, Array]:
        """State after the last sample, ndarray (r,), and its covariance in units of σ², (r, r).

        For a likelihood without regressors. The expectation of the next sample is the state's
        first element; `transition` leads on.
        """
        last = self._filtered(ar, ma)[-1]
        return last.mean[:, 0], last.covariance

    def slope(self, ar: Array, ma: Array) -> Slope:
        """Exact gradient of the deviance in (ar, ma), and the Gauss-Newton curvature.

        With c at its best, ∂S = 2 a'∂a|_c - w'∂Ω w, w = H'a; the innovations' sensitivities are
        one filter each, -x_{t-i}/θ(B) and -a_{t-j}/θ(B).
        """
        if not ar.size + ma.size:
            return Slope(self.at(ar, ma), np.empty(0), np.empty((0, 0)))
        if self.runs > 1:
            return self._differenced(ar, ma)
        phi, theta = padded(ar, ma)
        order, p, q = phi.size - 1, ar.size, ma.size
        (run,), columns, size = self._filtered(ar, ma), self._columns[0], self.size
        past, root, G, A = run.past, run.root, run.gram, run.A
        at = _concentrated(run.products, run.logdet, size)
        x, a = _without(columns, at.coefficients), _without(run.innovations, at.coefficients)
        w = past.against(a[None])[:, 0]
        u, v = lfilter([1.0], theta, np.stack((x, a))) if q else (x, a)
        slopes = [inner(a[i:], u[: size - i]) for i in range(1, p + 1)]
        slopes += [inner(a[j:], v[: size - j]) for j in range(1, q + 1)]
        posterior = root @ np.linalg.solve(A, root.T)
        on_covariance = G - G @ posterior @ G - size / at.square * w[:, None] * w
        gradient = -2.0 * size / at.square * np.array(slopes)
        kept = np.concatenate((np.arange(p), order + np.arange(q)))
        gradient += _through_covariance(phi, theta, run.prior, on_covariance)[kept]
        if q:
            gradient[p:] += _through_responses(theta, past, posterior)[:q]
        curvature = 2.0 * size / at.square * lagged_gram(u, v, p, q)
        return Slope(at, gradient, curvature)

    def _differenced(self, ar: Array, ma: Array) -> Slope:
        """`slope` by differences of the whole likelihood: for records with holes."""
        at = self.at(ar, ma)
        point = np.concatenate((ar, ma))
        gradient = np.empty(point.size)
        for k in range(point.size):
            moved = point.copy()
            moved[k] += GRADIENT_STEP
            there = self.at(moved[: ar.size], moved[ar.size :])
            gradient[k] = (there.deviance - at.deviance) / GRADIENT_STEP
        return Slope(at, gradient, 2.0 * at.size * expected_gram(ar, ma))

    def _filtered(self, ar: Array, ma: Array) -> list[_Filtered]:
        """Every run from the state that those before it leave."""
        phi, theta = padded(ar, ma)
        covariance = prior = state_covariance(-phi[1:], theta[1:])
        mean = np.zeros((phi.size - 1, self.regressors + 1))
        steps = []
        for columns, gap in zip(self._columns, self._gaps, strict=True):
            if gap == NEW_START:
                covariance, mean = prior, np.zeros_like(mean)
            elif gap:
                mean, covariance = predicted(phi, theta, mean, covariance, gap)
            steps.append(_filter(columns, phi, theta, mean, covariance))
            mean, covariance = steps[-1].mean, steps[-1].covariance
        return steps


@dataclass(frozen=True)
class _Filtered:
    """One run: innovations (of samples and regressors), their products, log determinant, state.

    `prior` is the covariance Ω = root root' of the state before it, `past` the responses to that
    state, `gram` G of them, A = I + root' G root.
    """

    innovations: Array
    products: Array
    logdet: float
    mean: Array
    covariance: Array
    prior: Array
    root: Array
    past: Shifted
    gram: Array
    A: Array


def _filter(columns: Array, phi: Array, theta: Array, mean: Array, covariance: Array) -> _Filtered:
    """One run from a state of this mean and covariance."""
    order, size = phi.size - 1, columns.shape[1]
    # The states of scipy's transposed form add to the input of 1/θ: they are -c.
    a, state = lfilter(phi, theta, columns, axis=1, zi=-mean.T)
    h = decayed_response(theta, size)
    past = Shifted(h, order, size)
    root, gram = root_of(covariance), past.gram()
    A = np.eye(order) + root.T @ gram @ root
    z, products = _smoothed(a, past, root, A)
    mean_after, covariance_after = -state.T, np.zeros((order, order))
    if h.size == size:  # the run was too short to forget what came before it
        passed = np.linalg.matrix_power(companion(-theta[1:]), size) @ root
        mean_after = mean_after + passed @ z
        covariance_after = passed @ np.linalg.solve(A, passed.T)
    logdet = float(np.linalg.slogdet(A)[1])
    return _Filtered(
        a, products, logdet, mean_after, covariance_after, covariance, root, past, gram, A
    )


def _smoothed(a: Array, past: Shifted, root: Array, A: Array) -> tuple[Array, Array]:
    """Take what the state adds out of `a` in place: the state, and the products of S.

    With Ω = L L' and c = L z, S = |a⁰ - H L z|² + |z|²: sums of squares, which rounding leaves
    positive, at z = (I + L'G L)⁻¹ L'H'a⁰.
    """
    z = np.asarray(np.linalg.solve(A, root.T @ past.against(a)), dtype=float)
    a[:, : past.rows] -= past.spread(root @ z)
    return z, products_of(a) + z.T @ z


def _concentrated(products: Array, logdet: float, size: int) -> Likelihood:
    """Likelihood with σ² and the regressors at their best."""
    precision, cross = products[1:, 1:], products[1:, 0]
    best = np.asarray(np.linalg.solve(precision, cross), dtype=float)
    square = float(products[0, 0] - cross @ best)
    return Likelihood(max(square, np.finfo(float).tiny), logdet, best, precision, size)


def _without(columns: Array, coefficients: Array) -> Array:
    """First of `columns` less the others times their coefficients, ndarray (n,)."""
    x = columns[0].copy()
    for coefficient, column in zip(coefficients, columns[1:], strict=True):
        x -= coefficient * column
    return x


def _through_covariance(phi: Array, theta: Array, covariance: Array, weight: Array) -> Array:
    """Σ weight_ij ∂Ω_ij in (ar, ma), ndarray (2 r,).

    ∂Ω = T ∂Ω T' + M with an M of rank two for each coefficient; the adjoint of that equation is
    solved once for all of them.
    """
    T, drive = companion(-phi[1:]), theta[1:] - phi[1:]
    Z = accumulated(T.T, 0.5 * (weight + weight.T))
    return 2.0 * np.concatenate((Z @ (T @ covariance[:, 0] + drive), Z @ drive))


def _through_responses(theta: Array, past: Shifted, weight: Array) -> Array:
    """Σ weight_ij ∂G_ij in ma, ndarray (r,), for a symmetric `weight`; ∂h/∂ma_j = -B^j h/θ."""
    r = past.order
    C = weight @ past.products(np.asarray(lfilter([1.0], theta, past.h)), 2 * r)
    # Sums along the diagonals 1 to r: rows one longer than those of C put each into a column.
    skewed = np.concatenate((C.ravel(), np.zeros(r))).reshape(r, 2 * r + 1)
    return np.asarray(-2.0 * skewed.sum(axis=0)[1 : r + 1])
