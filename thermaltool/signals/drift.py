"""White noise plus slow drift by maximum likelihood, at any sampling.

The readings are y_i = μ(t_i) + x(t_i) + w_i: w white of standard deviation σ_w per sample, x a
stationary Ornstein-Uhlenbeck process of standard deviation σ_d and time constant τ, and μ a
polynomial in each block (a constant where there is no signal).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from thermaltool.signals.likelihood import RestrictedLikelihood, least_on_grid

Array = NDArray[np.float64]

# Bounds of q = rate² · period / σ_w², the walk in a sample against the white noise.
WALK_BOUNDS = (1e-8, 1e4)
STENCIL_STEP = 0.05  # of the numerical curvature [log parameter], far below standard errors
MAX_SEARCH_SAMPLES = 3000  # that find the neighbourhood of the optimum, which all then refine
# Upper end of the white interval, over the estimate, from which it is no estimate.
MAX_WHITE_RATIO = 2.0
MAX_LOG_TIME_ERROR = 1.0  # standard error of log τ from which the record does not bound it
DETECTION_P_VALUE = 0.01  # chance to call white noise drifting


@dataclass(frozen=True)
class DriftFit:
    """White noise and Ornstein-Uhlenbeck drift of a record.

    Attributes
    ----------
    white_sigma, sigma : float
        Standard deviation of the white part per sample and of the drift [unit].
    time_constant : float or None
        Of the drift [s]; None where no drift was detected.
    rate : float
        √(2/τ) σ_d, the random walk that the drift is at times well below τ [unit/√s].
    white_interval, sigma_interval, time_constant_interval, rate_interval : tuple or None
        Two-sided confidence intervals; None where the record does not bound the figure.
    white_resolved : bool
        False where drift explains even the shortest changes: `white_sigma` is then an upper limit.
    at_bound : bool
        The time constant is longer than the record tells: only the rate is supported.
    """

    white_sigma: float
    white_interval: tuple[float, float]
    white_resolved: bool
    sigma: float
    sigma_interval: tuple[float, float] | None
    time_constant: float | None
    time_constant_interval: tuple[float, float] | None
    rate: float
    rate_interval: tuple[float, float] | None
    at_bound: bool


def fit_drift(
    time: Array,
    values: Array,
    starts: NDArray[np.int64],
    degree: int = 0,
    confidence: float = 0.95,
) -> DriftFit:
    """Maximum-likelihood white noise and Ornstein-Uhlenbeck drift.

    Intervals come from the curvature of the likelihood in logarithms of the parameters.

    Parameters
    ----------
    time, values, starts, degree
        As in `RestrictedLikelihood`.
    confidence : float
        Probability that an interval covers its figure.

    Raises
    ------
    ValueError
        Fewer than 10 samples beyond the polynomials' coefficients, or no scatter at all.
    """
    full = RestrictedLikelihood(time, values, starts, degree)
    white_log = full.negative_log(0.0, 1.0)
    if full.dof < 10 or full.terms(0.0, 1.0)[1] <= 0.0:
        raise ValueError("too few samples, or none that scatter")
    z = float(-ndtri((1.0 - confidence) / 2.0))
    bounds = np.log([WALK_BOUNDS, (2.0 * full.period, 10.0 * full.span)])
    search = (
        _condense(time, values, starts, degree) if values.size > 2 * MAX_SEARCH_SAMPLES else full
    )
    point = _search(search, bounds)
    point, curvature, gradient = _refine(full, point, bounds)
    walk, tau = (float(p) for p in np.exp(point))
    if 2.0 * (white_log - full.negative_log(walk, tau)) < chdtri(2, DETECTION_P_VALUE):
        return _white_only(full, z)
    square = full.terms(walk, tau)[1]
    white = float(np.sqrt(square / full.dof))
    # Curvature in (log σ_w, log q, log τ); parameters at a bound are not free.
    hessian = np.empty((3, 3))
    hessian[0, 0] = 2.0 * full.dof
    hessian[0, 1:] = hessian[1:, 0] = -gradient / white**2
    hessian[1:, 1:] = curvature
    free = np.append(True, (point > bounds[:, 0] + 0.1) & (point < bounds[:, 1] - 0.1))
    covariance = _covariance(hessian, free)
    if covariance[2, 2] > MAX_LOG_TIME_ERROR**2 or not np.all(np.diag(covariance) >= 0.0):
        free[2] = False  # the likelihood hardly tells the time constant
        covariance = _covariance(hessian, free)
    if not np.all(np.diag(covariance) >= 0.0):
        free[1] = False  # nor the share of white noise: the record is one walk
        covariance = _covariance(hessian, free)

    def interval(value: float, *slope: float) -> tuple[float, float]:
        spread = np.exp(z * np.sqrt(max(float(np.dot(slope, covariance @ slope)), 0.0)))
        return value / float(spread), value * float(spread)

    rate = white * float(np.sqrt(walk / full.period))
    sigma = rate * float(np.sqrt(tau / 2.0))
    at_bound = not free[2] and tau > 3.0 * full.period
    rate_interval = interval(rate, 1.0, 0.5, 0.0)
    white_interval = interval(white, 1.0, 0.0, 0.0)
    white_resolved = bool(free[1]) and white_interval[1] < MAX_WHITE_RATIO * white
    if not white_resolved:
        white = _white_limit(full, point, bounds, z)
        white_interval = (0.0, white)
    return DriftFit(
        white_sigma=white,
        white_interval=white_interval,
        white_resolved=white_resolved,
        sigma=sigma,
        sigma_interval=None if at_bound else interval(sigma, 1.0, 0.5, 0.5),
        time_constant=float(tau),
        time_constant_interval=None if at_bound else interval(float(tau), 0.0, 0.0, 1.0),
        rate=rate,
        rate_interval=rate_interval,
        at_bound=at_bound,
    )


def _search(likelihood: RestrictedLikelihood, bounds: Array) -> Array:
    """Global search for the optimum: a coarse grid, then the simplex method."""
    walks = np.linspace(np.log(1e-6), np.log(1e2), 9)
    taus = np.linspace(bounds[1, 0], bounds[1, 1] - np.log(10.0), 8)

    def negative_log(log_walk: float, log_tau: float) -> float:
        return likelihood.negative_log(float(np.exp(log_walk)), float(np.exp(log_tau)))

    grid = [(float(q), float(t)) for q in walks for t in taus]
    return least_on_grid(negative_log, grid, bounds, (1.0, 0.8), 1e-3, 150)[0]


def _refine(
    likelihood: RestrictedLikelihood, point: Array, bounds: Array
) -> tuple[Array, Array, Array]:
    """Newton's method on a nine-point stencil; also the curvature that the intervals need.

    Returns
    -------
    point : ndarray (2,)
        (log q, log τ) of the optimum.
    curvature : ndarray (2, 2)
        Of the negative log likelihood at fixed σ_w.
    gradient : ndarray (2,)
        Of the sum of squares.
    """
    offsets = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    for _ in range(8):
        terms = [likelihood.terms(*np.exp(point + STENCIL_STEP * o)) for o in offsets]
        logdet, square = np.array(terms).T.reshape(2, 3, 3)
        profile = 0.5 * (likelihood.dof * np.log(np.maximum(square, 1e-300)) + logdet)
        slope, bend = _derivatives(profile)
        move = np.zeros(2)
        free = ~(
            ((point <= bounds[:, 0] + 1e-9) & (slope > 0))
            | ((point >= bounds[:, 1] - 1e-9) & (slope < 0))
        )
        sub = bend[np.ix_(free, free)]
        if free.any():
            # Where the likelihood is not convex, the steepest way down is taken instead.
            convex = np.linalg.eigvalsh(sub)[0] > 0
            step = np.linalg.solve(sub, slope[free]) if convex else slope[free]
            move[free] = -step / max(1.0, float(np.abs(step).max()))
        if abs(float(np.dot(slope, move))) < 0.02:  # within a fifth of a standard deviation
            point = np.clip(point + move, bounds[:, 0], bounds[:, 1])
            break
        here = likelihood.negative_log(*np.exp(point))
        for shorter in (1.0, 0.25, 0.06):
            target = np.clip(point + shorter * move, bounds[:, 0], bounds[:, 1])
            if likelihood.negative_log(*np.exp(target)) < here:
                point = target
                break
        else:
            break
    variance = square[1, 1] / likelihood.dof
    curvature = _derivatives(0.5 * (logdet + square / variance))[1]
    return point, curvature, _derivatives(square)[0]


def _derivatives(f: Array) -> tuple[Array, Array]:
    """Gradient (2,) and second derivatives (2, 2) from values on the stencil (3, 3)."""
    h = STENCIL_STEP
    slope = np.array([f[2, 1] - f[0, 1], f[1, 2] - f[1, 0]]) / (2.0 * h)
    mixed = (f[2, 2] - f[2, 0] - f[0, 2] + f[0, 0]) / (4.0 * h * h)
    first = (f[2, 1] - 2.0 * f[1, 1] + f[0, 1]) / (h * h)
    second = (f[1, 2] - 2.0 * f[1, 1] + f[1, 0]) / (h * h)
    return slope, np.array([[first, mixed], [mixed, second]])


def _covariance(hessian: Array, free: NDArray[np.bool_]) -> Array:
    """Inverse curvature of the free parameters, ndarray (3, 3); zero for the others."""
    covariance = np.zeros((3, 3))
    covariance[np.ix_(free, free)] = np.linalg.pinv(hessian[np.ix_(free, free)])
    return covariance


def _white_limit(likelihood: RestrictedLikelihood, point: Array, bounds: Array, z: float) -> float:
    """Largest white level that the likelihood still allows beside the drift [unit]."""
    limit = likelihood.negative_log(*np.exp(point)) + 0.5 * z * z
    taus = np.clip(point[1] + np.log([0.5, 0.7, 1.0, 1.4, 2.0]), *bounds[1])
    low, high = bounds[0, 0], point[0]
    for _ in range(10):
        middle = 0.5 * (low + high)
        allowed = min(likelihood.negative_log(*np.exp((middle, tau))) for tau in taus) <= limit
        low, high = (low, middle) if allowed else (middle, high)
    best = min(taus, key=lambda tau: likelihood.negative_log(*np.exp((high, tau))))
    return float(np.sqrt(likelihood.terms(*np.exp((high, best)))[1] / likelihood.dof))


def _white_only(likelihood: RestrictedLikelihood, z: float) -> DriftFit:
    """No drift detected: σ_d is 0 up to the largest one that the likelihood still allows.

    Time constants above a tenth of the record are left out: a constant would hide any such drift.
    """
    square = likelihood.terms(0.0, 1.0)[1]
    white = float(np.sqrt(square / likelihood.dof))
    spread = float(np.exp(z / np.sqrt(2.0 * likelihood.dof)))
    limit = likelihood.negative_log(0.0, 1.0) + 0.5 * z * z
    upper = 0.0
    if likelihood.span > 100.0 * likelihood.period:
        for tau in np.geomspace(10.0 * likelihood.period, likelihood.span / 10.0, 4):
            for ratio in np.geomspace(1e-5, 1.0, 16):
                walk = 2.0 * likelihood.period * ratio / tau
                if likelihood.negative_log(walk, tau) <= limit:
                    upper = max(upper, white * float(np.sqrt(ratio)))
    return DriftFit(
        white_sigma=white,
        white_interval=(white / spread, white * spread),
        white_resolved=True,
        sigma=0.0,
        sigma_interval=(0.0, upper) if upper > 0.0 else None,
        time_constant=None,
        time_constant_interval=None,
        rate=0.0,
        rate_interval=None,
        at_bound=False,
    )


def _condense(
    time: Array, values: Array, starts: NDArray[np.int64], degree: int
) -> RestrictedLikelihood:
    """A short stand-in for a long record, good enough to find the neighbourhood of the optimum.

    A run of single readings tells the white level and short time constants, means of m readings
    over the whole record tell the long ones. With many blocks, evenly chosen ones are kept.
    """
    ends = np.append(starts[1:], values.size)
    if starts.size > 1:
        keep = np.unique(np.linspace(0, starts.size - 1, MAX_SEARCH_SAMPLES // 32).astype(int))
        pieces = [slice(starts[k], ends[k]) for k in keep]
        lengths = np.array([ends[k] - starts[k] for k in keep])
        index = np.concatenate([np.arange(p.start, p.stop) for p in pieces])
        new_starts = np.concatenate(([0], np.cumsum(lengths)[:-1]))
        return RestrictedLikelihood(time[index], values[index], new_starts, degree)
    half = MAX_SEARCH_SAMPLES // 2
    m = values.size // half
    middle = slice((values.size - half) // 2, (values.size - half) // 2 + half)
    means = values[: half * m].reshape(half, m).mean(axis=1)
    mean_times = time[: half * m].reshape(half, m).mean(axis=1)
    return RestrictedLikelihood(
        np.concatenate((time[middle], mean_times)),
        np.concatenate((values[middle], means)),
        np.array([0, half]),
        degree,
        np.concatenate((np.ones(half), np.full(half, 1.0 / m))),
        float(np.median(np.diff(time))),
    )


def model_allan(factors: NDArray[np.int64], period: float, fit: DriftFit) -> Array:
    """Allan deviation that white noise plus Ornstein-Uhlenbeck drift has, exactly [unit].

    Half the mean square difference of adjacent means of m readings, from the autocovariance.
    """
    m = np.asarray(factors, dtype=float)
    variance = fit.white_sigma**2 / m
    if fit.time_constant is not None:
        x = period / fit.time_constant
        lost, total = -np.expm1(-x), -np.expm1(-m * x)  # 1 − ρ, 1 − ρ^m
        rho = np.exp(-x)
        own = m + 2.0 * rho * (m * lost - total) / lost**2
        across = rho * (total / lost) ** 2
        variance = variance + fit.sigma**2 * (own - across) / m**2
    return np.sqrt(variance)


def model_density(frequency: Array, period: float, fit: DriftFit) -> Array:
    """One-sided density of the sampled model [unit²/Hz], folded at the Nyquist frequency."""
    density = np.full_like(frequency, 2.0 * period * fit.white_sigma**2)
    if fit.time_constant is not None:
        x = period / fit.time_constant
        rho = np.exp(-x)
        gain = 4.0 * rho * np.sin(np.pi * frequency * period) ** 2 + np.expm1(-x) ** 2
        density += 2.0 * period * fit.sigma**2 * -np.expm1(-2.0 * x) / gain
    return density
