"""Whole JSON documents: lists of objects, lists by name, answers of Moonraker."""

from __future__ import annotations

from typing import Any

from thermaltool.documents import NOUNS
from thermaltool.errors import LogError, ModelError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.ndjson_table import NdjsonTable, flat, of_messages
from thermaltool.logs.table import InputBytes, Table
from thermaltool.parsing import parse_json

# A list by name is a column from so many values on; shorter ones are settings.
MIN_VALUES = 2


def open_table(source: InputBytes, mapping: ColumnMap) -> Table:
    """The columns of a JSON document; one JSON object in each line is NDJSON.

    Moonraker answers ``/server/temperature_store`` with lists by sensor: their last values are of
    one time, as is that of every list that is shorter.

    Raises
    ------
    LogError
        No JSON, or nothing like a table in it.
    """
    import pandas

    text = source.data.decode(errors="replace").lstrip("\ufeff")
    try:
        document = parse_json(text, source.name)
    except ModelError as error:
        first = text.lstrip().partition("\n")[0].strip()
        if first.startswith("{") and first.endswith("}"):
            return NdjsonTable(source, mapping.dialect.missing, mapping.messages)
        raise LogError(str(error).removeprefix(f"{source.name}: "), source.name) from error
    own = str(document.get("format", "")) if isinstance(document, dict) else ""
    if own in NOUNS:
        raise LogError(f"{NOUNS[own]}, no log", source.name)
    records = document if isinstance(document, list) else None
    if records is None and isinstance(document, dict):
        columns = {name: values for name, values in _lists(document) if len(values) >= MIN_VALUES}
        tables = [each for each in columns.values() if all(isinstance(v, dict) for v in each)]
        if tables:
            records = max(tables, key=len)
        elif columns:
            length = max(map(len, columns.values()))
            padded = {k: [None] * (length - len(v)) + v for k, v in columns.items()}
            frame = pandas.DataFrame(padded, dtype=object)
            return FrameTable(frame, mapping.dialect.missing, file=source.name)
        else:
            records = [document]
    if not records or not all(isinstance(each, dict) for each in records):
        raise LogError("no table: neither objects in a list nor lists by name", source.name)
    rows = [of_messages(flat(each), mapping.messages) for each in records]
    frame = pandas.DataFrame(rows, dtype=object)
    return FrameTable(frame, mapping.dialect.missing, file=source.name)


def _lists(value: Any, prefix: str = "") -> list[tuple[str, list[Any]]]:
    """The lists in a document, by their keys; ``result``, which holds an answer, is none."""
    found: list[tuple[str, list[Any]]] = []
    for key, part in value.items():
        name = prefix if key == "result" and not prefix else f"{prefix}{key}"
        if isinstance(part, list):
            found.append((name, part))
        elif isinstance(part, dict):
            found += _lists(part, f"{name}." if name else "")
    return found
