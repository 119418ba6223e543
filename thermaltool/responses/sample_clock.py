"""Sample lengths: what of a clock is rounding, and where it is even."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# Row by row, sample lengths are whole numbers of this [s].
CLOCK_STEP = 1e-9
# Lengths that differ by less than this share of the shortest count as equal: printed clocks round.
EQUAL_LENGTHS = 1e-7


def clock_step(time: Float) -> float:
    """The difference of two sample lengths that is rounding [s].

    `EQUAL_LENGTHS` of the shortest step, and no less than what the floating-point numbers of the
    clock themselves resolve.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
        Increasing.
    """
    if len(time) < 2:
        return CLOCK_STEP
    resolved = 4 * np.spacing(max(abs(float(time[0])), abs(float(time[-1]))))
    return max(EQUAL_LENGTHS * float(np.min(np.diff(time))), float(resolved))


def uniform_spans(time: Float) -> Iterator[tuple[slice, float]]:
    """Stretches of a clock with one sample length: (rows, first included, and dt [s]).

    Neighbouring stretches share a row: the last of one is the first of the next. Lengths are
    compared in steps of `clock_step`.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    """
    step = clock_step(time)
    ticks = np.round(np.diff(time) / step).astype(np.int64)
    edges = [0, *(np.flatnonzero(np.diff(ticks)) + 1).tolist(), len(ticks)]
    for start, stop in itertools.pairwise(edges):
        if stop > start:
            yield slice(start, stop + 1), float(time[start + 1] - time[start])
