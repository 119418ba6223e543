"""CSV: one exact reader that can name every fault, and a fast one for long, faultless files."""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Mapping, Sequence
from typing import BinaryIO, NoReturn

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap, Dialect
from thermaltool.logs.table import (
    UNFINISHED,
    Cells,
    InputBytes,
    Kind,
    Values,
    first_faults,
    marked_missing,
    read_columns,
)
from thermaltool.logs.text import row_lines
from thermaltool.record import Array

# Below this the exact reader is done before pyarrow is imported.
FAST_BYTES = 500_000
NAN_WORDS = ("nan", "NaN", "NAN", "Nan")
BOM = b"\xef\xbb\xbf"
GZIP = b"\x1f\x8b"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def open_table(source: InputBytes, mapping: ColumnMap) -> CsvTable:
    """The header of a CSV text, in the dialect of the map."""
    return CsvTable(source, mapping.dialect)


def write_columns(columns: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
    """Write columns as CSV; a missing value is an empty cell."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(columns)
    stream.write(header.getvalue().encode())
    before = ["," if i else "" for i in range(len(columns))]
    # A lone empty cell would be an empty line, which readers skip.
    empty = "" if len(columns) > 1 else '""'
    stream.writelines(row_lines(list(columns.values()), before, "\n", empty))


class CsvTable:
    """A CSV text whose header has been found.

    Lines that start with ``#`` and empty lines are skipped anywhere. The first line that is left
    behind those that the dialect skips names the columns; fields without a name at its end do not
    count. UTF-16 is known by its byte-order mark.

    Raises
    ------
    LogError
        Nothing but comments, bytes of another encoding, no header, or another separator.
    """

    def __init__(self, source: InputBytes, dialect: Dialect) -> None:
        self.file, self.dialect = source.name, dialect
        data = self._utf_8(source.data).removeprefix(BOM)
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if not data.strip():
            raise LogError("the file is empty: a log begins with a line of names", self.file)
        if data.startswith(b"PAR1"):
            raise LogError("this is Parquet, not CSV: use --from parquet", self.file)
        if data.startswith(GZIP):
            raise LogError("compressed: zcat LOG | thermaltool check -", self.file)
        if b"\0" in data:
            self._fail_at(
                data, data.index(b"\0"), "not text: NUL bytes (UTF-16, or a write cut short)"
            )
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            message = f"not UTF-8: byte 0x{data[error.start]:02x} (say encoding = 'cp1252' or the "
            message += "like in a map; check --write-map drafts one)"
            self._fail_at(data, error.start, message)
        self.data = data
        self.complete = data.endswith(b"\n")
        rows = enumerate(io.BytesIO(data), 1)
        header = next(((i, row) for i, row in rows if i > dialect.skip and _counts(row)), None)
        if header is None:
            raise LogError("only comments: a log begins with a line of names", self.file)
        self.header_line, line = header[0], header[1].decode()
        self.names = [name.strip() for name in self._split(line.rstrip("\n"))]
        while len(self.names) > 1 and not self.names[-1]:
            self.names.pop()
        # The last line before the rows.
        self.before_rows = self.header_line + dialect.skip_after_names
        self._check_header(line)

    def _utf_8(self, data: bytes) -> bytes:
        encoding = "utf-16" if data.startswith(UTF_16) else self.dialect.encoding
        if encoding == "utf-8":
            return data
        try:
            return data.decode(encoding).encode()
        except UnicodeError as error:
            raise LogError(f"not {encoding}: {error}", self.file) from error

    def _fail_at(self, data: bytes, offset: int, message: str) -> NoReturn:
        raise LogError(message, self.file, data.count(b"\n", 0, offset) + 1)

    def _check_header(self, line: str) -> None:
        if line.lstrip().startswith("{"):
            raise LogError(
                "this is NDJSON, not CSV: use --from ndjson", self.file, self.header_line
            )
        others = [other for other in ";\t|" if other in line and other != self.dialect.separator]
        if len(self.names) == 1 and others:
            raise LogError(
                f"columns are separated by {others[0]!r}: say separator = {others[0]!r} (and "
                "decimal = ',' where numbers have a comma) in a map for --columns",
                self.file,
                self.header_line,
            )
        if all(_is_number(name) for name in self.names):
            raise LogError(
                "numbers where the names belong: a log begins with a line such as "
                "time_s,T_spindle_degC",
                self.file,
                self.header_line,
            )

    def cells(self, kinds: Sequence[Kind]) -> Cells:
        """The columns as wanted; every fault is a problem with its line and column."""
        fast = self._fast(kinds) if len(self.data) > FAST_BYTES else None
        return fast or self._exact(kinds)

    def _split(self, row: str) -> list[str]:
        if '"' in row:
            with contextlib.suppress(csv.Error):
                return next(csv.reader([row], delimiter=self.dialect.separator))
        return row.split(self.dialect.separator)

    def _exact(self, kinds: Sequence[Kind]) -> Cells:
        rows, lines, ragged = [], [], []
        unfinished = None
        width = len(self.names)
        last = 0
        for last, row in enumerate(io.BytesIO(self.data), 1):
            if last <= self.before_rows or not _counts(row):
                continue
            cells = self._split(row.decode().rstrip("\n"))
            if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
                del cells[width:]
            if len(cells) == width:
                rows.append(cells)
                lines.append(last)
            elif row.endswith(b"\n"):
                ragged.append(LogError(self._ragged(cells, width), self.file, last))
            else:
                unfinished = LogError(UNFINISHED, self.file, last)
        if rows and not self.complete and lines[-1] == last:
            wanted = [cell for cell, kind in zip(rows[-1], kinds, strict=True) if kind == "number"]
            if any(self._number(cell) is None for cell in wanted):
                unfinished = LogError(UNFINISHED, self.file, last)
                del rows[-1], lines[-1]
        columns = list(zip(*rows, strict=True)) if rows else [()] * width
        values, problems = read_columns(
            self.names,
            kinds,
            lambda i, name: self._numbers(name, columns[i], lines),
            lambda i: [cell if cell.strip() else None for cell in columns[i]],
            self.dialect.missing,
        )
        lines_read = np.array(lines, dtype=np.intp)
        return Cells(values, lines_read, first_faults(ragged) + problems, unfinished)

    def _ragged(self, cells: list[str], width: int) -> str:
        message = f"{len(cells)} cells where the header has {width}"
        if len(cells) > width and self.dialect.separator == "," and self.dialect.decimal == ".":
            message += " (numbers with a decimal comma? then the separator must be another)"
        return message

    def _numbers(
        self, name: str, column: Sequence[str], lines: Sequence[int]
    ) -> tuple[Array, list[LogError]]:
        """One column as float64; a cell that is no finite number is NaN and a fault."""
        plain = self.dialect.decimal == "." and not self.dialect.missing
        if plain and not any("_" in cell for cell in column):
            with contextlib.suppress(ValueError):
                values = np.fromiter(map(float, column), np.float64, len(column))
                if not np.isinf(values).any():
                    return values, []
        values = np.empty(len(column))
        faults = []
        for i, cell in enumerate(column):
            number = self._number(cell)
            if number is None:
                word = cell.strip()
                what = "infinite" if _is_number(word) and "_" not in word else "not a number"
                if self.dialect.decimal == "," and "." in word:
                    what = "a point, where decimals have a comma"
                elif "," in word and _is_number(word.replace(",", ".", 1)):
                    what = "a decimal comma (say decimal = ',' in a map for --columns)"
                faults.append(LogError(f"{what}: {word!r}", self.file, lines[i], name))
                number = np.nan
            values[i] = number
        return values, faults

    def _number(self, cell: str) -> float | None:
        """A finite number, NaN where the cell is missing, None where it is neither."""
        word = cell.strip()
        if self.dialect.decimal != ".":
            # A point is one of thousands there.
            cell = "" if "." in cell else cell.replace(self.dialect.decimal, ".")
        try:
            value = float(cell)
        except ValueError:
            return np.nan if not word or word in self.dialect.missing else None
        # Python reads 1_000 as a number; no logger writes that.
        if value in (np.inf, -np.inf) or "_" in cell:
            return None
        return np.nan if word in self.dialect.missing else value

    def _fast(self, kinds: Sequence[Kind]) -> Cells | None:
        """The same by pyarrow; None where anything calls for the exact reader."""
        try:
            import pyarrow
            from pyarrow import csv as arrow_csv
        except ImportError:  # an install without extras
            return None

        first = self.before_rows
        start = _offset(self.data, first)
        count = self.data.count(b"\n", start)
        if self.data.find(b"#", start) >= 0 or not self.complete or not count:
            return None
        wanted = {str(i): kind for i, kind in enumerate(kinds) if kind}
        types = {"number": pyarrow.float64(), "text": pyarrow.string()}
        try:
            table = arrow_csv.read_csv(
                pyarrow.BufferReader(memoryview(self.data)[start:]),
                read_options=arrow_csv.ReadOptions(
                    column_names=[str(i) for i in range(len(self.names))]
                ),
                parse_options=arrow_csv.ParseOptions(delimiter=self.dialect.separator),
                convert_options=arrow_csv.ConvertOptions(
                    column_types={name: types[kind] for name, kind in wanted.items()},
                    include_columns=list(wanted),
                    null_values=["", *NAN_WORDS, *self.dialect.missing],
                    strings_can_be_null=True,
                    decimal_point=self.dialect.decimal,
                ),
            )
        except pyarrow.ArrowInvalid:
            return None
        # Fewer rows than lines: there are empty lines or line ends in quotes.
        if table.num_rows != count:
            return None
        values: Values = []
        for i, kind in enumerate(kinds):
            if kind == "number":
                array = table[str(i)].to_numpy().astype(np.float64, copy=False)
                if np.isinf(array).any():
                    return None
                values.append(marked_missing(array, self.dialect.missing))
            else:
                values.append(table[str(i)].to_pylist() if kind else None)
        return Cells(values, np.arange(first + 1, first + 1 + count))


def _counts(row: bytes) -> bool:
    """Whether a line belongs to the table: neither empty nor a comment."""
    row = row.strip()
    return bool(row) and not row.startswith(b"#")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _offset(data: bytes, lines: int) -> int:
    """Where the line after the first `lines` begins."""
    position = 0
    for _ in range(lines):
        position = data.find(b"\n", position) + 1
    return position
