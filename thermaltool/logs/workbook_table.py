"""Workbooks of Excel (.xlsx), by openpyxl."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import islice
from typing import Any

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.formats import load_library
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.table import InputBytes
from thermaltool.record import hint


def open_table(source: InputBytes, mapping: ColumnMap) -> FrameTable:
    """The rows of a sheet below its names: that of the map, else the first that has rows.

    The names are the first row behind those that the map skips with a text in it.

    Raises
    ------
    LogError
        openpyxl is not installed; no workbook; no such sheet; no row of names.
    """
    import pandas

    rows = list(enumerate(sheet_rows(source, mapping.table), 1))
    dialect = mapping.dialect
    head = next((k for k, row in rows[dialect.skip :] if any(_filled(cell) for cell in row)), None)
    if head is None:
        raise LogError("no row of names", source.name)
    names = ["" if cell is None else str(cell).strip() for cell in rows[head - 1][1]]
    while len(names) > 1 and not names[-1]:
        names.pop()
    body = [
        (k, row) for k, row in rows[head + dialect.skip_after_names :] if any(map(_filled, row))
    ]
    cells = [[*row, *[None] * len(names)][: len(names)] for _, row in body]
    frame = pandas.DataFrame(cells, columns=range(len(names)), dtype=object)
    frame.columns = pandas.Index(names)
    return FrameTable(
        frame,
        dialect.missing,
        file=source.name,
        lines=[k for k, _ in body],
        header_line=head,
        decimal=dialect.decimal,
    )


def sheet_rows(source: InputBytes, sheet: str | None, count: int | None = None) -> list[Any]:
    """The cells of a sheet, row by row: tuples of numbers, texts, times and None.

    Raises
    ------
    LogError
        As `open_table`.
    """
    library = load_library("openpyxl", source.name)
    try:
        book = library.load_workbook(io.BytesIO(source.data), read_only=True, data_only=True)
        names: Sequence[str] = [each.title for each in book.worksheets]
        if sheet is not None and sheet not in names:
            raise LogError(f"no sheet {sheet}{hint(sheet, names)}", source.name)
        for name in names if sheet is None else [sheet]:
            rows = list(islice(book[name].iter_rows(values_only=True), count))
            if len(rows) > 1 or name == sheet:
                return rows
        return []
    except LogError:
        raise
    except Exception as error:  # whatever a damaged file makes of the library
        raise LogError(f"truncated, or no workbook: {error}", source.name) from error


def _filled(cell: Any) -> bool:
    return cell is not None and str(cell).strip() != ""
