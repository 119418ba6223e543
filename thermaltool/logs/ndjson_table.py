"""NDJSON: one JSON object per line, null where a value is missing."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any, BinaryIO

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap, SensorMessages
from thermaltool.logs.table import (
    UNFINISHED,
    Cells,
    InputBytes,
    Kind,
    first_faults,
    read_columns,
)
from thermaltool.logs.text import row_lines
from thermaltool.parsing import unique_keys
from thermaltool.record import Array

# Keys of messages of one sensor each, in lower case and without what they are nested in.
_NAME_KEYS = ("sensor", "name", "topic", "channel", "id", "sensor_id", "key", "device")
_VALUE_KEYS = ("value", "val", "reading", "v", "temperature", "temp", "payload")
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?")


def open_table(source: InputBytes, mapping: ColumnMap) -> NdjsonTable:
    """The objects of an NDJSON text; of the dialect of the map the words for missing values."""
    return NdjsonTable(source, mapping.dialect.missing, mapping.messages)


def write_columns(columns: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
    """Write columns as NDJSON; a missing value is null."""
    keys = [json.dumps(name, ensure_ascii=False) + ": " for name in columns]
    before = [("{" if i == 0 else ", ") + key for i, key in enumerate(keys)]
    stream.writelines(row_lines(list(columns.values()), before, "}\n", "null"))


def flat(record: dict[str, Any]) -> dict[str, Any]:
    """An object without objects and lists in it: ``{"a": {"b": 1}}`` is ``{"a.b": 1}``."""
    if not any(isinstance(value, dict | list) for value in record.values()):
        return record
    found: dict[str, Any] = {}
    open_parts: list[tuple[str, Any]] = [("", record)]
    while open_parts:
        name, value = open_parts.pop()
        if isinstance(value, dict | list):
            parts = value.items() if isinstance(value, dict) else enumerate(value)
            prefix = f"{name}." if name else ""
            open_parts += reversed([(f"{prefix}{key}", part) for key, part in parts])
        else:
            found[name] = value
    return found


def message_keys(names: Iterable[str]) -> SensorMessages | None:
    """The keys that name and value a sensor in messages of one sensor each; None for other lines.

    Parameters
    ----------
    names : iterable of str
        The keys of all lines.
    """
    keys = list(names)
    named = [name for name in keys if name.lower().rpartition(".")[2] in _NAME_KEYS]
    valued = [name for name in keys if name.lower().rpartition(".")[2] in _VALUE_KEYS]
    return SensorMessages(named[0], valued[0]) if named and valued else None


def of_messages(record: dict[str, Any], messages: SensorMessages | None) -> dict[str, Any]:
    """A message ``{"sensor": "bed", "value": 60.1}`` as ``{"bed": 60.1}``; others as they are.

    Brokers pass payloads on as text: a number in it counts.
    """
    if messages is None or messages.name not in record or messages.value not in record:
        return record
    name, value = str(record[messages.name]), record[messages.value]
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        value = float(value)
    kept = {k: v for k, v in record.items() if k not in (messages.name, messages.value)}
    # A sensor that is called as the clock or another key takes nothing from it.
    return {name: value, **kept}


class NdjsonTable:
    """Lines of JSON objects; the names are their keys in order of appearance.

    Keys of an object in an object are ``outer.inner``, those of a list ``list.0`` and so on. Where
    each line is a message of one sensor, `messages` says which of its keys name and value it.

    Raises
    ------
    LogError
        No lines at all, or bytes that are not UTF-8.
    """

    header_line = None

    def __init__(
        self,
        source: InputBytes,
        missing: Sequence[str] = (),
        messages: SensorMessages | None = None,
    ) -> None:
        self.file, self._missing = source.name, missing
        self.lines: list[int] = []
        self.faults: list[LogError] = []
        self.unfinished: LogError | None = None
        self.records: list[tuple[Any, ...]] = []
        names: tuple[str, ...] = ()
        keys: tuple[str, ...] = ()
        # Integers as floats: one too long for a float becomes infinite, not an OverflowError.
        decode = json.JSONDecoder(parse_int=float, object_pairs_hook=unique_keys).decode
        for line, row in enumerate(io.BytesIO(source.data.removeprefix(b"\xef\xbb\xbf")), 1):
            if not row.strip() or row.startswith(b"#"):
                continue
            try:
                record = decode(row.decode())
                if not isinstance(record, dict):
                    raise ValueError("something else")
                if tuple(record) != keys:
                    "".join(record).encode()  # half a surrogate pair is no name
                    keys = tuple(record)
            except (ValueError, RecursionError) as error:
                if row.endswith(b"\n"):
                    self.faults.append(LogError(f"not a JSON object: {error}", self.file, line))
                else:
                    self.unfinished = LogError(UNFINISHED, self.file, line)
                continue
            record = of_messages(flat(record), messages)
            if tuple(record) != names:
                names = tuple(dict.fromkeys([*names, *record]))
                record = {name: record.get(name) for name in names}
            self.records.append(tuple(record.values()))
            self.lines.append(line)
        self.names = list(names)
        if not self.records:
            raise self.faults[0] if self.faults else LogError("the file is empty", self.file)

    def cells(self, kinds: Sequence[Kind]) -> Cells:
        """The columns as wanted; every fault is a problem with its line and column."""
        columns = list(zip_longest(*self.records))
        values, problems = read_columns(
            self.names,
            kinds,
            lambda i, name: self._numbers(name, columns[i]),
            lambda i: [None if cell is None else str(cell) for cell in columns[i]],
            self._missing,
        )
        lines = np.array(self.lines, dtype=np.intp)
        return Cells(values, lines, first_faults(self.faults) + problems, self.unfinished)

    def _numbers(self, name: str, column: Sequence[Any]) -> tuple[Array, list[LogError]]:
        if {float, type(None)}.issuperset(map(type, column)):
            values = np.array(column, dtype=np.float64)
            if not np.isinf(values).any():
                return values, []
        values = np.full(len(column), np.nan)
        faults = []
        for i, cell in enumerate(column):
            if type(cell) is float and abs(cell) != np.inf:
                values[i] = cell
            elif cell is not None and cell not in self._missing:
                what = "infinite" if type(cell) is float else "not a number"
                faults.append(self._fault(what, name, i, cell))
        return values, faults

    def _fault(self, what: str, name: str, i: int, cell: Any) -> LogError:
        return LogError(f"{what}: {json.dumps(cell)}", self.file, self.lines[i], name)
