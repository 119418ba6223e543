"""The table in an input, opened as its column map says, or as it stands where it is mapped."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, TypeAlias

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.formats import load_reader
from thermaltool.logs.table import InputBytes, Table, read_source

if TYPE_CHECKING:
    import pandas

    TableSource: TypeAlias = str | os.PathLike[str] | pandas.DataFrame


def open_source(
    source: TableSource, from_format: str | None, mapping: ColumnMap
) -> tuple[str, str, Table]:
    """The name and digest of an input, and its table."""
    if isinstance(source, str | os.PathLike):
        raw = read_source(os.fspath(source))
        return raw.name, raw.digest, _table(raw, from_format, mapping)
    from thermaltool.logs.frame_table import FrameTable

    frame = FrameTable(source, mapping.dialect.missing)
    return frame.file, frame.digest, frame


def open_mapped(
    source: TableSource, from_format: str | None, mapping: ColumnMap
) -> tuple[str, str, Table, ColumnMap]:
    """As `open_source`, with the map that applies: none where the columns are mapped already.

    Such a table is what ``check -o`` writes: CSV of the tool's own, or Parquet.

    Raises
    ------
    LogError
        The map names a column that the table does not have, or the table cannot be opened.
    """
    if not isinstance(source, str | os.PathLike):
        name, digest, table = open_source(source, from_format, mapping)
        applied = ColumnMap() if mapping.named_already(table.names) else mapping
        applied.check(table.names, name)
        return name, digest, table, applied
    raw = read_source(os.fspath(source))
    plain: Table | None
    try:
        table = _table(raw, from_format, mapping)
        mapping.check(table.names, raw.name)
    except LogError:
        try:
            plain = _table(raw, from_format, ColumnMap())
        except LogError:
            plain = None
        if plain is None or not mapping.named_already(plain.names):
            raise
        return raw.name, raw.digest, plain, ColumnMap()
    return raw.name, raw.digest, table, mapping


def _table(raw: InputBytes, from_format: str | None, mapping: ColumnMap) -> Table:
    return load_reader(raw, from_format).open_table(raw, mapping)
