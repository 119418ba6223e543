"""How fast a channel has changed: its largest change within each span of samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# Spans, each twice the one before: from a sample to 2¹⁸ samples.
DOUBLINGS = 19


def largest_changes(pieces: Sequence[Float]) -> tuple[float, ...]:
    """The largest change within 1, 2, 4 ... samples.

    Every reading counts, noise and spikes, so that what was seen once is never called too quick.

    Parameters
    ----------
    pieces : sequence of ndarray, shape (n,)
        On an even clock, without NaN; nothing is known of what was between them.

    Returns
    -------
    tuple of float
        As many as the longest piece has spans, `DOUBLINGS` at the most; empty for pieces of fewer
        than two samples.
    """
    found: list[float] = []
    for piece in pieces:
        high = low = piece
        for k in range(DOUBLINGS):
            # Of windows of 2^(k-1) + 1 samples those of 2^k + 1, which overlap in one.
            step = 2 ** max(k - 1, 0)
            if len(high) <= step:
                break
            high, low = (
                np.maximum(high[:-step], high[step:]),
                np.minimum(low[:-step], low[step:]),
            )
            change = float(np.max(high - low))
            if k < len(found):
                found[k] = max(found[k], change)
            else:
                found.append(change)
    # A longer span holds the shorter ones.
    return larger_changes(found, ())


def larger_changes(one: Sequence[float], other: Sequence[float]) -> tuple[float, ...]:
    """Span by span the larger of two; the longer one goes on alone, and never falls.

    Parameters
    ----------
    one, other : sequence of float
        As `largest_changes` gives them.
    """
    short, long = sorted((one, other), key=len)
    joined = [*map(max, short, long), *long[len(short) :]]
    return tuple(np.maximum.accumulate(joined).tolist()) if joined else ()
