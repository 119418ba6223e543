"""Lines of a stream to rows: a new format is one file in this folder and one line in the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermaltool.runtime.registry import load

if TYPE_CHECKING:
    from thermaltool.runtime.rows.layout import Wanted
    from thermaltool.runtime.rows.row import RowReader

ROW_FORMATS = {
    "csv": "thermaltool.runtime.rows.csv_rows:CsvRows",
    "ndjson": "thermaltool.runtime.rows.ndjson_rows:NdjsonRows",
}


def open_rows(form: str, wanted: Wanted) -> RowReader:
    """The reader of one format; nothing is read yet.

    Raises
    ------
    ValueError
        A stream cannot read this format.
    """
    reader: RowReader = load(ROW_FORMATS, form, "a stream reads lines, not")(wanted)
    return reader
