"""Narrow peaks and notches that are left in the innovations: start values for larger models.

A pair of nearly cancelling roots, one AR and one MA at the same angle, describes a narrow peak (AR
root nearer to the circle) or notch. No regression on lags finds it, since at equal radii the pair
has no effect and its angle is undefined; a maximum of the likelihood stands at each line of the
spectrum. Here the gain of every angle is computed at once: the filter (1 - αB)/(1 - βB) turned to
the angle ω changes the power of the innovations to Σ c_k r_k cos kω, with r their autocovariances
and c those of its weights (Whittle's likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Distances from the circle of the wider root, and of the narrower as a share of it. Still narrower
# lines would gain in long records, but each likelihood would have to follow them to their end.
_WIDTHS = (0.4, 0.15, 0.07, 0.04, 0.02)
_SHARES = (0.25, 0.3, 0.4, 0.25, 0.25)
_RESOLVED = 40.0  # samples times width above which a narrower line can be told
_NARROWEST = 0.004
_REACH = 8.0  # time constants after which a filter's weights count as zero
_EACH = 3  # peaks of the gain that are looked at for each width
_APART = 0.05  # angles nearer than this to each other, 0 or π count as one [rad]


@dataclass(frozen=True)
class Narrow:
    """A factor (1 - ar B...)/(1 + ma B...) and what it gains.

    Attributes
    ----------
    ar, ma : ndarray (1,) or (2,)
        Of a real root at the ends of the spectrum, else of a pair.
    gain : float
        Fall of the deviance before anything else is adjusted.
    """

    ar: Array
    ma: Array
    gain: float


def narrow_factors(innovations: Array) -> list[Narrow]:
    """Factors that promise to lower the deviance, best first, at most one for each angle.

    Parameters
    ----------
    innovations : ndarray (n,)
        Of the model that is to be enlarged [unit].
    """
    found: list[tuple[float, float, float, float]] = []
    widths = [*zip(_WIDTHS, _SHARES, strict=True)]
    while innovations.size * widths[-1][0] > _RESOLVED and widths[-1][0] > _NARROWEST:
        widths.append((0.4 * widths[-1][0], 0.25))
    longest = int(_REACH / (widths[-1][0] * widths[-1][1])) + 1
    covariance = _autocovariance(innovations, min(longest, innovations.size))
    for width, share in widths:
        wide, close = 1.0 - width, 1.0 - share * width
        for pole, zero in ((wide, close), (close, wide)):
            found += _peaks(covariance, innovations.size, pole, zero)
    found.sort(reverse=True)
    kept: list[tuple[float, float, float, float]] = []
    for each in found:
        if each[0] > 0.0 and all(abs(each[1] - other[1]) > _APART for other in kept):
            kept.append(each)
    return [
        Narrow(-_factor(angle, zero)[1:], _factor(angle, pole)[1:], gain)
        for gain, angle, zero, pole in kept
    ]


def _autocovariance(e: Array, lags: int) -> Array:
    size = 1 << int(np.ceil(np.log2(e.size + lags)))
    power = np.abs(np.fft.rfft(e, size)) ** 2
    return np.asarray(np.fft.irfft(power)[:lags] / e.size)


def _peaks(
    covariance: Array, size: int, pole: float, zero: float
) -> list[tuple[float, float, float, float]]:
    """(gain, angle, zero, pole) at the largest gains of (1 - zero B)/(1 - pole B)."""
    lags = min(int(_REACH / (1.0 - pole)) + 1, covariance.size)
    step = pole - zero
    c = np.empty(lags)
    c[0] = 1.0 + step**2 / (1.0 - pole**2)
    c[1:] = 2.0 * step * (1.0 + step * pole / (1.0 - pole**2)) * pole ** np.arange(lags - 1)
    length = 4 << int(np.ceil(np.log2(lags)))
    power = np.fft.rfft(c * covariance[:lags], length).real / covariance[0]
    change = 2.0 * (power - 1.0)  # a pair counts twice, a root at the ends once
    change[[0, -1]] *= 0.5
    gain = -size * np.log1p(np.maximum(change, -0.9))
    angle = np.linspace(0.0, np.pi, gain.size)
    inner = gain[1:-1]
    peaks = 1 + np.flatnonzero((inner > gain[:-2]) & (inner >= gain[2:]))
    peaks = peaks[(angle[peaks] > _APART) & (angle[peaks] < np.pi - _APART)]
    peaks = peaks[np.argsort(-gain[peaks])[:_EACH]]
    places = [0, *peaks.tolist(), gain.size - 1]
    return [(float(gain[i]), float(angle[i]), zero, pole) for i in places]


def _factor(angle: float, radius: float) -> Array:
    """1 - radius B at the ends, else the pair at ± angle."""
    if min(angle, np.pi - angle) < 1e-9:
        return np.array([1.0, -radius * np.cos(angle)])
    return np.array([1.0, -2.0 * radius * np.cos(angle), radius**2])
