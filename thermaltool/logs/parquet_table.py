"""Parquet; its rows are counted from 1 where other formats have lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import BinaryIO

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.table import Cells, InputBytes, Kind, read_columns, without_infinity
from thermaltool.record import Array


def open_table(source: InputBytes, mapping: ColumnMap) -> ParquetTable:
    """The columns of a Parquet file; of the dialect of the map the words for missing values."""
    return ParquetTable(source, mapping.dialect.missing)


def write_columns(columns: Mapping[str, np.ndarray], stream: BinaryIO) -> None:
    """Write columns as Parquet; a missing value is null."""
    import pyarrow
    from pyarrow import parquet

    table = {name: pyarrow.array(array, from_pandas=True) for name, array in columns.items()}
    parquet.write_table(pyarrow.table(table), stream)


class ParquetTable:
    """A Parquet file, complete in memory.

    Raises
    ------
    LogError
        Truncated, or no Parquet at all.
    """

    header_line = None

    def __init__(self, source: InputBytes, missing: Sequence[str] = ()) -> None:
        import pyarrow
        from pyarrow import parquet

        self.file, self._missing = source.name, missing
        if not source.data:
            raise LogError("the file is empty", self.file)
        try:
            self.table = parquet.read_table(pyarrow.BufferReader(source.data))
            self.names = [str(name) for name in self.table.column_names]
        except (pyarrow.ArrowException, OSError, ValueError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise LogError(f"truncated, or not Parquet: {reason}", self.file) from error

    def cells(self, kinds: Sequence[Kind]) -> Cells:
        """The columns as wanted; every fault is a problem with its row and column."""
        values, problems = read_columns(self.names, kinds, self._numbers, self._text, self._missing)
        return Cells(values, np.arange(1, self.table.num_rows + 1), problems)

    def _text(self, i: int) -> list[str | None]:
        import pyarrow

        column = self.table.column(i)
        try:
            stamps: list[str | None] = column.cast("string").to_pylist()
        except pyarrow.ArrowException:  # lists and the like
            stamps = [None] * len(column)
        return stamps

    def _numbers(self, i: int, name: str) -> tuple[Array, list[LogError]]:
        import pyarrow

        column = self.table.column(i)
        numeric = (
            pyarrow.types.is_null(column.type)
            or pyarrow.types.is_integer(column.type)
            or pyarrow.types.is_floating(column.type)
            or pyarrow.types.is_decimal(column.type)
        )
        if not numeric:
            error = LogError(f"not a number: the column holds {column.type}", self.file, None, name)
            return np.full(len(column), np.nan), [error]
        array = column.cast("float64", safe=False).to_numpy().astype(np.float64, copy=False)
        return without_infinity(array, self.file, name)
