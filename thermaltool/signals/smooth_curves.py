"""Smooth curves that noisy readings may come from: draws, where smoothness is learnt from them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

Array = NDArray[np.float64]

# Scales of time, as parts of the whole: a curve is as smooth in log(1 + t/scale), which is how heat
# spreads after a change at the start, or (none) in t itself.
SCALES = (None, 5.0, 25.0, 125.0)
# By how much slopes vary, in deviations of the values: half decades.
ROUGHNESS = 10.0 ** np.arange(-3.0, 3.1, 0.5)
# Above, rounding is no longer small beside the least weight of a reading.
MAX_CONDITION = 1e12
# Noise that is taken for none, beside the range of the values.
LEAST_NOISE = 1e-6
# Curves whose posterior share is below are not drawn.
LEAST_SHARE = 1e-4


def curve_draws(
    time: Array,
    values: Array,
    counts: Array,
    white: float,
    drifts: Sequence[tuple[float, float]],
    draws: int,
    rng: np.random.Generator,
) -> Array:
    """Curves from the posterior of a smooth signal under white noise and drifts, shape (draws, n).

    The slope of the signal is a random walk in a stretched time (a smoothing spline: Wahba 1990,
    chapter 1). How rough it is and how time is stretched are drawn with the probability that the
    values give to them, the first value and the slope being free.

    Parameters
    ----------
    time : ndarray, shape (n,) [s], n >= 3, increasing
    values : ndarray, shape (n,)
    counts : ndarray, shape (n,)
        Readings behind each value; 0 where there are none.
    white : float
        Standard deviation of a reading.
    drifts : sequence of (float, float [s])
        Ornstein-Uhlenbeck processes on top of the signal: standard deviation and time constant.
    draws : int
    rng : Generator
    """
    spread = float(np.ptp(values))
    if len(time) < 3 or spread == 0:
        return np.tile(values, (draws, 1))
    weights = counts / max(white, LEAST_NOISE * spread) ** 2
    drifts = [each for each in drifts if each[0] > 0 and 0 < each[1] < np.inf]
    found = []
    for part, rough in itertools.product(SCALES, ROUGHNESS * float(np.std(values))):
        elapsed = time - time[0]
        clock = elapsed / elapsed[-1] if part is None else np.log1p(part * elapsed / elapsed[-1])
        try:
            found.append(_posterior(clock, elapsed, values, weights, drifts, rough))
        except LinAlgError:
            continue
    if not found:  # no curve that the readings tell from a line
        line = np.polynomial.Polynomial.fit(time, values, 1, w=np.sqrt(counts))(time)
        return np.tile(line, (draws, 1))
    shares = np.exp(np.array([each[0] for each in found]) - max(each[0] for each in found))
    shares[shares < LEAST_SHARE * shares.sum()] = 0.0
    curves = []
    for often, (_, factor, mean) in zip(
        rng.multinomial(draws, shares / shares.sum()), found, strict=True
    ):
        if often:
            pushes = rng.standard_normal((factor.shape[1], often))
            departures, _ = dtbtrs(factor, pushes, uplo="L", trans="T")
            curves.append((mean[:, None] + departures)[:: 1 + len(drifts)].T)
    return np.concatenate(curves)


def _posterior(
    clock: Array,
    time: Array,
    values: Array,
    weights: Array,
    drifts: Sequence[tuple[float, float]],
    rough: float,
) -> tuple[float, Array, Array]:
    """Log likelihood, Cholesky factor of the precision and mean of (signal, drifts) by turns."""
    n, each = len(values), 1 + len(drifts)
    precision = np.zeros((2 * each + 1, n * each))
    # Changes of slope, f[k] before + f[k+1] middle + f[k+2] after, and their variance.
    steps = np.diff(clock)
    before, after = 1 / steps[:-1], 1 / steps[1:]
    change = before, -(before + after), after
    variance = rough**2 * (steps[:-1] + steps[1:]) / 2
    for low, high in itertools.combinations_with_replacement(range(3), 2):
        columns = slice(low * each, (n - 2 + low) * each, each)
        precision[(high - low) * each, columns] += change[low] * change[high] / variance
    if precision[0].max() > MAX_CONDITION * weights.max():
        raise LinAlgError("a curve too smooth for this clock")
    # Value and slope are free (restricted likelihood): their volume does not depend on the clock.
    free = n * float(np.sum((clock - clock.mean()) ** 2)) / steps[0] ** 2
    volume = 2 * np.log(after).sum() - np.log(variance).sum() + math.log(free)
    for k, (sigma, constant) in enumerate(drifts, start=1):
        keeps = np.exp(-np.diff(time) / constant)
        pushes = -(sigma**2) * np.expm1(-2 * np.diff(time) / constant)
        precision[0, k] += 1 / sigma**2
        precision[0, each + k :: each] += 1 / pushes
        precision[0, k : (n - 1) * each : each] += keeps**2 / pushes
        precision[each, k : (n - 1) * each : each] -= keeps / pushes
        volume -= 2 * math.log(sigma) + np.log(pushes).sum()
    # A reading is the sum of all.
    for low, high in itertools.combinations_with_replacement(range(each), 2):
        precision[high - low, low::each] += weights
    factor = cholesky_banded(precision, lower=True)
    # About a line, to which the signal is indifferent: less to round.
    line = np.polynomial.Polynomial.fit(clock, values, 1, w=np.sqrt(weights))(clock)
    rest = values - line
    right = np.repeat(weights * rest, each)
    mean = cho_solve_banded((factor, True), right)
    fit = float(right @ mean) - float(weights @ rest**2)
    mean[::each] += line
    return (volume + fit) / 2 - float(np.log(factor[0]).sum()), factor, mean
