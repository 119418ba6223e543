"""One line of a stream: a time, and one number per sensor, NaN where there is none."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from thermaltool.errors import LogError
from thermaltool.runtime.clocks import LineClock
from thermaltool.runtime.rows.layout import Sensed, Wanted, find_layout

UNREADABLE = (LookupError, OverflowError, TypeError, ValueError)
# Words for a missing value, in lower case.
EMPTY = ("", "null", "none", "na")
# The fault of a sensor that a line does not have.
MISSING = "missing"
# Of a field that is no number, a message shows so many characters.
SHOWN_CHARACTERS = 40


class Row(NamedTuple):
    """One line: `time` [s] (None where it has none), `readings`, and why each bad one is bad."""

    time: float | None
    readings: list[float]
    faults: Sequence[str]


class RowReader:
    """Reads the lines of one format.

    A format gives `_open`, which calls `_lay_out` with the names of a first line, and `row`, which
    calls `_take` with the fields of a line or `_unusable`.

    Parameters
    ----------
    wanted : Wanted

    Attributes
    ----------
    clock : LineClock or None
        None until `open` has seen the line that shows the names.
    """

    clock: LineClock | None = None
    _blind = ""

    def __init__(self, wanted: Wanted) -> None:
        self.wanted = wanted
        self._sensed: tuple[Sensed, ...] = ()
        self._good = ("",) * len(wanted.sensors)

    def open(self, line: bytes, source: str | None = None, number: int | None = None) -> bool:
        """Find the columns in the first line; returns whether that line is a row too.

        Raises
        ------
        LogError
            It is no such line, or a column is not there; placed in `source` at line `number`.
        """
        try:
            return self._open(line)
        except LogError as error:
            raise LogError(error.message, source, number, error.column) from error

    def reopen(self, line: bytes, last: float | None) -> str:
        """Find the columns anew in a header amid the lines; returns a message, or nothing.

        Where one is missing no reading counts until a header has them all.

        Parameters
        ----------
        line : bytes
        last : float [s] or None
            Time of the last row.
        """
        before = self.clock
        if self._same_header(line):
            return ""
        try:
            self._open(line)
        except LogError as error:
            self.clock, self._blind = before, f"after a header that does not fit ({error})"
            return f"a header that does not fit: {error}: no reading counts"
        assert self.clock is not None
        if before is not None and before is not self.clock and last is not None:
            self.clock.resume(before.state(), last)
        return "a header: columns found anew"

    def skips(self, line: bytes, number: int) -> bool:
        """Whether a line is one that the map says to skip, before the names or behind them.

        Parameters
        ----------
        line : bytes
        number : int
            Counted from 1. Asked once of each line.
        """
        return False

    def row(self, line: bytes) -> Row:
        """The row in a line, whatever the line holds."""
        raise NotImplementedError

    def is_header(self, line: bytes) -> bool:
        """Whether a line, of which nothing can be used, names columns."""
        return False

    def _same_header(self, line: bytes) -> bool:
        return True

    def _open(self, line: bytes) -> bool:
        raise NotImplementedError

    def _lay_out(self, keys: dict[str, Any], number: Callable[[Any], float]) -> list[Any]:
        """Find clock and sensors; `keys` leads from a name to its field, `number` reads one.

        Returns what leads to the sensors' fields.
        """
        mapping = self.wanted.mapping
        if mapping is not None and mapping.named_already(keys):
            self.wanted = replace(self.wanted, mapping=None)
        layout = find_layout(keys, self.wanted, number)
        self._number, self._sensed, self.clock = number, layout.sensors, layout.clock
        self._keys = [sensed.key for sensed in layout.sensors]
        self._scaled = not all(sensed.plain for sensed in layout.sensors)
        return self._keys

    def _time(self, fields: Any) -> float | None:
        assert self.clock is not None
        try:
            return self.clock.stamp(fields)
        except UNREADABLE:
            return None

    def _take(self, fields: Any) -> Row:
        number = self._number
        try:
            readings, faults = [number(fields[key]) for key in self._keys], self._good
        except UNREADABLE:
            each = [self._reading(fields, key) for key in self._keys]
            readings, faults = [value for value, _ in each], tuple(fault for _, fault in each)
        if self._scaled:
            read = list(zip(self._sensed, readings, faults, strict=True))
            readings = [sensed.of(value) for sensed, value, _ in read]
            faults = tuple(
                f"{value:g}: a value that the map calls missing or not valid"
                if math.isnan(reading) and not math.isnan(value)
                else fault
                for reading, (_, value, fault) in zip(readings, read, strict=True)
            )
        return Row(self._time(fields), readings, faults)

    def _reading(self, fields: Any, key: Any) -> tuple[float, str]:
        """The reading at `key`, or NaN and what is wrong with it."""
        try:
            field = fields[key]
        except LookupError:
            return math.nan, MISSING
        try:
            return self._number(field), ""
        except UNREADABLE:
            text = field.decode("utf-8", "replace").strip() if isinstance(field, bytes) else field
            if text is None or str(text).lower() in EMPTY:
                return math.nan, "empty"
            return math.nan, f"not a number: {str(text)[:SHOWN_CHARACTERS]!r}"

    def _unusable(self, time: float | None, fault: str) -> Row:
        sensors = len(self._good)
        return Row(time, [math.nan] * sensors, (fault,) * sensors)
