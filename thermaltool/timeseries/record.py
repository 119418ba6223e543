"""One even series as the estimators take it: runs without a hole, and the holes between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.errors import FitError

Array = NDArray[np.float64]

NEW_START = -1  # in place of a number of missing samples: nothing is known of the time between


@dataclass(frozen=True)
class Record:
    """Runs of consecutive samples at one period.

    Attributes
    ----------
    runs : tuple of ndarray (k_i,)
        Samples without NaN [unit].
    starts : tuple of int
        Place of each run's first sample on the common clock [samples].
    gaps : tuple of int
        Samples missing before each run; `NEW_START` where the run stands for itself.
    """

    runs: tuple[Array, ...]
    starts: tuple[int, ...]
    gaps: tuple[int, ...]

    @cached_property
    def size(self) -> int:
        """Samples that are there."""
        return sum(run.size for run in self.runs)

    @property
    def end(self) -> int:
        """Place of the sample after the last one [samples]."""
        return self.starts[-1] + self.runs[-1].size

    @cached_property
    def values(self) -> Array:
        """All samples in a row, the holes left out."""
        return self.runs[0] if len(self.runs) == 1 else np.concatenate(self.runs)

    @cached_property
    def places(self) -> Array:
        """Place of every sample on the common clock [samples]."""
        pieces = [s + np.arange(run.size) for s, run in zip(self.starts, self.runs, strict=True)]
        return np.concatenate(pieces).astype(float)

    def with_values(self, values: Array) -> Record:
        """The same clock with other `values`, ndarray (size,)."""
        edges = np.cumsum([0] + [run.size for run in self.runs])
        cut = tuple(values[a:b] for a, b in pairwise(edges))
        return Record(cut, self.starts, self.gaps)

    def bridged(self) -> Record:
        """The record with straight lines over its holes; itself where there are none."""
        if all(gap <= 0 for gap in self.gaps):
            return self
        first = [k for k, gap in enumerate(self.gaps) if gap == NEW_START]
        runs = []
        for a, b in pairwise([*first, len(self.runs)]):
            end = self.starts[b - 1] + self.runs[b - 1].size
            there = np.concatenate(
                [start + np.arange(run.size) for start, run in
                 zip(self.starts[a:b], self.runs[a:b], strict=True)]
            )  # fmt: skip
            runs.append(np.interp(np.arange(self.starts[a], end), there,
                                  np.concatenate(self.runs[a:b])))  # fmt: skip
        return Record(tuple(runs), tuple(self.starts[k] for k in first), (NEW_START,) * len(first))

    def difference(self, order: int) -> Record:
        """The `order`-th difference; a run loses its first `order` samples.

        Raises
        ------
        FitError
            No run is longer than `order`.
        """
        if order == 0:
            return self
        kept = [k for k, run in enumerate(self.runs) if run.size > order]
        if not kept:
            raise FitError(f"no run of samples is longer than the difference {order}")
        gaps = []
        for place, k in enumerate(kept):
            before = self.starts[kept[place - 1]] + self.runs[kept[place - 1]].size if place else 0
            fresh = NEW_START in self.gaps[kept[place - 1] + 1 : k + 1] if place else True
            gaps.append(NEW_START if fresh else self.starts[k] + order - before)
        return Record(
            tuple(np.diff(self.runs[k], order) for k in kept),
            tuple(self.starts[k] + order for k in kept),
            tuple(gaps),
        )

    def without(self, rows: NDArray[np.intp]) -> Record:
        """The record without the samples at `rows` (of `values`): they count as missing."""
        if not rows.size:
            return self
        values, pieces = self.values.copy(), []
        values[rows] = np.nan
        for run in self.with_values(values).runs:
            pieces.append(run)
        return _join(pieces, self.starts, self.gaps)


def record_of(
    values: ArrayLike,
    segments: tuple[slice, ...] | None = None,
    places: NDArray[np.intp] | None = None,
) -> Record:
    """The record of samples on an even clock.

    Parameters
    ----------
    values : array_like (n,)
        Samples; NaN is missing [unit].
    segments : tuple of slice, optional
        Stretches that stand for themselves; the whole by default.
    places : ndarray (n,) of int, optional
        Place of each row on the clock, increasing; consecutive by default.

    Raises
    ------
    FitError
        No sample at all.
    """
    x = np.asarray(values, dtype=float)
    at = np.arange(x.size) if places is None else places
    pieces, starts, gaps = [], [], []
    for part in segments or (slice(0, x.size),):
        if not np.isfinite(x[part]).any():
            continue
        span = at[part]
        full = np.full(int(span[-1] - span[0]) + 1, np.nan)
        full[span - span[0]] = x[part]
        pieces.append(full)
        starts.append(int(span[0]))
        gaps.append(NEW_START)
    if not pieces:
        raise FitError("no sample is there: every reading is missing")
    return _join(pieces, tuple(starts), tuple(gaps))


def _join(pieces: list[Array], starts: tuple[int, ...], gaps: tuple[int, ...]) -> Record:
    """Cut each piece at its NaN; what stands before the first sample of a piece adds to its gap."""
    runs: list[Array] = []
    firsts: list[int] = []
    holes: list[int] = []
    end = 0  # place after the last sample seen
    fresh = True
    for piece, start, gap in zip(pieces, starts, gaps, strict=True):
        fresh = fresh or gap == NEW_START
        good = np.isfinite(piece)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False]))))
        for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            runs.append(piece[a:b])
            firsts.append(start + a)
            holes.append(NEW_START if fresh else start + a - end)
            end, fresh = start + b, False
    if not runs:
        raise FitError("no sample is left")
    return Record(tuple(runs), tuple(firsts), tuple(holes))
