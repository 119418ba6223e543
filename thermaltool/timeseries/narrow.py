"""Narrow lines that are left in the innovations: start values for larger models.

A pair of nearly cancelling roots, one AR and one MA at nearly the same angle, describes a narrow
peak or notch of the spectrum. No regression on lags finds it, and a maximum of the likelihood
stands at each of many lines. Here the gain of all angles is computed at once, exact but for how
the two roots of a pair act on each other. With the MA
root β = r exp(iω) given, whitening e by the pair's factor (1 - αB)/(1 - βB) is linear in what is
left free:

    a_t = e_t + 2 Re(c s_t - g β^t),   s_t = Σ_{k≥1} β^{k-1} e_{t-k},   c = β - α,

g the state before the first sample, of variance V = |c|²/(1 - |α|²). Its log determinant is
2 log(1 + V Σ r^{2t}). The sums of products of e, s and β^t are Fourier transforms of e and of its
autocovariances, so that every angle has its best AR root for O(n log n). At the ends of the
spectrum the root is real and counts once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from thermaltool.timeseries.polynomials import root_factor

Array = NDArray[np.float64]

# Distances of the MA root from the circle that are tried: the narrowest [1/samples], the ratio to
# the next, the widest. A record cannot show a narrower line than the first.
MIN_WIDTH_SAMPLES, WIDTH_RATIO, MAX_WIDTH = 0.25, 4.0, 0.5
# Still narrower lines would gain in long records, but each likelihood would have to follow them.
MIN_WIDTH = 1e-4
REACH_TIME_CONSTANTS = 8.0  # after which the weights of a root are below 4e-4 and count as zero
ANGLES_PER_RESOLVED = 4  # a peak of the gain is between angles by an eighth of its width at most
MAX_PEAKS_PER_WIDTH = 8  # the largest gains; smaller ones are found again in a larger model
MIN_DISTANCE_WIDTHS = 8.0  # [widths, or 1/n] below which two lines are one
MIN_GAIN = 2.0  # [deviance] below which a line does not pay for one coefficient by AIC


@dataclass(frozen=True)
class NarrowLine:
    """A factor (1 - ar B...)/(1 + ma B...) and what it gains.

    Attributes
    ----------
    gain : float
        Fall of the deviance before anything else is adjusted.
    angle : float
        [rad]
    width : float
        Distance of the MA root from the unit circle.
    ar_root, ma_root : complex
        Real at the ends of the spectrum, else one of a pair.
    """

    gain: float
    angle: float
    width: float
    ar_root: complex
    ma_root: complex

    @property
    def ar(self) -> Array:
        """Its AR coefficients, ndarray (1,) or (2,)."""
        return -root_factor(self.ar_root)[1:]

    @property
    def ma(self) -> Array:
        """Its MA coefficients, ndarray (1,) or (2,)."""
        return root_factor(self.ma_root)[1:]


def narrow_factors(innovations: Array) -> list[NarrowLine]:
    """Factors that promise to lower the deviance, best first, at most one for each line.

    Parameters
    ----------
    innovations : ndarray (n,)
        Of the model that is to be enlarged [unit].
    """
    n = innovations.size
    width, found = max(MIN_WIDTH_SAMPLES / n, MIN_WIDTH), []
    spectrum = _Sums(innovations, min(int(REACH_TIME_CONSTANTS / width) + 1, n))
    while width < MAX_WIDTH:
        found += _lines(spectrum, width)
        width *= WIDTH_RATIO
    found.sort(key=lambda line: -line.gain)
    kept: list[NarrowLine] = []
    for line in found:
        if all(not _same(line, other, n) for other in kept):
            kept.append(line)
    return kept


def _same(one: NarrowLine, other: NarrowLine, n: int) -> bool:
    width = max(min(one.width, other.width), 1.0 / n)
    return abs(one.angle - other.angle) < MIN_DISTANCE_WIDTHS * width


class _Sums:
    """Innovations and the transforms that all widths share."""

    def __init__(self, e: Array, lags: int) -> None:
        self.e, self.lags, self.length = e, lags, next_fast_len(e.size + lags, real=True)
        self.transform = rfft(e, self.length)
        self.covariance = self.against(self.transform)

    def against(self, transform: NDArray[np.complex128]) -> Array:
        """Σ_t y_t e_{t-k}, ndarray (lags,), for the transform of y."""
        return np.asarray(irfft(transform * self.transform.conj(), self.length)[: self.lags])

    def weighted(self, weights: Array, width: float) -> Array:
        """Σ_t W_t e_t e_{t-k}, ndarray (lags,); W is 1/(2 width) but near the end."""
        if width * self.e.size > REACH_TIME_CONSTANTS**2:
            return weights[0] * self.covariance
        return self.against(rfft(weights * self.e, self.length))


def _lines(sums: _Sums, width: float) -> list[NarrowLine]:
    """The largest gains over the angles for MA roots at `width` from the circle."""
    e, n = sums.e, sums.e.size
    r, lags = 1.0 - width, min(int(REACH_TIME_CONSTANTS / width) + 1, sums.lags)
    # Even: the last angle is π.
    length = 2 * next_fast_len(ANGLES_PER_RESOLVED * lags // 2, real=True)
    decay = r ** np.arange(lags)
    span = 1.0 - r * r
    weights = -np.expm1(2.0 * np.log(r) * (n - 1.0 - np.arange(n))) / span  # Σ r^2k to the end
    angle = 2.0 * np.pi * np.arange(length // 2 + 1) / length
    root = r * np.exp(1j * angle)
    root.imag[-1] = 0.0  # as exactly real as the first, and as the transforms there
    # <s, e>, <s, s>, <β^t, e>, <β^t, s>, <β^t, β^t>.
    se = rfft(sums.covariance[1:lags] * decay[:-1], length)
    halved = sums.weighted(weights, width)[:lags] * decay
    halved[0] *= 0.5
    ss = 2.0 * rfft(halved, length).real
    he = rfft(decay * e[:lags], length)
    hs = root.conj() * rfft(decay * (weights * e)[:lags], length)
    hh = -np.expm1(2.0 * n * np.log(r)) / span
    step = -(se - hs.conj() * he / hh) / (ss - np.abs(hs) ** 2 / hh)
    ar_root = root - step
    ar_root *= np.minimum(1.0, (1.0 - MIN_WIDTH_SAMPLES / n) / np.abs(ar_root))
    step = root - ar_root
    power = np.abs(step) ** 2
    variance = power / (1.0 - np.abs(ar_root) ** 2)
    square = 2.0 * (step.conj() * se).real + power * ss
    square -= np.abs(he + step * hs) ** 2 * variance / (1.0 + variance * hh)
    count = np.full(angle.size, 2.0)
    count[[0, -1]] = 1.0  # a pair counts twice, a root at the ends once
    left = np.maximum(1.0 + count * square / sums.covariance[0], 1e-3)
    gain = -n * np.log(left) - count * np.log1p(variance * hh)
    return [
        NarrowLine(float(gain[i]), float(angle[i]), width, complex(ar_root[i]), complex(root[i]))
        for i in _peaks(gain, angle, MIN_DISTANCE_WIDTHS * max(width, 1.0 / n))
    ]


def _peaks(gain: Array, angle: Array, margin: float) -> list[int]:
    """Places of the largest gains: both ends, and maxima not nearer to them than `margin`."""
    inner = gain[1:-1]
    peaks = 1 + np.flatnonzero((inner > gain[:-2]) & (inner >= gain[2:]))
    peaks = peaks[(angle[peaks] > margin) & (angle[peaks] < np.pi - margin)]
    peaks = peaks[np.argsort(-gain[peaks])[:MAX_PEAKS_PER_WIDTH]]
    return [i for i in (0, *peaks.tolist(), gain.size - 1) if gain[i] > MIN_GAIN]


def with_line(ar: Array, ma: Array, line: NarrowLine) -> tuple[Array, Array]:
    """`ar` and `ma` of a model times a narrow line."""
    larger = -np.convolve(np.concatenate(([1.0], -ar)), root_factor(line.ar_root))[1:]
    return larger, np.convolve(np.concatenate(([1.0], ma)), root_factor(line.ma_root))[1:]
