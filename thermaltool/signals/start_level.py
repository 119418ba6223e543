"""The level at which a noisy signal begins: its zero, where it has none of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.signals.detrend import difference_sigma
from thermaltool.signals.resolution import resolution_step

# Rows beyond which a longer mean gains nothing that matters: noise is down by the root of it.
MAX_ROWS = 2000
# Each stretch that is tried is longer than the one before by this factor.
GROWTH = 1.5
# Half width of the interval of a mean, in standard deviations: the stretch ends where two intervals
# no longer meet. A steady signal passes all of some fifteen trials.
INTERVAL = 3.0
# The level is taken from this share of it. At its end a signal that moves has gone as far as noise
# could hide: from all of it the level of a ramp is off by up to 2.6 deviations of a reading, from a
# third by no more than one.
USED_SHARE = 1 / 3
# Standard deviation of the median of normal noise over that of its mean, sqrt(π/2).
MEDIAN_LOSS = 1.25
# Readings of fewer values than this have no lattice: their one gap may be a step of the signal.
MIN_LEVELS = 5
# A first reading is no level where the step behind it is larger than so many deviations of a step
# of noise, and so many of the largest of the next steps, as far as these are above noise. A lag
# that is sampled once in its time constant has 2.7 of them.
LONE_SIGMAS, LONE_STEPS, NEXT_STEPS, STEP_SIGMAS = 5.0, 3.0, 10, 3.0


@dataclass(frozen=True)
class StartLevel:
    """The level of the first rows.

    Attributes
    ----------
    value : float [unit of the signal]
        NaN where there is no reading.
    first, last : int
        The rows between which readings were taken, both included; -1 where there are none.
    rows : int
        Readings among them.
    """

    value: float
    first: int
    last: int
    rows: int


def start_level(values: ArrayLike) -> StartLevel:
    """Level of the first rows: a median over what noise lets pass for steady.

    The stretch grows until the interval of its median no longer meets those of all shorter ones
    (A. Goldenshluger and A. Nemirovski, Math. Methods Stat. 6 (1997) 135); a third of it counts. A
    signal without noise, or one that moves at once, therefore begins with its first reading, a
    steady one with the median of many. A first reading that stands alone does not count.

    Parameters
    ----------
    values : array_like, shape (n,)
        NaN is passed over.
    """
    v = np.asarray(values, dtype=float)
    there = np.flatnonzero(np.isfinite(v))[:MAX_ROWS]
    if not len(there):
        return StartLevel(float("nan"), -1, -1, 0)
    v = v[there]
    # Rounding to steps has the variance of a uniform distribution.
    sigma = float(np.hypot(difference_sigma(v), _reading_step(v) / np.sqrt(12.0)))
    if _stands_alone(v, sigma):
        v, there = v[1:], there[1:]
    steady = 1
    low, high = v[0] - INTERVAL * sigma, v[0] + INTERVAL * sigma
    for tried in _lengths(len(v)):
        level = float(np.median(v[:tried]))
        half = INTERVAL * MEDIAN_LOSS * sigma / np.sqrt(tried)
        low, high = max(low, level - half), min(high, level + half)
        if low > high:
            break
        steady = tried
    rows = max(1, int(USED_SHARE * steady))
    return StartLevel(float(np.median(v[:rows])), int(there[0]), int(there[rows - 1]), rows)


def _reading_step(v: NDArray[np.float64]) -> float:
    """Resolution of the readings [unit of the signal]; 0 where none is to be seen."""
    return (resolution_step(v) or 0.0) if len(np.unique(v)) >= MIN_LEVELS else 0.0


def _lengths(rows: int) -> list[int]:
    """Lengths that are tried, from 3 to all rows."""
    found, length = [], 3.0
    while length < rows:
        found.append(int(length))
        length *= GROWTH
    return [*found, rows] if rows >= 3 else []


def _stands_alone(v: NDArray[np.float64], sigma: float) -> bool:
    """Whether the first reading is an outlier: alone on its side of a step that nothing follows."""
    steps = np.abs(np.diff(v[: NEXT_STEPS + 2]))
    if len(steps) < 3:
        return False
    noise = np.sqrt(2.0) * sigma
    moves = max(float(steps[1:].max()) - STEP_SIGMAS * noise, 0.0)
    return bool(steps[0] > LONE_SIGMAS * noise + LONE_STEPS * moves)
