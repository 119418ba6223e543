"""What the formats have in common: a table of cells, named columns first, values on request."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thermaltool.documents import MAX_NUMBER, source_name
from thermaltool.errors import LogError
from thermaltool.parsing import numbers_among
from thermaltool.record import Array
from thermaltool.sources import read_input

# How a column is wanted: as numbers, as text (an ISO clock), or not at all.
Kind = Literal["number", "text"] | None

# Problems of one kind in one column that are listed one by one; the rest is counted.
MAX_LISTED = 5
# Clocks are compared in whole microseconds, which an integer has to hold [s].
MAX_TIME = 9e12
UNFINISHED = "the last line is unfinished: left out"


@dataclass(frozen=True)
class InputBytes:
    """The bytes of an input and the name that messages give it."""

    name: str
    data: bytes

    @property
    def digest(self) -> str:
        """SHA-256 of the bytes."""
        return hashlib.sha256(self.data).hexdigest()


Values = list[Array | list[str | None] | None]


@dataclass(frozen=True)
class Cells:
    """The values of a table: one entry per column (None where not wanted).

    `unfinished` is a last line without its line end that makes no row: it is still being written.
    """

    values: Values
    lines: NDArray[np.intp]
    problems: list[LogError] = field(default_factory=list)
    unfinished: LogError | None = None


class Table(Protocol):
    """A parsed header."""

    names: list[str]

    @property
    def header_line(self) -> int | None:
        """The line of the names; None in formats that have none."""

    def cells(self, kinds: Sequence[Kind]) -> Cells:
        """The values, one kind per name."""


# What a format makes of a wanted column: numbers with the faults of its cells, or text.
ReadNumbers = Callable[[int, str], tuple[Array, list[LogError]]]
ReadText = Callable[[int], list[str | None]]


def read_columns(
    names: Sequence[str],
    kinds: Sequence[Kind],
    numbers: ReadNumbers,
    text: ReadText,
    missing: Sequence[str] = (),
) -> tuple[Values, list[LogError]]:
    """The columns as wanted, and the faults of their cells; infinity is one.

    Parameters
    ----------
    numbers, text : callable
        Read a column by its place.
    missing : sequence of str
        Words for a missing value, the numbers among them.
    """
    values: Values = []
    problems: list[LogError] = []
    for i, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        if kind == "number":
            array, faults = numbers(i, name)
            values.append(marked_missing(array, missing))
            problems += first_faults(faults)
        else:
            values.append(text(i) if kind else None)
    return values, problems


def without_infinity(
    array: Array, file: str, name: str, lines: NDArray[np.intp] | None = None
) -> tuple[Array, list[LogError]]:
    """Numbers by row, NaN in the place of infinity, and where that is."""
    infinite = np.isinf(array)
    lines = np.arange(1, len(array) + 1) if lines is None else lines
    faults = [
        LogError(f"infinite: {array[k]}", file, int(lines[k]), name)
        for k in np.flatnonzero(infinite)
    ]
    return np.where(infinite, np.nan, array), faults


def beyond_range(
    file: str, name: str | None, values: Array, lines: NDArray[np.intp], limit: float = MAX_NUMBER
) -> list[LogError]:
    """Where numbers of a column are too large to be worked with.

    Parameters
    ----------
    file, name : str
        What messages call the log, and the column.
    values : ndarray, shape (n,)
    lines : ndarray of int, shape (n,)
    limit : float
    """
    rows = np.flatnonzero(np.abs(values) > limit)
    what = "too large for a clock" if limit == MAX_TIME else f"too large, above {limit:g}"
    return [LogError(f"{what}: {values[k]:g}", file, int(lines[k]), name) for k in rows]


def read_source(source: str) -> InputBytes:
    """All bytes of a file, or of stdin for ``-``; a file that cannot be read is a LogError."""
    try:
        return InputBytes(source_name(source), read_input(source))
    except IsADirectoryError as error:
        raise LogError("this is a folder, not a log", source) from error
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        raise LogError(message, source_name(source)) from error


def marked_missing(values: Array, words: Sequence[str]) -> Array:
    """The numbers, NaN where one is that of a word for a missing value (``-999``)."""
    numbers = numbers_among(words)
    return np.where(equals_any(values, numbers), np.nan, values) if numbers else values


def equals_any(values: Array, numbers: Sequence[float]) -> NDArray[np.bool_]:
    """Where values are one of some numbers, in single precision where they have no more.

    Parameters
    ----------
    values : ndarray, shape (n,)
    numbers : sequence of float
    """
    with np.errstate(over="ignore"):
        single, singles = values.astype(np.float32), np.array(numbers, np.float32)
    return np.isin(values, numbers) | ((single == values) & np.isin(single, singles))


def first_faults(problems: list[LogError]) -> list[LogError]:
    """The first few problems of one kind and column, and how many more there are."""
    if len(problems) <= MAX_LISTED:
        return problems
    last = problems[-1]
    more = f"{len(problems) - MAX_LISTED} more like this, the last at line {last.line}"
    return [*problems[:MAX_LISTED], LogError(more, last.file, None, last.column)]
