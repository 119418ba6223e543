"""Exact Gaussian likelihood of an ARMA process at the cost of a digital filter.

What the past before a run adds to it enters as a vector c of max(p, q) numbers,
θ(B) a = φ(B) x - c, with c ~ N(0, σ² Ω) (the state of the prediction form at the first sample). A
filter with zero past gives a⁰ = a + H c, H the shifted impulse responses of 1/θ, which decay within
tens of samples. Integrating c out leaves

    S = |a⁰|² - g'(Ω⁻¹ + G)⁻¹ g,   log|Σ| = log|I + Ω G|,   g = H'a⁰, G = H'H:

the same as the Kalman filter's likelihood, but after the decay nothing remains except the filter.
σ² and the regressors (mean, trend) are concentrated out. Over a hole the state is predicted and
its covariance grows; this is the likelihood of the samples that are there.

Sources: G. Gardner, A. C. Harvey, G. D. A. Phillips, Appl. Statist. 29 (1980) 311 (state form);
G. M. Ljung, G. E. P. Box, Biometrika 66 (1979) 265 (initial values integrated out).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.timeseries.lagged import (
    Shifted,
    inner,
    lagged_gram,
    products_of,
)
from thermaltool.timeseries.polynomials import decayed_response
from thermaltool.timeseries.record import NEW_START, Record

Array = NDArray[np.float64]

_STEP = 1e-7  # of the differences where a record has holes
_UNSTEADY = 1e13  # largest variance of the state, in units of σ²


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
        return self.square / self.size

    @property
    def deviance(self) -> float:
        """-2 log L, the constant included."""
        return self.size * (float(np.log(2.0 * np.pi * self.sigma2)) + 1.0) + self.logdet


@dataclass(frozen=True)
class Data:
    """A record and its regressors, laid out for the filter.

    Attributes
    ----------
    record : Record
    columns : tuple of ndarray (1 + k, n_i)
        For each run: the samples less `offset`, then the regressors.
    offset : float
        Mean that was taken off first, so that large numbers keep their digits; coefficients of
        the mean count from it [unit].
    """

    record: Record
    columns: tuple[Array, ...]
    offset: float = 0.0

    @property
    def regressors(self) -> int:
        return self.columns[0].shape[0] - 1

    @cached_property
    def size(self) -> int:
        return self.record.size


def with_trend(record: Record, degree: int) -> Data:
    """A record with the regressors 1, t, ... up to `degree`; -1 for none. t runs over [0, 1]."""
    edges = np.cumsum([0] + [run.size for run in record.runs])
    places = record.places / max(record.places[-1], 1.0) if degree > 0 else np.zeros(record.size)
    trend = [places**k if k else np.ones(record.size) for k in range(degree + 1)]
    offset = float(record.values.mean()) if degree >= 0 else 0.0
    whole = np.stack([record.values - offset, *trend])
    cut = [np.ascontiguousarray(whole[:, a:b]) for a, b in pairwise(edges)]
    return Data(record, tuple(cut), offset)


def evaluate(data: Data, ar: Array, ma: Array) -> Likelihood:
    """Exact likelihood at `ar` (stationary) and `ma` (invertible)."""
    steps = _steps(data, ar, ma)
    products = np.sum([step.products for step in steps], axis=0)
    return _concentrated(products, sum(step.logdet for step in steps), data.size)


def final_state(data: Data, ar: Array, ma: Array) -> tuple[Array, Array]:
    """State after the last sample, ndarray (r,), and its covariance in units of σ², (r, r).

    For data without regressors. The expectation of the next sample is the state's first element;
    `transition` leads on.
    """
    last = _steps(data, ar, ma)[-1]
    return last.mean[:, 0], last.covariance


def transition(ar: Array, ma: Array) -> Array:
    """T, ndarray (r, r), of the expected state from one sample to the next."""
    return _companion(-_padded(ar, ma)[0][1:])


def _steps(data: Data, ar: Array, ma: Array) -> list[_Step]:
    phi, theta = _padded(ar, ma)
    order = phi.size - 1
    covariance = prior = state_covariance(-phi[1:], theta[1:])
    mean = np.zeros((order, data.regressors + 1))
    steps = []
    for columns, gap in zip(data.columns, data.record.gaps, strict=True):
        if gap == NEW_START:
            covariance, mean = prior, np.zeros_like(mean)
        elif gap:
            mean, covariance = _predict(phi, theta, mean, covariance, gap)
        steps.append(_filter(columns, phi, theta, mean, covariance))
        mean, covariance = steps[-1].mean, steps[-1].covariance
    return steps


def _concentrated(products: Array, logdet: float, size: int) -> Likelihood:
    precision, cross = products[1:, 1:], products[1:, 0]
    best = np.asarray(np.linalg.solve(precision, cross), dtype=float)
    square = float(products[0, 0] - cross @ best)
    return Likelihood(max(square, np.finfo(float).tiny), logdet, best, precision, size)


@dataclass(frozen=True)
class _Step:
    """One run: innovations (of samples and regressors), their products, log determinant, state."""

    innovations: Array
    products: Array
    logdet: float
    mean: Array
    covariance: Array


def _filter(columns: Array, phi: Array, theta: Array, mean: Array, covariance: Array) -> _Step:
    order, size = phi.size - 1, columns.shape[1]
    # The states of scipy's transposed form add to the input of 1/θ: they are -c.
    a, state = lfilter(phi, theta, columns, axis=1, zi=-mean.T)
    h = decayed_response(theta, size)
    past = Shifted(h, order, size)
    root = _root(covariance)
    A = np.eye(order) + root.T @ past.gram() @ root
    z, products = _smoothed(a, past, root, A)
    mean_after, covariance_after = -state.T, np.zeros((order, order))
    if h.size == size:  # the run was too short to forget what came before it
        passed = np.linalg.matrix_power(_companion(-theta[1:]), size) @ root
        mean_after = mean_after + passed @ z
        covariance_after = passed @ np.linalg.solve(A, passed.T)
    return _Step(a, products, float(np.linalg.slogdet(A)[1]), mean_after, covariance_after)


def _smoothed(a: Array, past: Shifted, root: Array, A: Array) -> tuple[Array, Array]:
    """Take what the state adds out of `a` in place: the state, and the products of S.

    With Ω = L L' and c = L z, S = |a⁰ - H L z|² + |z|²: sums of squares, which rounding leaves
    positive, at z = (I + L'G L)⁻¹ L'H'a⁰.
    """
    z = np.asarray(np.linalg.solve(A, root.T @ past.against(a)), dtype=float)
    a[:, : past.rows] -= past.spread(root @ z)
    return z, products_of(a) + z.T @ z


def _predict(
    phi: Array, theta: Array, mean: Array, covariance: Array, gap: int
) -> tuple[Array, Array]:
    """State and covariance after `gap` samples that nobody saw, by squaring."""
    T, drive = _companion(-phi[1:]), theta[1:] - phi[1:]
    power, noise = np.eye(drive.size), np.zeros_like(covariance)
    square, added = T, np.outer(drive, drive)
    while gap:
        if gap & 1:
            noise = noise + power @ added @ power.T
            power = power @ square
        added = added + square @ added @ square.T
        square = square @ square
        gap >>= 1
    return power @ mean, power @ covariance @ power.T + noise


def state_covariance(ar: Array, ma: Array) -> Array:
    """Ω of the stationary state, in units of σ², ndarray (r, r).

    Parameters
    ----------
    ar, ma : ndarray (r,)
        Padded with zeros to one length.

    Raises
    ------
    numpy.linalg.LinAlgError
        Variance above what rounding can tell from that of no stationary process.
    """
    drive = ar + ma
    covariance = _accumulate(_companion(ar), drive[:, None] * drive)
    if not np.abs(covariance).max() < _UNSTEADY:
        raise np.linalg.LinAlgError("roots on the unit circle")
    return covariance


def _accumulate(T: Array, M: Array) -> Array:
    """Σ_k T^k M T'^k, by doubling the number of terms; stops where it grows without bound."""
    total, power = M, T
    for _ in range(60):
        total = total + power @ total @ power.T
        power = power @ power
        if not 1e-18 < float(np.vdot(power, power)) < 1e60:
            break
    return total


def _companion(ar: Array) -> Array:
    """T of c_{t+1} = T c_t + (ar + ma) a_t."""
    T = np.eye(ar.size, k=1)
    T[:, 0] = ar
    return T


def _padded(ar: Array, ma: Array) -> tuple[Array, Array]:
    """1 - ar B..., 1 + ma B..., both of max(p, q, 1) + 1 coefficients."""
    order = max(ar.size, ma.size, 1)
    phi, theta = np.zeros(order + 1), np.zeros(order + 1)
    phi[0] = theta[0] = 1.0
    phi[1 : ar.size + 1], theta[1 : ma.size + 1] = -ar, ma
    return phi, theta


def _root(covariance: Array) -> Array:
    """L with L L' = covariance, which may be singular."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=float)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


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


def residuals(data: Data, ar: Array, ma: Array, coefficients: Array) -> Array:
    """Innovations of all runs in a row, ndarray (size,) [unit].

    The state before each run is the most likely one, given the run.
    """
    steps = _steps(data, ar, ma)
    return np.concatenate([without(step.innovations, coefficients) for step in steps])


def without(columns: Array, coefficients: Array) -> Array:
    """First of `columns` less the others times their coefficients, ndarray (n,)."""
    x = columns[0].copy()
    for coefficient, column in zip(coefficients, columns[1:], strict=True):
        x -= coefficient * column
    return x


def slope(data: Data, ar: Array, ma: Array) -> Slope:
    """Exact gradient of the deviance in (ar, ma), and the Gauss-Newton curvature.

    With c at its best, ∂S = 2 a'∂a|_c - w'∂Ω w, w = H'a; the innovations' sensitivities are one
    filter each, -x_{t-i}/θ(B) and -a_{t-j}/θ(B).
    """
    if not ar.size + ma.size:
        return Slope(evaluate(data, ar, ma), np.empty(0), np.empty((0, 0)))
    if len(data.columns) > 1:
        return _differenced(data, ar, ma)
    phi, theta = _padded(ar, ma)
    order, p, q = phi.size - 1, ar.size, ma.size
    columns = data.columns[0]
    size = columns.shape[1]
    h = decayed_response(theta, size)
    past = Shifted(h, order, size)
    covariance = state_covariance(-phi[1:], theta[1:])
    root, G = _root(covariance), past.gram()
    A = np.eye(order) + root.T @ G @ root
    a0 = lfilter(phi, theta, columns, axis=1)
    products = _smoothed(a0, past, root, A)[1]
    at = _concentrated(products, float(np.linalg.slogdet(A)[1]), size)

    x, a = without(columns, at.coefficients), without(a0, at.coefficients)
    w = past.against(a[None])[:, 0]
    u, v = lfilter([1.0], theta, np.stack((x, a))) if q else (x, a)
    slopes = [inner(a[i:], u[: size - i]) for i in range(1, p + 1)]
    slopes += [inner(a[j:], v[: size - j]) for j in range(1, q + 1)]
    posterior = root @ np.linalg.solve(A, root.T)
    on_covariance = G - G @ posterior @ G - size / at.square * w[:, None] * w
    gradient = -2.0 * size / at.square * np.array(slopes)
    gradient += _through_covariance(phi, theta, covariance, on_covariance)[_kept(p, q, order)]
    if q:
        gradient[p:] += _through_responses(theta, past, posterior)[:q]
    curvature = 2.0 * size / at.square * lagged_gram(u, v, p, q)
    return Slope(at, gradient, curvature)


def _kept(p: int, q: int, order: int) -> NDArray[np.intp]:
    """Places of (ar, ma) among both padded to `order`."""
    return np.concatenate((np.arange(p), order + np.arange(q)))


def _through_covariance(phi: Array, theta: Array, covariance: Array, weight: Array) -> Array:
    """Σ weight_ij ∂Ω_ij in (ar, ma), ndarray (2 r,).

    ∂Ω = T ∂Ω T' + M with an M of rank two for each coefficient; the adjoint of that equation is
    solved once for all of them.
    """
    T, drive = _companion(-phi[1:]), theta[1:] - phi[1:]
    Z = _accumulate(T.T, 0.5 * (weight + weight.T))
    return 2.0 * np.concatenate((Z @ (T @ covariance[:, 0] + drive), Z @ drive))


def _through_responses(theta: Array, past: Shifted, weight: Array) -> Array:
    """Σ weight_ij ∂G_ij in ma, ndarray (r,), for a symmetric `weight`; ∂h/∂ma_j = -B^j h/θ."""
    r = past.order
    C = weight @ past.products(np.asarray(lfilter([1.0], theta, past.h)), 2 * r)
    # Sums along the diagonals 1 to r: rows one longer than those of C put each into a column.
    skewed = np.concatenate((C.ravel(), np.zeros(r))).reshape(r, 2 * r + 1)
    return np.asarray(-2.0 * skewed.sum(axis=0)[1 : r + 1])


def _differenced(data: Data, ar: Array, ma: Array) -> Slope:
    """`slope` by differences of the whole likelihood: for records with holes."""
    at = evaluate(data, ar, ma)
    point = np.concatenate((ar, ma))
    gradient = np.empty(point.size)
    for k in range(point.size):
        moved = point.copy()
        moved[k] += _STEP
        gradient[k] = (
            evaluate(data, moved[: ar.size], moved[ar.size :]).deviance - at.deviance
        ) / (_STEP)
    curvature = 2.0 * at.size * expected_gram(ar, ma)
    return Slope(at, gradient, curvature)


def expected_gram(ar: Array, ma: Array) -> Array:
    """Information of one sample on (ar, ma), ndarray (p + q, p + q).

    Covariances of a/φ(B) and a/θ(B) at unit variance (Box, Jenkins, Time Series Analysis, 7.2).
    """
    u = decayed_response(np.concatenate(([1.0], -ar)), 100_000)
    v = decayed_response(np.concatenate(([1.0], ma)), 100_000)
    size = max(u.size, v.size) + ar.size + ma.size
    return lagged_gram(
        np.pad(u, (0, size - u.size)), np.pad(v, (0, size - v.size)), ar.size, ma.size
    )
