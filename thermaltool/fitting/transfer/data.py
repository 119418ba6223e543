"""Records as the estimators take them: even stretches without holes, and what they cannot carry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError

Array = NDArray[np.float64]

# Which zero an output has in a free run: that of its experiment in the fit; the mean of all of
# them, as a model document has it; or one that is estimated from the run.
Zero = Literal["fitted", "mean", "free"]

# A step may differ from the period by this share before the clock counts as uneven.
UNEVEN = 0.02
# Inputs whose normalized Gram matrix has an eigenvalue below this are the same to rounding.
COLLINEAR = 1e-9


# An excerpt excites enough with this share of the power that the best one has.
EXCITING = 0.1


class Piece(ABC):
    """Consecutive rows of a record, inputs without holes.

    Attributes
    ----------
    inputs : ndarray, shape (m, n)
    origin : int
        The experiment it belongs to: one offset each.
    at_rest : bool
        Settled at its first inputs when it begins; else its state there is unknown.
    """

    inputs: Array
    origin: int
    at_rest: bool

    def __len__(self) -> int:
        return int(self.inputs.shape[1])

    @abstractmethod
    def rows(self, part: slice) -> Self:
        """Some of its rows; those that follow its first begin in an unknown state."""

    def begins(self, part: slice) -> bool:
        """Whether these rows are at rest when they begin."""
        return self.at_rest and not part.start


P = TypeVar("P", bound=Piece)


def from_rest(pieces: Sequence[P]) -> tuple[P, ...]:
    """The same, every experiment settled at its first inputs when it begins."""
    seen: set[int] = set()
    parts = []
    for piece in pieces:
        parts.append(replace(piece, at_rest=piece.origin not in seen))  # type: ignore[type-var]
        seen.add(piece.origin)
    return tuple(parts)


def first_levels(pieces: Sequence[Piece]) -> Array:
    """First inputs of each experiment, shape (origins, m)."""
    found: dict[int, Array] = {}
    for piece in pieces:
        found.setdefault(piece.origin, piece.inputs[:, 0])
    return np.array([found[k] for k in range(1 + max(found))])


def parted(pieces: Sequence[P], share: float) -> tuple[tuple[P, ...], tuple[P, ...]]:
    """The first `share` of the rows of each experiment, and the rest.

    Raises
    ------
    FitError
        Nothing on one side.
    """
    rows = Counter[int]()
    for piece in pieces:
        rows[piece.origin] += len(piece)
    wanted = {origin: round(share * count) for origin, count in rows.items()}
    if any(not 0 < n < rows[origin] for origin, n in wanted.items()):
        raise FitError("the split leaves nothing on one side")
    first, rest = [], []
    for piece in pieces:
        n = min(max(wanted[piece.origin], 0), len(piece))
        wanted[piece.origin] -= n
        if n:
            first.append(piece.rows(slice(0, n)))
        if n < len(piece):
            rest.append(piece.rows(slice(n, len(piece))))
    return tuple(first), tuple(rest)


@dataclass(frozen=True)
class Stretch(Piece):
    """Consecutive even samples.

    Attributes
    ----------
    inputs : ndarray, shape (m, n)
    output : ndarray, shape (n,)
    origin : int
        The experiment it belongs to: one offset each.
    at_rest : bool
        Settled at its first inputs when it begins; else its state there is unknown.
    """

    inputs: Array
    output: Array
    origin: int = 0
    at_rest: bool = False

    def __post_init__(self) -> None:
        if self.inputs.ndim != 2 or self.inputs.shape[1:] != self.output.shape:
            raise FitError(
                f"inputs {self.inputs.shape} and output {self.output.shape} differ in length"
            )

    def rows(self, part: slice) -> Stretch:
        return replace(self, inputs=self.inputs[:, part], output=self.output[part],
                       at_rest=self.begins(part))  # fmt: skip


@dataclass(frozen=True)
class Data:
    """What is fitted.

    Attributes
    ----------
    stretches : tuple of Stretch
    dt : float [s]
    names : tuple of str
        Of the inputs.
    target : str
        Name of the output.
    """

    stretches: tuple[Stretch, ...]
    dt: float
    names: tuple[str, ...]
    target: str = "the output"

    @property
    def size(self) -> int:
        return sum(len(s) for s in self.stretches)

    @property
    def longest(self) -> int:
        return max(len(s) for s in self.stretches)

    @property
    def origins(self) -> int:
        return 1 + max(s.origin for s in self.stretches)

    def output(self) -> Array:
        """All output samples in a row."""
        return np.concatenate([s.output for s in self.stretches])

    def excerpt(self, most: int) -> Data:
        """At most so many samples of the longest stretch, from where the inputs first excite.

        From its beginning where the inputs move in the first half of that about as much as in the
        best such part.
        """
        whole = max(self.stretches, key=len)
        starts = range(0, max(len(whole) - most, 0) + most // 2, most // 2)
        parts = [whole.inputs[:, a : a + most // 2] for a in starts]
        power = np.array([[np.sum((u - u.mean()) ** 2) for u in part] for part in parts])
        least = np.min(power / np.maximum(power.max(axis=0), 1e-300), axis=1)
        start = starts[int(np.argmax(least >= EXCITING * least.max()))]
        part = replace(whole.rows(slice(start or None, start + most)), origin=0)
        return replace(self, stretches=(part,))

    def from_rest(self) -> Data:
        """The same, every experiment settled at its first inputs when it begins."""
        return replace(self, stretches=from_rest(self.stretches))

    def parted(self, share: float) -> tuple[Data, Data]:
        """The first `share` of each experiment, and the rest; FitError where one side is empty."""
        first, rest = parted(self.stretches, share)
        return replace(self, stretches=first), replace(self, stretches=rest)

    def levels(self) -> Array:
        """First inputs of each experiment, shape (origins, m)."""
        return first_levels(self.stretches)

    def padded(self, rows: int) -> Data:
        """With inputs relative to the first of each experiment, and their past where it is known.

        What begins at rest gets `rows` of input zero in front, so that no row is lost to lags.
        """
        levels, parts = self.levels(), []
        for s in self.stretches:
            u, n = s.inputs - levels[s.origin][:, None], rows if s.at_rest else 0
            u = np.hstack([np.zeros((len(u), n)), u])
            parts.append(replace(s, inputs=u, output=np.concatenate([np.zeros(n), s.output])))
        return replace(self, stretches=tuple(parts))

    def check(self) -> None:
        """Refuse what says nothing of a transfer function.

        Raises
        ------
        FitError
            An input that never moves, an output that never moves, inputs that are combinations of
            each other (named).
        """
        output = self.output()
        if not np.ptp(output) > 0:
            raise FitError(f"{self.target} is constant: there is nothing to identify")
        inputs = np.hstack([s.inputs - s.inputs.mean(1, keepdims=True) for s in self.stretches])
        power = np.sqrt(np.sum(inputs**2, axis=1))
        scale = np.sqrt(np.sum(np.hstack([s.inputs for s in self.stretches]) ** 2, axis=1))
        for name, moved, size in zip(self.names, power, scale, strict=True):
            if not moved > 1e-12 * size:
                raise FitError(f"{name} does not excite: it never moves within the record")
        unit = inputs / power[:, None]
        values, vectors = np.linalg.eigh(unit @ unit.T)
        if len(values) > 1 and values[0] < COLLINEAR:
            part = np.abs(vectors[:, 0])
            named = [n for n, share in zip(self.names, part, strict=True) if share > 1e-3]
            raise FitError(f"collinear inputs: {', '.join(named)} are combinations of each other")


def even_stretches(
    time: Array,
    inputs: Array,
    output: Array,
    segments: Sequence[slice],
    dt: float,
    origin: int = 0,
) -> Iterator[Stretch]:
    """A log as even stretches: cut at pauses and at missing readings, drawn onto one clock.

    Where the steps are not all `dt` a straight line between the readings is taken on the even
    clock; a step above 1.5 periods parts the record.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    inputs : ndarray, shape (m, n)
    output : ndarray, shape (n,)
    segments : sequence of slice
    dt : float [s]
    """
    there = np.isfinite(output) & np.isfinite(inputs).all(axis=0)
    for part in segments:
        rows = np.arange(part.start, part.stop)[there[part]]
        if not len(rows):
            continue
        breaks = np.flatnonzero(np.diff(time[rows]) > 1.5 * dt) + 1
        for piece in np.split(rows, breaks):
            t = time[piece]
            if len(piece) < 2 or np.max(np.abs(np.diff(t) - dt)) <= UNEVEN * dt:
                yield Stretch(inputs[:, piece], output[piece], origin)
                continue
            clock = t[0] + dt * np.arange(int((t[-1] - t[0]) / dt + 1e-9) + 1)
            drawn = np.array([np.interp(clock, t, u) for u in inputs[:, piece]])
            yield Stretch(drawn, np.interp(clock, t, output[piece]), origin)
