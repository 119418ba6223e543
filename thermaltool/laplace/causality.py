"""Singularities right of a line: there the inverse integral is not zero before time zero.

The integral of F(s) e^(st) along Re s = γ is zero at every t < 0 where F is analytic right of the
line and bounded there: the contour closes to the right. A singularity there leaves its residue.
So the line itself tells whether it stands far enough right, from the samples on it alone.
"""

from __future__ import annotations

import numpy as np

from thermaltool.errors import FitError
from thermaltool.laplace.sampling import RealArray, Sampler

# Half period T of the series times its distance γ from the singularities on its left: what these
# leave in the quarter period before zero is below e^(−1.5γT) = 3e-20.
DECAY = 30.0
# The nearest line that an inversion up to time t stands on, times t.
NEAREST_LINE = 5.75
# (1 + (s − γ)/b)^(−m), the transform of a causal kernel, takes jumps, impulses and delays out of
# the sum: what is cut off at SMOOTHING·b is SMOOTHING^(−m) of the whole.
SMOOTHING, SMOOTHING_ORDER = 3.0, 26
# Terms on the line nearest to the singularities, where oscillations count, and on those beyond.
NEAR_TERMS, FAR_TERMS, MAX_TERMS = 2048, 512, 2**16
# Lines beyond the nearest: each LINE_RATIO times farther, to NEAREST_LINE·REACH over the first
# time, beyond which f overflows.
LINE_RATIO, REACH = 4.0, 512.0
# What is found must exceed rounding, and the difference from a line that stands beside it.
FLOOR, BESIDE, CONSISTENT = 1e-12, 1.001, 5.0
# A bracket of the rightmost singularity, times the last time, that costs no more digits.
NARROW = 3.0


class Lines:
    """Lines Re s = γ at ever larger γ, and those with a singularity on their right.

    Attributes
    ----------
    gamma : ndarray, shape (m,)
        The lines [1/s], from the one on which an inversion at the last time stands.
    wrong : list of int
        Those with a singularity on their right.
    """

    def __init__(self, sample: Sampler, t: RealArray, tol: float) -> None:
        self._sample, self._scale = sample, tol
        count = 1 + int(np.ceil(np.log(REACH * t[-1] / t[0]) / np.log(LINE_RATIO)))
        self.gamma: RealArray = NEAREST_LINE / t[-1] * LINE_RATIO ** np.arange(count)
        self.wrong = [
            k
            for k, line in enumerate(self.gamma)
            if not self.is_right_of_all(line, line, FAR_TERMS if k else NEAR_TERMS)
        ]

    def is_right_of_all(self, line: float, clearance: float, terms: int) -> bool:
        """Whether F has no singularity right of Re s = `line` [1/s], to rounding.

        `clearance` [1/s] is the distance from the line to the singularities on its left that
        are to count as left of it. True where F is not finite on the line: nothing is known.
        """
        first = self._before_zero(line, clearance, terms)
        if first is None:
            return True
        before, size, cut_off = first
        self._scale = max(self._scale, size)
        nothing = FLOOR * self._scale + cut_off
        if abs(before).max() <= nothing:
            return True
        beside = line + (BESIDE - 1) * clearance  # rounding of F differs there
        second = self._before_zero(beside, BESIDE * clearance, terms)
        if second is None:
            return True
        common, difference = (before + second[0]) / 2, before - second[0]
        return bool(abs(common).max() <= CONSISTENT * abs(difference).max() + nothing)

    def _before_zero(
        self, line: float, clearance: float, terms: int
    ) -> tuple[RealArray, float, float] | None:
        """Smoothed f over a quarter period before zero, its size after, and what is cut off."""
        half_period = DECAY / clearance
        omega = np.pi / half_period * np.arange(terms + 1)
        values = self._sample.lenient(np.asarray(line + 1j * omega, dtype=np.complex128))
        if not np.isfinite(values).all():
            return None
        kernel = (1 + SMOOTHING * 1j * omega / omega[-1]) ** -SMOOTHING_ORDER
        spectrum = values * kernel * (terms / half_period)
        series = np.fft.irfft(spectrum)
        # Σ|F| bounds what rounding of F leaves at any time
        size = max(abs(series).max(), abs(spectrum).mean())
        return series[-series.size // 4 :], float(size), float(abs(spectrum[-1]))


def rightmost(sample: Sampler, t: RealArray, tol: float) -> float:
    """The largest real part of the singularities of F [1/s]; 0 where none is right of 0.

    `t` (n,): times of the inversion [s], ascending; the answer is within `NARROW`/last time.
    `tol`: what counts as nothing [unit of f].

    Raises
    ------
    FitError
        No such line: f does not begin at zero, or grows beyond all numbers.
    """
    lines = Lines(sample, t, tol)
    gamma = lines.gamma
    if not lines.wrong:
        return 0.0
    last = lines.wrong[-1]
    if last == gamma.size - 1:
        raise FitError(
            f"the transform has a singularity right of Re s = {gamma[-1]:.3g}/s, or is not that of "
            "a function that begins at time zero; where you know better, give the abscissa"
        )
    low, high = 0.0, gamma[last + 1]
    reach = gamma[last] * (FAR_TERMS if last else NEAR_TERMS)  # as far up the line as it was seen
    while (high - low) * t[-1] > NARROW:
        middle, clearance = (low + high) / 2, (high - low) / 4
        terms = 2 * int(min(reach / clearance, MAX_TERMS) / 2) + NEAR_TERMS
        if lines.is_right_of_all(middle, clearance, terms):
            high = middle
        else:
            low = middle - clearance
    return float(high)
