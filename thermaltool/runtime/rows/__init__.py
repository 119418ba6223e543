"""Lines of a stream to rows: a new format is one file in this folder and one line in the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thermaltool.runtime.registry import load

if TYPE_CHECKING:
    from thermaltool.runtime.rows.layout import Wanted
    from thermaltool.runtime.rows.merger import Merger
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


# Messages that arrive within so much of a period are of one row.
HALF = 0.5


def merger_of(wanted: Wanted, period: float) -> Merger | None:
    """What makes rows of messages of one time; None where each line is a row.

    Parameters
    ----------
    wanted : Wanted
    period : float [s]
        How long it waits for the rest of a row.
    """
    if not wanted.merges:
        return None
    # Imported where it is asked for: a stream starts without the package that reads logs.
    from thermaltool.runtime.rows.merger import Merger

    assert wanted.mapping is not None
    within = wanted.mapping.clock.within if wanted.mapping.clock is not None else 0.0
    if wanted.clock is not None and not within:
        # By the time of arrival no two messages are of one time.
        within = HALF * period
    return Merger(len(wanted.sensors), within, wanted.mapping.duplicates == "mean", period)
