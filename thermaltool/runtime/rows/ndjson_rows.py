"""NDJSON lines: one JSON object each, the first of which shows the names."""

from __future__ import annotations

import json
from typing import Any

from thermaltool.errors import LogError
from thermaltool.runtime.rows.row import Row, RowReader


class NdjsonRows(RowReader):
    """One JSON object per line; the first shows the names.

    Keys of an object in an object are ``outer.inner``, as in logs.
    """

    _nested = False

    def _open(self, line: bytes) -> bool:
        try:
            fields = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise LogError(f"not a JSON object: {error}") from error
        if not isinstance(fields, dict):
            raise LogError("not a JSON object")
        self._nested = any(isinstance(value, dict | list) for value in fields.values())
        fields = self._flat(fields)
        self._lay_out({name: name for name in fields}, json_number)
        return True

    def _flat(self, fields: dict[str, Any]) -> dict[str, Any]:
        return _ndjson_table().flat(fields) if self._nested else fields

    def row(self, line: bytes) -> Row:
        """The row in a line; of one that is no JSON object no reading counts."""
        try:
            fields = json.loads(line)
        except (ValueError, RecursionError):
            fields = None
        if isinstance(fields, dict):
            return self._take(self._flat(fields))
        return self._unusable(self._time({}), "not a JSON object")


def _ndjson_table() -> Any:
    # Imported for nested objects alone: the package reads whole logs, a stream starts without it.
    from thermaltool.logs import ndjson_table

    return ndjson_table


def json_number(value: Any) -> float:
    """A JSON number; text and booleans are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(value)
    return float(value)
