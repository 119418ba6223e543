"""Records of several outputs on the clock of the log, as the shared modes take them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.transfer.data import (
    Array,
    Data,
    Piece,
    Stretch,
    first_levels,
    from_rest,
    parted,
)
from thermaltool.responses.modes import Hold


@dataclass(frozen=True)
class Span(Piece):
    """Consecutive rows on any clock, inputs without holes.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
        From its first row on, increasing.
    inputs : ndarray, shape (m, n)
    outputs : ndarray, shape (p, n)
        NaN where a reading is missing.
    origin : int
        The experiment it belongs to: one offset for each output.
    at_rest : bool
        Settled at its first inputs when it begins; else the state there is unknown.
    """

    time: Array
    inputs: Array
    outputs: Array
    origin: int = 0
    at_rest: bool = False

    def __post_init__(self) -> None:
        if not self.inputs.shape[1:] == self.outputs.shape[1:] == self.time.shape:
            raise FitError(
                f"time {self.time.shape}, inputs {self.inputs.shape} and outputs "
                f"{self.outputs.shape} differ in length"
            )

    def rows(self, part: slice) -> Span:
        return replace(self, time=self.time[part] - self.time[part][0],
                       inputs=self.inputs[:, part], outputs=self.outputs[:, part],
                       at_rest=self.begins(part))  # fmt: skip


@dataclass(frozen=True)
class Records:
    """What is fitted.

    Attributes
    ----------
    spans : tuple of Span
    dt : float [s]
        Usual sample period.
    names : tuple of str
        Of the inputs.
    holds : tuple of "zero" or "first"
        Of each input between its samples.
    targets : tuple of str
        Of the outputs.
    """

    spans: tuple[Span, ...]
    dt: float
    names: tuple[str, ...]
    holds: tuple[Hold, ...]
    targets: tuple[str, ...]

    @property
    def size(self) -> int:
        return sum(len(s) for s in self.spans)

    @property
    def duration(self) -> float:
        """Of the longest span [s]."""
        return max(float(s.time[-1]) for s in self.spans)

    @property
    def origins(self) -> int:
        return 1 + max(s.origin for s in self.spans)

    def output(self, k: int) -> Array:
        """All samples of output k in a row."""
        return np.concatenate([s.outputs[k] for s in self.spans])

    def levels(self) -> Array:
        """First inputs of each experiment, shape (origins, m)."""
        return first_levels(self.spans)

    def clocks(self, k: int) -> list[Array]:
        """Times of the stretches of `of`."""
        own = [s.time[np.isfinite(s.outputs[k])] for s in self.spans]
        return [time for time in own if len(time)]

    def of(self, k: int) -> Data:
        """Output k alone, its missing rows left out."""
        parts = []
        for s in self.spans:
            there = np.isfinite(s.outputs[k])
            if there.any():
                parts.append(Stretch(s.inputs[:, there], s.outputs[k][there], s.origin, s.at_rest))
        if not parts:
            raise FitError(f"{self.targets[k]} has no reading in any log")
        return Data(tuple(parts), self.dt, self.names, self.targets[k])

    def check(self) -> None:
        """Refuse what says nothing of a transfer function (FitError; `Data.check`)."""
        for k in range(len(self.targets)):
            self.of(k).check()

    def from_rest(self) -> Records:
        """The same, every experiment settled at its first inputs when it begins."""
        return replace(self, spans=from_rest(self.spans))

    def longest(self, most: int) -> Records:
        """The longest spans alone, their experiments numbered anew."""
        if len(self.spans) <= most:
            return self
        kept = sorted(np.argsort([-len(s) for s in self.spans], kind="stable")[:most].tolist())
        origins = {self.spans[k].origin: 0 for k in kept}
        numbers = {origin: k for k, origin in enumerate(origins)}
        spans = (replace(self.spans[k], origin=numbers[self.spans[k].origin]) for k in kept)
        return replace(self, spans=tuple(spans))

    def only(self, k: int) -> Records:
        """The records with output k alone."""
        spans = tuple(replace(s, outputs=s.outputs[[k]]) for s in self.spans)
        return replace(self, spans=spans, targets=(self.targets[k],))

    def parted(self, share: float) -> tuple[Records, Records]:
        """The first `share` of each experiment, and the rest; FitError where one side is empty."""
        first, rest = parted(self.spans, share)
        return replace(self, spans=first), replace(self, spans=rest)


def spans_of(
    time: Array, inputs: Array, outputs: Array, segments: Sequence[slice], origin: int = 0
) -> Iterator[Span]:
    """A log as spans: cut at pauses and where an input is missing; a missing output is left out.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    inputs : ndarray, shape (m, n)
    outputs : ndarray, shape (p, n)
    segments : sequence of slice
    """
    known = np.all(np.isfinite(inputs), axis=0)
    for part in segments:
        rows = part.start + np.flatnonzero(known[part])
        for piece in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if len(piece) > 1:
                yield Span(
                    time[piece] - time[piece[0]], inputs[:, piece], outputs[:, piece], origin
                )
