"""NDJSON lines: one JSON object each, the first of which shows the names."""

from __future__ import annotations

import json
from typing import Any

from thermaltool.errors import LogError
from thermaltool.parsing import unique_keys
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.runtime.rows.row import Row, RowReader


class NdjsonRows(RowReader):
    """One JSON object per line; the first shows the names.

    Keys of an object in an object are ``outer.inner``, as in logs. Where a map says that lines are
    messages of one sensor each, or that they make rows together, the first has the clock alone.
    """

    _nested = False

    def __init__(self, wanted: Wanted) -> None:
        super().__init__(wanted)
        self._messages = wanted.mapping.messages if wanted.mapping else None

    def _open(self, line: bytes) -> bool:
        try:
            fields = json.loads(line, object_pairs_hook=unique_keys)
        except (ValueError, RecursionError) as error:
            raise LogError(f"not a JSON object: {error}") from error
        if not isinstance(fields, dict):
            raise LogError("not a JSON object")
        if self._messages is not None and self.wanted.counts_lines:
            raise LogError("messages of one sensor each are no periods: they need a clock")
        self._nested = self.wanted.merges or any(
            isinstance(value, dict | list) for value in fields.values()
        )
        fields = self._flat(fields)
        names = [*fields]
        if self.wanted.merges and (mapping := self.wanted.mapping) is not None:
            names += self.wanted.sensors if mapping.unmapped == "keep" else ()
            names += mapping.columns
        try:
            self._lay_out({name: name for name in names}, json_number)
        except LogError as error:
            if self._messages is None and _ndjson_table().message_keys(fields) is not None:
                raise LogError(
                    f"{error.message}; messages of one sensor each take a map with [messages]",
                    column=error.column,
                ) from error
            raise
        return True

    def _flat(self, fields: dict[str, Any]) -> dict[str, Any]:
        if not self._nested:
            return fields
        table = _ndjson_table()
        return dict(table.of_messages(table.flat(fields), self._messages))

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
