"""CSV lines: the first one names the columns."""

from __future__ import annotations

import csv
from codecs import BOM_UTF16_BE, BOM_UTF16_LE, lookup
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from thermaltool.errors import LogError, counted
from thermaltool.parsing import numbers_among
from thermaltool.runtime.clocks import ColumnClock, StampClock
from thermaltool.runtime.rows.layout import Wanted
from thermaltool.runtime.rows.row import Row, RowReader

if TYPE_CHECKING:
    from thermaltool.logs.columns import Dialect

# What each field of a CSV line is told apart by; an encoding of streams has them as single bytes.
PLAIN_BYTES = b" ,;\t\n0"


class CsvRows(RowReader):
    """CSV: the first line names the columns."""

    def __init__(self, wanted: Wanted) -> None:
        super().__init__(wanted)
        self._speak(wanted.mapping.dialect if wanted.mapping else None)
        self._width = 0
        self._names: list[str] = []
        self._known: set[bytes] = set()
        self._blind = ""
        self._behind_names = 0

    def skips(self, line: bytes, number: int) -> bool:
        if self.clock is not None:
            self._behind_names -= 1
            return self._behind_names >= 0
        mapping = self.wanted.mapping
        if mapping is None or number > mapping.dialect.skip:
            return False
        # The names of channels are a header, whatever the map says of another log.
        return not mapping.named_already(line.decode(self._encoding, "replace").strip().split(","))

    def _speak(self, dialect: Dialect | None) -> None:
        # A byte-order mark is before the first line alone.
        given = lookup(dialect.encoding if dialect else "utf-8").name
        self._encoding = given.removesuffix("-sig")
        self._separator = dialect.separator.encode() if dialect else b","
        self._after_names = dialect.skip_after_names if dialect else 0
        self._parse: Callable[[bytes], float] = plain_number
        if dialect:
            self._parse = csv_number(dialect.decimal, dialect.missing, self._encoding)

    def _open(self, line: bytes) -> bool:
        if line.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) or not plain_bytes(self._encoding):
            raise LogError(
                "in UTF-16 or the like, whose lines a stream does not find: "
                "iconv -f UTF-16 -t UTF-8 before it"
            )
        try:
            text = line.decode(self._encoding)
        except UnicodeDecodeError as error:
            name = self._encoding.upper()
            raise LogError(
                f"not {name}: byte 0x{line[error.start]:02x} (a map for --columns says another "
                "encoding)"
            ) from error
        if text.lstrip().startswith("{"):
            raise LogError("this is NDJSON, not CSV: use --from ndjson")
        mapping = self.wanted.mapping
        if mapping is not None and mapping.named_already(text.strip().split(",")):
            self._speak(None)
        names = [name.strip() for name in self._unquoted(text)]
        while len(names) > 1 and not names[-1]:
            names.pop()
        keys = self._lay_out({name: k for k, name in enumerate(names)}, self._parse)
        of_clock = [self.clock.key] if isinstance(self.clock, ColumnClock | StampClock) else []
        for name in (names[key] for key in (*of_clock, *keys)):
            if names.count(name) > 1:
                raise LogError("this name is there twice", column=name)
        self._names, self._width, self._blind = names, len(names), ""
        self._behind_names = self._after_names
        if (mapping := self.wanted.mapping) is not None:
            channels = [each.name for name in names if (each := mapping.rename(name))]
            for sensor in self.wanted.sensors:
                if channels.count(sensor) > 1:
                    raise LogError(f"two columns are mapped to {sensor}")
        mapped = {} if mapping is None else mapping.columns
        known = ("time", "time_s", *names, *mapped, *(r.name for r in mapped.values() if r))
        self._known = {name.encode(self._encoding, "replace") for name in known if name}
        return False

    def reopen(self, line: bytes, last: float | None) -> str:
        message = super().reopen(line, last)
        self._behind_names = self._after_names
        return message

    def row(self, line: bytes) -> Row:
        """The row in a line; one with too many or too few fields counts for nothing."""
        fields = line.split(self._separator)
        if b'"' in line:
            fields = [
                field.encode(self._encoding, "replace")
                for field in self._unquoted(line.decode(self._encoding, "replace"))
            ]
        if len(fields) > self._width and not any(map(bytes.strip, fields[self._width :])):
            del fields[self._width :]
        if len(fields) != self._width:
            # Any field may be another's; a clock that needs none goes on.
            return self._unusable(
                self._time([]), f"{counted(len(fields), 'field')} instead of {self._width}"
            )
        if self._blind:
            return self._unusable(self._time(fields), self._blind)
        return self._take(fields)

    def is_header(self, line: bytes) -> bool:
        """Whether a line names columns: one that this log has, or that a map gives or takes.

        A header may lack what is read.
        """
        fields = line.split(self._separator)
        return any(field.strip(b' "') in self._known for field in fields)

    def _same_header(self, line: bytes) -> bool:
        names = [name.strip() for name in self._unquoted(line.decode(self._encoding, "replace"))]
        return names == self._names and not self._blind

    def _unquoted(self, text: str) -> list[str]:
        # A return inside a line would end it for the csv module.
        return next(csv.reader([text.replace("\r", " ")], delimiter=self._separator.decode()))


def plain_bytes(encoding: str) -> bool:
    """Whether an encoding writes ASCII as ASCII: each line ends where a byte says so."""
    return PLAIN_BYTES.decode().encode(encoding) == PLAIN_BYTES


def plain_number(field: bytes) -> float:
    """A number as sensors print it; Python's own digit groups (``1_000``) are none."""
    if b"_" in field:
        raise ValueError(field)
    return float(field)


def csv_number(decimal: str, missing: Sequence[str], encoding: str) -> Callable[[bytes], float]:
    """Reads fields with another decimal point, or with words for a missing value."""
    point, words = decimal.encode(), {word.encode(encoding, "replace") for word in missing}
    numbers = set(numbers_among(missing))

    def number(field: bytes) -> float:
        if field.strip() in words or (point != b"." and b"." in field):  # a point of thousands
            raise ValueError(field)
        value = plain_number(field.replace(point, b"."))
        if value in numbers:
            raise ValueError(field)
        return value

    return number
