"""Poles close to the imaginary axis, beyond the frequencies that a method has resolved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from thermaltool.laplace.sampling import RealArray, Sampler

# The scan runs along s = ω(step + i), ω geometric with ratio e^step; what it finds must also be
# there on the fine one, which a delay and a well damped pole are not.
SCAN_STEP, FINE_STEP = 0.05, 0.002
# Differences of this order annihilate what is smooth in ln ω (powers, logarithms, exponentials of
# roots) to rounding and leave a pole; of s/(s − iω₀) they make POLE_DIFFERENCE/step, found
# numerically.
DIFFERENCE_ORDER, POLE_DIFFERENCE = 10, 80.0
# A pole stands out of its surroundings (samples) by this factor; rounding is alike over many
# samples, and dense combs of poles are seen by the series itself.
BACKGROUND_SAMPLES, MIN_PROMINENCE = 41, 20.0
# Poles are sought from 350/(last time) up to this over the first time.
MAX_FREQUENCY_RATIO = 1e5


@dataclass(frozen=True)
class Resonances:
    """Amplitudes of undamped oscillation found at angular frequencies `omega` [rad/s], both (m,)"""

    omega: RealArray
    amplitude: RealArray

    def above(self, omega: float) -> float:
        """The largest amplitude at frequencies above `omega` [rad/s]."""
        return float(self.amplitude[self.omega > omega].max(initial=0.0))


def scan(sample: Sampler, t: RealArray, threshold: float) -> Resonances:
    """Look for oscillation too fast for times `t` (n,), ascending, of amplitude ≥ `threshold`.

    An undamped pole iω₀ is seen in s·F(s) along a ray just right of the imaginary axis as a peak
    of relative width `SCAN_STEP`, whatever ω₀; 20 evaluations per e-fold suffice.
    """
    if not t.size:
        return Resonances(np.empty(0), np.empty(0))
    omega, amplitude = _amplitudes(sample, 350 / t[-1], MAX_FREQUENCY_RATIO / t[0], SCAN_STEP)
    padded = np.pad(amplitude, BACKGROUND_SAMPLES // 2, mode="reflect")
    background = np.median(sliding_window_view(padded, BACKGROUND_SAMPLES), axis=1)
    found = np.flatnonzero((amplitude >= threshold) & (amplitude > MIN_PROMINENCE * background))
    confirmed = np.zeros_like(amplitude)
    for peak in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1) if found.size else []:
        _, fine = _amplitudes(sample, omega[peak[0]] * 0.9, omega[peak[-1]] * 1.1, FINE_STEP)
        confirmed[peak] = np.minimum(amplitude[peak], fine.max())
    return Resonances(omega, confirmed)


def _amplitudes(
    sample: Sampler, start: float, stop: float, step: float
) -> tuple[RealArray, RealArray]:
    """Frequencies, and the amplitude that an undamped pole would need to look as F does there."""
    omega = np.exp(np.arange(np.log(start), np.log(stop), step))
    s = omega * (step + 1j)
    with np.errstate(all="ignore"):
        amplitude = abs(np.diff(s * sample.lenient(s), DIFFERENCE_ORDER)) * step / POLE_DIFFERENCE
    return omega[DIFFERENCE_ORDER // 2 : -DIFFERENCE_ORDER // 2], np.nan_to_num(
        amplitude, posinf=0.0
    )
