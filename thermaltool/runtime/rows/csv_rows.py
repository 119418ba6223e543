"""CSV lines: the first one names the columns."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence

from thermaltool.errors import LogError
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.runtime.rows.row import Row, RowReader


class CsvRows(RowReader):
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

    def row(self, line: bytes) -> Row:
        """The row in a line; of one with too many or too few fields no reading counts."""
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
