"""Welch spectrum of the noise and the lines that stand out of it.

Source: P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE
Trans. Audio Electroacoust. 15 (1967) 70.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import chdtrc, chdtri

Array = NDArray[np.float64]

MIN_SEGMENT, MAX_SEGMENT = 32, 16384  # samples per Fourier transform
SEGMENTS_PER_RECORD = 8  # transforms side by side that a record is cut into
FLOOR_BINS = 101  # bins whose median is the local floor
MAX_LINES = 20  # listed, of strongest evidence
THIN_BANDS = 200  # points of a plotted spectrum
MAX_LINE_P_VALUE = 0.01  # chance to see a line anywhere in a spectrum without one


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density.

    Attributes
    ----------
    frequency, density : ndarray (k,)
        [Hz] and [unit²/Hz].
    dof : float
        Degrees of freedom of each value: density is distributed as its mean times χ²(dof) / dof.
    """

    frequency: Array
    density: Array
    dof: float


@dataclass(frozen=True)
class Line:
    """A spectral line: `frequency` [Hz], `amplitude` of its sine [unit], and `p_value`, the chance
    of such a peak anywhere in a spectrum of noise alone."""

    frequency: float
    amplitude: float
    p_value: float


def welch_spectrum(runs: Sequence[Array], period: float) -> Spectrum | None:
    """Welch's method (Hann window, half overlap) over all uninterrupted runs of readings.

    Own, because `scipy.signal.welch` takes one run, and its import adds to every `noise`.

    Parameters
    ----------
    runs : sequence of ndarray
        Evenly sampled stretches without NaN [unit].
    period : float
        Sample period [s].

    Returns
    -------
    Spectrum or None
        None where no run holds `MIN_SEGMENT` samples. The first two bins (mean and its leakage) are
        left out.
    """
    longest = max((run.size for run in runs), default=0)
    if longest < MIN_SEGMENT:
        return None
    size = 2 ** int(np.log2(np.clip(longest * 2 // SEGMENTS_PER_RECORD, MIN_SEGMENT, MAX_SEGMENT)))
    window = np.hanning(size + 1)[:-1]
    power, count = np.zeros(size // 2 + 1), 0
    for run in runs:
        if run.size < size:
            continue
        pieces = np.lib.stride_tricks.sliding_window_view(run, size)[:: size // 2]
        tapered = (pieces - pieces.mean(axis=1, keepdims=True)) * window
        power += np.sum(np.abs(np.fft.rfft(tapered, axis=1)) ** 2, axis=0)
        count += len(pieces)
    density = 2.0 * period * power / (count * np.sum(window**2))
    density[-1] /= 2.0  # the Nyquist bin has no twin
    # Adjacent half-overlapping Hann windows correlate by 1/36 in power (Welch 1967).
    dof = 2.0 * count / (1.0 + 2.0 * (count - 1) / count / 36.0)
    frequency = np.asarray(np.fft.rfftfreq(size, period), dtype=float)
    return Spectrum(frequency[2:], density[2:], dof)


def find_lines(spectrum: Spectrum, baseline: Array, lowest: float = 0.0) -> tuple[Line, ...]:
    """Peaks above the local floor that noise does not explain, strongest evidence first.

    The floor is the running median of density / baseline; a peak's χ² probability is multiplied by
    the number of bins searched (Bonferroni).

    Parameters
    ----------
    spectrum : Spectrum
    baseline : ndarray (k,)
        Expected shape of the density, so that a steep floor is flat to the median [any unit].
    lowest : float
        Frequency below which no line is sought [Hz].
    """
    searched = spectrum.frequency >= lowest
    frequency, density, shape = (
        spectrum.frequency[searched],
        spectrum.density[searched],
        baseline[searched],
    )
    if density.size < 16:
        return ()
    relative = density / shape
    centre = chdtri(spectrum.dof, 0.5) / spectrum.dof
    floor = median_filter(relative, size=min(FLOOR_BINS, density.size), mode="mirror") / centre
    ratio = relative / np.maximum(floor, np.finfo(float).tiny)
    probability = np.minimum(density.size * chdtrc(spectrum.dof, spectrum.dof * ratio), 1.0)
    padded = np.concatenate(([0.0], ratio, [0.0]))
    peak = (ratio >= padded[:-2]) & (ratio > padded[2:]) & (probability < MAX_LINE_P_VALUE)
    spacing = spectrum.frequency[1] - spectrum.frequency[0]
    # A sine's power spreads over the three bins of the Hann main lobe.
    excess = np.convolve(np.maximum(density - floor * shape, 0.0), np.ones(3), mode="same")
    lines = [
        Line(float(frequency[k]), float(np.sqrt(2.0 * spacing * excess[k])), float(probability[k]))
        for k in np.flatnonzero(peak)
    ]
    return tuple(sorted(lines, key=lambda line: (line.p_value, -line.amplitude))[:MAX_LINES])


def thin(spectrum: Spectrum) -> tuple[Array, Array]:
    """Frequency and density averaged into about `THIN_BANDS` log-spaced bands [Hz], [unit²/Hz]."""
    f = spectrum.frequency
    if f.size <= THIN_BANDS:
        return f, spectrum.density
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), THIN_BANDS + 1)
    band = np.searchsorted(edges, f, side="right")
    starts = np.flatnonzero(np.diff(band, prepend=-1))
    counts = np.diff(np.append(starts, f.size))
    return (np.add.reduceat(f, starts) / counts, np.add.reduceat(spectrum.density, starts) / counts)
