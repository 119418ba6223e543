"""Resolution step of a channel: the lattice that its values lie on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.signals.detrend import difference_sigma

MIN_STEP_ROUNDINGS = 20.0  # a step below this many rounding errors is not told from rounding
# Share of distinct values below which uneven codes are still a converter's.
MAX_DISTINCT_SHARE = 0.25


def resolution_step(values: ArrayLike) -> float | None:
    """Smallest step between values: their greatest common divisor up to rounding.

    Printed decimals and converter codes lie on a lattice, also when some codes never occur. Codes
    of a curved sensor (a thermistor) do not; then the median gap between neighbours is the step.

    Parameters
    ----------
    values : array_like (n,)
        Readings; NaN is ignored [unit].

    Returns
    -------
    float or None
        Step [unit]; None for a constant or for values on no lattice (full-precision numbers).
    """
    v = np.asarray(values, dtype=float)
    v = v[np.isfinite(v)]
    if v.size == 0:
        return None
    levels = np.unique(v)
    if levels.size < 2:
        return None
    scale = float(np.abs(levels).max())
    single = bool(np.all(levels == levels.astype(np.float32)))  # stored or sent as float32
    step = _common_divisor(levels, (2.0**-23 if single else 8.0 * 2.0**-52) * scale)
    if step is not None:
        return step
    gaps = np.diff(levels)
    return float(np.median(gaps)) if levels.size < MAX_DISTINCT_SHARE * v.size else None


def _common_divisor(levels: NDArray[np.float64], tolerance: float) -> float | None:
    """Euclid's algorithm on all gaps at once, with a tolerance for rounding."""
    gaps = np.diff(levels)
    gaps = gaps[gaps > tolerance]
    if gaps.size == 0:
        return None
    step = float(gaps.min())
    while step > MIN_STEP_ROUNDINGS * tolerance:
        step = _refined(step, gaps, tolerance)
        rest = np.abs(gaps - step * np.round(gaps / step))
        if rest.max() <= 2.0 * tolerance:
            # The whole span in steps holds the most digits.
            span = levels[-1] - levels[0]
            return float(span / np.round(span / step))
        step = float(rest[rest > 2.0 * tolerance].min())
    return None


def _refined(step: float, gaps: NDArray[np.float64], tolerance: float) -> float:
    """Step to the precision of the longest gaps, each reach carrying the count to the next.

    Given back as it came where it does not divide the gaps.
    """
    refined, reach = step, max(3.0 * step, float(gaps.min()))
    while True:
        near = gaps[gaps <= reach]
        counts = np.round(near / refined)
        if np.abs(near - counts * refined).max() > 5.0 * tolerance:
            return step
        refined = float(near.sum() / counts.sum())
        if near.size == gaps.size:
            return refined
        reach *= 3.0


def reading_sigma(values: ArrayLike) -> float:
    """White noise of a reading: from differences of neighbours, a quantizer's at least.

    Parameters
    ----------
    values : array_like (n,)
        Readings in order; NaN is ignored [unit].
    """
    return max(difference_sigma(values), (resolution_step(values) or 0.0) / float(np.sqrt(12.0)))
