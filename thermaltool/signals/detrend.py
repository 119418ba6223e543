"""Separation of the slow signal (the machine warming up) from the noise.

Local cubic polynomials with a stated cutoff; what no smooth signal explains (a step, a spike) is
marked, so that it leaks into no figure of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.special import ndtri

from thermaltool.signals.robust import MAD_TO_SIGMA, robust_std

Array = NDArray[np.float64]

DEGREE = 3  # of the local polynomials
MEDIAN_SPREAD = 1.1  # of white noise about its running median of 7: sqrt(1 + 0.46²)
FALSE_ALARMS = 0.01  # chance of an outlier anywhere in a Gaussian record
# Of a block's residual to what its noise explains: above it the block has a step.
MAX_VARIANCE_RATIO = 3.0


@dataclass(frozen=True)
class Separation:
    """Slow signal and what is left of each reading.

    Attributes
    ----------
    slow, residual : ndarray (n,)
        Readings = slow + residual [unit]; residual is NaN where the slow signal is not smooth.
    cutoff : float
        Frequency at which the slow part has lost half its power, per sample (cycles / sample).
    """

    slow: Array
    residual: Array
    cutoff: float


def difference_sigma(values: ArrayLike) -> float:
    """White level from the median absolute second difference: blind to ramps, steps and spikes.

    Second differences of white noise have the variance 6 σ². Returns 0 for quantized readings that
    change on fewer than half of the samples.
    """
    second = np.diff(np.asarray(values, dtype=float), 2)
    second = second[np.isfinite(second)]
    return robust_std(second) / float(np.sqrt(6.0)) if second.size else 0.0


def find_outliers(values: ArrayLike, sigma: float) -> NDArray[np.bool_]:
    """Readings that stand alone: beyond the running median of 7 by more than chance allows.

    A step or a ramp passes, since the median follows it. The threshold holds the chance of a false
    alarm anywhere in a Gaussian record of this length to `FALSE_ALARMS`.

    Parameters
    ----------
    values : array_like (n,)
        Readings without NaN [unit].
    sigma : float
        Noise level of one reading [unit].

    Returns
    -------
    ndarray (n,) of bool
    """
    v = np.asarray(values, dtype=float)
    if v.size < 7:
        return np.zeros(v.size, dtype=bool)
    deviation = np.abs(v - median_filter(v, size=7, mode="nearest"))
    # Where the signal itself is restless, or the noise larger, the neighbourhood sets the scale.
    local = MAD_TO_SIGMA * median_filter(deviation, size=min(101, v.size), mode="nearest")
    threshold = -ndtri(FALSE_ALARMS / (2.0 * v.size)) * np.maximum(MEDIAN_SPREAD * sigma, local)
    return deviation > threshold


def cutoff_per_sample(window: int) -> float:
    """−3 dB frequency of the local cubic over `window` samples [cycles / sample].

    From the filter's own response, the sum of h_k cos(2πfk) over its weights h.
    """
    half = window // 2
    k = np.arange(-half, half + 1)
    weights = _cubic_fit(window)[1][0]
    frequency = np.linspace(0.0, 2.0 / half, 2001)
    response = np.cos(2.0 * np.pi * frequency[:, None] * k) @ weights
    return float(frequency[np.argmax(response < np.sqrt(0.5))])


def separate(values: ArrayLike, window: int) -> Separation:
    """Split evenly sampled readings into a local cubic (Savitzky-Golay) and the residual.

    Parameters
    ----------
    values : array_like (n,)
        Readings without NaN and outliers [unit]; n ≥ window.
    window : int
        Odd number of samples of the local polynomial, 5 at least.

    Raises
    ------
    ValueError
        Record shorter than the window, or no such window.
    """
    if window < DEGREE + 2 or window % 2 == 0:
        raise ValueError(f"a cubic needs an odd window of 5 samples at least, not {window}")
    v = np.asarray(values, dtype=float)
    if v.size < window:
        raise ValueError(f"record of {v.size} samples is shorter than the window of {window}")
    slow = v[0] + _local_cubic(v - v[0], window)
    residual = v - slow
    starts = np.arange(0, v.size - window + 1, window)
    time = np.arange(v.size, dtype=float)
    for start in starts[~smooth_blocks(time, v, starts, window)]:
        residual[max(start - window, 0) : start + 2 * window] = np.nan
    return Separation(slow, residual, cutoff_per_sample(window))


def _local_cubic(values: Array, window: int) -> Array:
    """The cubic of the window about each reading, at the ends of the first and the last window.

    Own, because the import of `scipy.signal` is a third of what `noise` takes for a log.
    """
    half, (powers, fit) = window // 2, _cubic_fit(window)
    middle = np.convolve(values, fit[0][::-1], mode="valid")
    first, last = powers @ (fit @ values[:window]), powers @ (fit @ values[-window:])
    return np.concatenate([first[:half], middle, last[-half:]])


def _cubic_fit(window: int) -> tuple[Array, Array]:
    """Powers of the place in a window, shape (window, 4), and what fits them to its readings."""
    half = window // 2
    powers = (np.arange(-half, half + 1) / half)[:, None] ** np.arange(DEGREE + 1.0)
    return powers, np.asarray(np.linalg.pinv(powers))


def block_variance(time: Array, values: Array, starts: NDArray[np.int64], size: int) -> Array:
    """Variance about a cubic in each block of `size` samples, ndarray (len(starts),) [unit²]."""
    index = starts[:, None] + np.arange(size)
    t, v = time[index], values[index]
    t = 2.0 * (t - t[:, :1]) / (t[:, -1:] - t[:, :1]) - 1.0
    basis, _ = np.linalg.qr(t[..., None] ** np.arange(DEGREE + 1))
    v = v - v.mean(axis=1, keepdims=True)
    fit = np.einsum("bij,bj->bi", basis, np.einsum("bij,bi->bj", basis, v))
    return np.sum((v - fit) ** 2, axis=1) / (size - DEGREE - 1)


def smooth_blocks(
    time: Array, values: Array, starts: NDArray[np.int64], size: int
) -> NDArray[np.bool_]:
    """Blocks in which a cubic explains the signal: no step, no kink, no burst of outliers.

    Judged against the block's own second differences, so that a noisier block is not lost, and
    against the other blocks, so that drift inside all of them is no reason.
    """
    if starts.size == 0:
        return np.zeros(0, dtype=bool)
    variance = block_variance(time, values, starts, size)
    second = np.abs(np.diff(values[starts[:, None] + np.arange(size)], 2, axis=1))
    rough = (MAD_TO_SIGMA * np.median(second, axis=1)) ** 2 / 6.0
    # A quantized block without a majority of changes has no scale of its own: take the common one.
    rough = np.maximum(rough, max(0.5 * float(np.median(variance)), 1e-3 * float(variance.mean())))
    if not rough.any():
        return np.ones(starts.size, dtype=bool)
    ratio = variance / rough
    return ratio <= MAX_VARIANCE_RATIO * max(float(np.median(ratio)), 1.0)


def longest_level_stretch(values: Array, band: float, size: int) -> slice:
    """Longest run of readings whose block medians stay within `band` of each other.

    A tenth is cut off where the run ends beside a signal, whose first rise fits the band too.

    Parameters
    ----------
    values : ndarray (n,)
        Readings without NaN [unit].
    band : float
        Allowed range of the block medians [unit].
    size : int
        Samples per block.
    """
    blocks = values.size // size
    if blocks < 2:
        return slice(0, values.size)
    medians = np.median(values[: blocks * size].reshape(blocks, size), axis=1)
    best, first = (0, 0), 0
    low, high = [0], [0]  # indices of rising minima and falling maxima from `first` on
    for last in range(blocks):
        while low and medians[low[-1]] >= medians[last]:
            low.pop()
        while high and medians[high[-1]] <= medians[last]:
            high.pop()
        low.append(last)
        high.append(last)
        while medians[high[0]] - medians[low[0]] > band:
            first += 1
            low = low[1:] if low[0] < first else low
            high = high[1:] if high[0] < first else high
        if last + 1 - first > best[1] - best[0]:
            best = (first, last + 1)
    margin = -(-(best[1] - best[0]) // 10) * size
    start = best[0] * size + margin if best[0] > 0 else 0
    return slice(start, best[1] * size - margin if best[1] < blocks else values.size)
