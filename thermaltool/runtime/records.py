"""Lines of a stream to records: a time, and one number per sensor, NaN where there is none."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from thermaltool.errors import LogError
from thermaltool.runtime.clocks import Clock
from thermaltool.runtime.layout import Sensed, Wanted, find_layout

UNREADABLE = (LookupError, OverflowError, TypeError, ValueError)
EMPTY = ("", "null", "none", "na")


class Row(NamedTuple):
    """One line: `time` [s] (None where it has none), `readings`, and why each bad one is bad."""

    time: float | None
    readings: list[float]
    faults: Sequence[str]


class RowReader(Protocol):
    """Reads the lines of one format.

    `clock` is None until `open` has seen the line that shows the names; `open` says whether that
    line is a record too, and raises LogError, placed in `source` at `number`, where it is no such
    line.
    """

    clock: Clock | None

    def open(self, line: bytes, source: str | None = None, number: int | None = None) -> bool: ...
    def record(self, line: bytes) -> Row: ...


class _Fields:
    """Clock and readings from the fields of a line, once the layout is known."""

    clock: Clock | None = None

    def __init__(self, wanted: Wanted) -> None:
        self.wanted = wanted
        self._sensed: tuple[Sensed, ...] = ()
        self._good = ("",) * len(wanted.sensors)

    def open(self, line: bytes, source: str | None = None, number: int | None = None) -> bool:
        try:
            return self._open(line)
        except LogError as error:
            raise LogError(error.message, source, number, error.column) from error

    def _open(self, line: bytes) -> bool:
        raise NotImplementedError

    def _lay_out(self, keys: dict[str, Any], number: Callable[[Any], float]) -> None:
        layout = find_layout(keys, self.wanted, number)
        self._number, self._sensed, self.clock = number, layout.sensors, layout.clock
        self._keys = [sensed.key for sensed in layout.sensors]
        self._scaled = any((s.scale, s.offset) != (1.0, 0.0) for s in layout.sensors)

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
            told = [self._tell(fields, key) for key in self._keys]
            readings, faults = [value for value, _ in told], tuple(fault for _, fault in told)
        if self._scaled:
            readings = [s.scale * x + s.offset for s, x in zip(self._sensed, readings, strict=True)]
        return Row(self._time(fields), readings, faults)

    def _tell(self, fields: Any, key: Any) -> tuple[float, str]:
        """The reading at `key`, or NaN and what is wrong with it."""
        try:
            field = fields[key]
        except LookupError:
            return math.nan, "missing"
        try:
            return self._number(field), ""
        except UNREADABLE:
            text = field.decode("utf-8", "replace").strip() if isinstance(field, bytes) else field
            if text is None or str(text).lower() in EMPTY:
                return math.nan, "empty"
            return math.nan, f"not a number: {str(text)[:40]!r}"

    def _unusable(self, time: float | None, fault: str) -> Row:
        sensors = len(self._good)
        return Row(time, [math.nan] * sensors, (fault,) * sensors)


def open_records(
    form: str,
    sensors: tuple[str, ...],
    columns: str | None,
    period: float | None,
    **clock: Any,
) -> RowReader:
    """RowReader of one format.

    Parameters
    ----------
    form : "csv" or "ndjson"
    sensors : tuple of str
    columns : str or None
        File of a column map.
    period : float [s] or None
        Of a stream without a clock.
    clock
        The other attributes of `Wanted`.

    Raises
    ------
    LogError
        The column map cannot be read.
    """
    mapping = None
    if columns is not None:
        # Imported for a map alone: the package reads whole logs.
        from thermaltool.logs.columns import read_map

        mapping = read_map(columns)
    wanted = Wanted(sensors, mapping, period, **clock)
    return CsvRecords(wanted) if form == "csv" else NdjsonRecords(wanted)


class CsvRecords(_Fields):
    """CSV: the first line names the columns."""

    def __init__(self, wanted: Wanted) -> None:
        super().__init__(wanted)
        dialect = wanted.mapping.dialect if wanted.mapping else None
        self._separator = dialect.separator.encode() if dialect else b","
        self._parse = csv_number(dialect.decimal, dialect.missing) if dialect else plain_number
        self._width = 0

    def _open(self, line: bytes) -> bool:
        try:
            text = line.decode()
        except UnicodeDecodeError as error:
            raise LogError(f"not UTF-8: byte 0x{line[error.start]:02x}") from error
        if text.lstrip().startswith("{"):
            raise LogError("this is NDJSON, not CSV: use --from ndjson")
        names = [name.strip() for name in self._unquoted(text)]
        self._width = len(names)
        self._lay_out({name: k for k, name in enumerate(names)}, self._parse)
        for name in (names[key] for key in self._keys):
            if names.count(name) > 1:
                raise LogError("this name is there twice", column=name)
        return False

    def record(self, line: bytes) -> Row:
        fields = line.split(self._separator)
        if b'"' in line:
            fields = [field.encode() for field in self._unquoted(line.decode("utf-8", "replace"))]
        if len(fields) == self._width:
            return self._take(fields)
        # Of a line cut short, the last field may be cut too: no reading counts, and the time
        # only if something follows it.
        fault = f"{len(fields)} fields instead of {self._width}"
        return self._unusable(self._time(fields[:-1]), fault)

    def _unquoted(self, text: str) -> list[str]:
        # A return inside a line would end it for the csv module.
        return next(csv.reader([text.replace("\r", " ")], delimiter=self._separator.decode()))


class NdjsonRecords(_Fields):
    """One JSON object per line; the first shows the names."""

    def _open(self, line: bytes) -> bool:
        try:
            fields = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise LogError(f"not a JSON object: {error}") from error
        if not isinstance(fields, dict):
            raise LogError("not a JSON object")
        self._lay_out({name: name for name in fields}, json_number)
        return True

    def record(self, line: bytes) -> Row:
        try:
            fields = json.loads(line)
        except (ValueError, RecursionError):
            fields = None
        if isinstance(fields, dict):
            return self._take(fields)
        return self._unusable(self._time({}), "not a JSON object")


def plain_number(field: bytes) -> float:
    """A number as sensors print it; Python's own digit groups (``1_000``) are none."""
    if b"_" in field:
        raise ValueError(field)
    return float(field)


def csv_number(decimal: str, missing: Sequence[str]) -> Callable[[bytes], float]:
    """Reads fields with another decimal point, or with words for a missing value."""
    point, words = decimal.encode(), {word.encode() for word in missing}

    def number(field: bytes) -> float:
        if field.strip() in words:
            raise ValueError(field)
        return plain_number(field.replace(point, b"."))

    return number


def json_number(value: Any) -> float:
    """A JSON number; text and booleans are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(value)
    return float(value)
