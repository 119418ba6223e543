"""The formats of whole tables: a new one is one module beside this one, and one line in `FORMATS`.

The table costs no import: a format's module, and what that needs, is loaded when it is used.
"""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, Protocol, cast

from thermaltool.errors import LogError, OutputError

if TYPE_CHECKING:
    import numpy as np

    from thermaltool.logs.columns import ColumnMap
    from thermaltool.logs.table import InputBytes, Table


class TableFormat(NamedTuple):
    """A format of tables.

    Attributes
    ----------
    module : str
        Where its `FormatModule` is.
    suffixes : tuple of str
        Of files that have this format where nobody says otherwise.
    """

    module: str
    suffixes: tuple[str, ...]


class ReaderModule(Protocol):
    """What the module of a format provides that is read."""

    def open_table(self, source: InputBytes, mapping: ColumnMap) -> Table:
        """The header of an input; LogError where it is none of this format."""


class FormatModule(ReaderModule, Protocol):
    """What the module of a format provides that is read and written."""

    def write_columns(self, columns: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
        """Write columns of one length, integers or finite floats and NaN for what is missing."""


FORMATS: dict[str, TableFormat] = {
    "csv": TableFormat("thermaltool.logs.csv_table", (".csv", ".txt")),
    "ndjson": TableFormat("thermaltool.logs.ndjson_table", (".ndjson", ".jsonl")),
    "parquet": TableFormat("thermaltool.logs.parquet_table", (".parquet",)),
}
# What other programs write: read, and never written.
FOREIGN: dict[str, TableFormat] = {
    "json": TableFormat("thermaltool.logs.json_table", (".json",)),
    "klippy": TableFormat("thermaltool.logs.klippy_table", ()),
    "lvm": TableFormat("thermaltool.logs.lvm_table", (".lvm",)),
    "mat": TableFormat("thermaltool.logs.matlab_table", (".mat",)),
    "tdms": TableFormat("thermaltool.logs.tdms_table", (".tdms",)),
    "xlsx": TableFormat("thermaltool.logs.workbook_table", (".xlsx", ".xlsm")),
}
READABLE = {**FORMATS, **FOREIGN}
# The format of a pipe, and of a file with another suffix.
DEFAULT_FORMAT = "csv"
# How the bytes of a format begin, whatever the file is called.
_BEGINNINGS = {
    b"PK\x03\x04": "xlsx",
    b"TDSm": "tdms",
    b"MATLAB ": "mat",
    b"\x89HDF\r\n": "mat",
    b"LabVIEW Measurement": "lvm",
}
# A line that klippy.log has every second; before the first stand the settings of the printer,
# at most so many bytes.
MAX_PREAMBLE = 2**22
_STATS = re.compile(rb"^(?:[-\d]{4,10} [:.\d]{5,15}:)?Stats \d+\.\d+: ", re.MULTILINE)


def format_of(target: str, chosen: str | None) -> str:
    """The format of a file or pipe: as chosen, else by suffix, else CSV."""
    return chosen or _by_suffix(target, FORMATS) or DEFAULT_FORMAT


def written_format_of(target: str, chosen: str | None) -> str:
    """The format of a table that is written; as `format_of`.

    Raises
    ------
    OutputError
        By its suffix the file would be of a format that is not written.
    """
    suffix = os.path.splitext(target)[1].lower()
    others = {each for form in FOREIGN.values() for each in form.suffixes} | {".xls", ".gz", ".zip"}
    if chosen is None and suffix in others - {
        each for f in FORMATS.values() for each in f.suffixes
    }:
        known = ", ".join(FORMATS)
        raise OutputError(f"{target}: no {suffix} is written, but {known}; --to says which")
    return format_of(target, chosen)


def read_format_of(source: InputBytes, chosen: str | None) -> str:
    """The format of an input: as chosen, else by how it begins, else by suffix, else CSV."""
    if chosen is not None:
        return chosen
    begun = next((f for start, f in _BEGINNINGS.items() if source.data.startswith(start)), None)
    if begun is None and (form := _by_suffix(source.name, {**READABLE, **FORMATS})) is not None:
        return form
    return begun or ("klippy" if _STATS.search(source.data, 0, MAX_PREAMBLE) else DEFAULT_FORMAT)


def load_reader(source: InputBytes, chosen: str | None) -> ReaderModule:
    """The module that reads an input.

    Raises
    ------
    ValueError
        Not one of `READABLE`.
    """
    return _load(read_format_of(source, chosen), READABLE)


def load_format(name: str) -> FormatModule:
    """The module that reads and writes a format.

    Raises
    ------
    ValueError
        Not one of `FORMATS`.
    """
    return cast(FormatModule, _load(name, FORMATS))


def load_library(name: str, file: str) -> Any:
    """A library of the extra ``formats``.

    Raises
    ------
    LogError
        It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        message = f"needs {name.partition('.')[0]}: pip install 'thermaltool[formats]'"
        raise LogError(message, file) from error


def _by_suffix(target: str, formats: Mapping[str, TableFormat]) -> str | None:
    suffix = os.path.splitext(target)[1].lower()
    return next((name for name, form in formats.items() if suffix in form.suffixes), None)


def _load(name: str, formats: Mapping[str, TableFormat]) -> ReaderModule:
    # A format that was added to those that are written is read, too.
    known = {**formats, **FORMATS}
    if name not in known:
        raise ValueError(f"no format {name!r}: there are {', '.join(known)}")
    return cast(ReaderModule, importlib.import_module(known[name].module))
