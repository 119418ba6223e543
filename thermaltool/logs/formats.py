"""The formats of whole tables: a new one is one module beside this one, and one line in `FORMATS`.

The table costs no import: a format's module, and what that needs, is loaded when it is used.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Protocol, cast

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


class FormatModule(Protocol):
    """What the module of a format provides."""

    def open_table(self, source: InputBytes, mapping: ColumnMap) -> Table:
        """The header of an input; LogError where it is none of this format."""

    def write_columns(self, columns: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
        """Write columns of one length, integers or finite floats and NaN for what is missing."""


FORMATS: dict[str, TableFormat] = {
    "csv": TableFormat("thermaltool.logs.csv_table", (".csv", ".txt")),
    "ndjson": TableFormat("thermaltool.logs.ndjson_table", (".ndjson", ".jsonl")),
    "parquet": TableFormat("thermaltool.logs.parquet_table", (".parquet",)),
}
# The format of a pipe, and of a file with another suffix.
DEFAULT_FORMAT = "csv"


def format_of(target: str, chosen: str | None) -> str:
    """The format of a file or pipe: as chosen, else by suffix, else CSV."""
    suffix = os.path.splitext(target)[1].lower()
    by_suffix = (name for name, form in FORMATS.items() if suffix in form.suffixes)
    return chosen or next(by_suffix, DEFAULT_FORMAT)


def load_format(name: str) -> FormatModule:
    """The module that reads and writes a format.

    Raises
    ------
    ValueError
        Not one of `FORMATS`.
    """
    if name not in FORMATS:
        raise ValueError(f"no format {name!r}: there are {', '.join(FORMATS)}")
    return cast(FormatModule, importlib.import_module(FORMATS[name].module))
