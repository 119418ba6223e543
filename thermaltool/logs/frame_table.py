"""Data frames of pandas; their rows are counted from 1 where files have lines."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.table import Cells, Kind, read_columns, without_infinity
from thermaltool.record import Array
from thermaltool.units import clock_unit

if TYPE_CHECKING:
    import pandas

FRAME_NAME = "<frame>"


class FrameTable:
    """A data frame as a table; its index counts as a column where it is the clock.

    A `DatetimeIndex` is the ISO clock ``time``, a `TimedeltaIndex` the clock ``time_s``, and an
    index that has a clock's name is that clock, unless a column is. `missing` are words for a
    missing value, beside those of pandas. Of a file that was read into a frame: its name in
    `file`, the lines of its rows, the line of the names, and the `units` that it has for columns.
    """

    def __init__(
        self,
        frame: pandas.DataFrame,
        missing: Sequence[str] = (),
        *,
        file: str = FRAME_NAME,
        lines: Sequence[int] | None = None,
        header_line: int | None = None,
        units: Mapping[str, str] | None = None,
        decimal: str = ".",
    ) -> None:
        import pandas

        self.file, self._missing, self._decimal = file, missing, decimal
        self.header_line, self.units = header_line, dict(units or {})
        self._columns: list[Any] = [frame.iloc[:, i] for i in range(frame.shape[1])]
        self.names = [str(name).strip() for name in frame.columns]
        index = frame.index
        if isinstance(index, pandas.DatetimeIndex):
            clock = "time"
        elif isinstance(index, pandas.TimedeltaIndex):
            clock, index = "time_s", index.total_seconds()
        else:
            clock = str(index.name).strip()
        if clock_unit(self.names) is None and clock_unit([clock]) is not None:
            self.names.insert(0, clock)
            self._columns.insert(0, index.to_series())
        self._rows = len(frame)
        self._lines = np.arange(1, self._rows + 1) if lines is None else np.array(lines, np.intp)

    def cells(self, kinds: Sequence[Kind]) -> Cells:
        """The columns as wanted; every fault is a problem with its row and column."""
        values, problems = read_columns(self.names, kinds, self._numbers, self._text, self._missing)
        return Cells(values, self._lines, problems)

    def _text(self, i: int) -> list[str | None]:
        return [_stamp(value) for value in self._columns[i]]

    def _numbers(self, i: int, name: str) -> tuple[Array, list[LogError]]:
        column, faults = self._columns[i], []
        if column.dtype.kind == "O":
            array, bad = _cell_by_cell(column, self._missing, self._decimal)
            numbers = len(bad) < column.notna().sum() or not bad
            cells = column.to_list()
            faults = [
                LogError(f"not a number: {cells[k]!r}", self.file, int(self._lines[k]), name)
                for k in bad
            ]
        else:
            numbers = column.dtype.kind in "iuf"
        if not numbers:
            error = LogError(
                f"not a number: the column holds {column.dtype}", self.file, None, name
            )
            return np.full(self._rows, np.nan), [error]
        if column.dtype.kind != "O":
            array = column.to_numpy(dtype=np.float64, na_value=np.nan)
        array, infinite = without_infinity(array, self.file, name, self._lines)
        return array, faults + infinite

    @property
    def digest(self) -> str:
        """SHA-256 of names and values."""
        digest = hashlib.sha256()
        for name, column in zip(self.names, self._columns, strict=True):
            digest.update(name.encode() + b"\0")
            number = column.dtype.kind in "iuf"
            text = column.to_numpy(np.float64, na_value=np.nan).tobytes() if number else None
            digest.update("\0".join(map(str, column)).encode() if text is None else text)
        return digest.hexdigest()


def _stamp(value: Any) -> str | None:
    """A time stamp as ISO 8601, None where it is missing."""
    import pandas

    if pandas.isna(value):
        return None
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def _cell_by_cell(column: Any, words: Sequence[str], decimal: str) -> tuple[Array, list[int]]:
    """Numbers of a column of text or objects, and the rows that hold none."""
    numbers, bad = np.full(len(column), np.nan), []
    for k, (value, missing) in enumerate(zip(column, column.isna(), strict=True)):
        word = value.strip() if isinstance(value, str) else value
        if missing or word == "" or word in words:
            continue
        if decimal != "." and isinstance(word, str):
            # A point is one of thousands there.
            word = "" if "." in word else word.replace(decimal, ".")
        try:
            # Python reads 1_000 and True as numbers; no logger means that.
            if isinstance(word, bool | np.bool_) or "_" in str(word):
                raise ValueError
            numbers[k] = float(word)
        except (TypeError, ValueError):
            bad.append(k)
    return numbers, bad
