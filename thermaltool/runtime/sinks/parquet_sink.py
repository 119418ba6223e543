"""Replies as one Parquet file: a recording, complete when the stream ends."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from thermaltool.status import WORDS

if TYPE_CHECKING:
    from thermaltool.runtime.process import Reply
    from thermaltool.runtime.sinks import ByteOutput

# Replies that are kept before they go out as a row group: bounds the memory of a stream that runs
# for days, and is long enough to be compressed well [rows].
ROW_GROUP = 50_000


class ParquetSink:
    """Row groups as they fill, the footer at the end, without which nobody can read the file.

    A missing time is null. Nothing of a reply is out at once: this is no sink for an actuator.
    """

    def __init__(self, output: ByteOutput) -> None:
        self._file = _Forward(output)
        self._rows: list[Reply] = []
        self._writer: Any = None

    def open(self, names: Sequence[str]) -> None:
        """The schema: a column of numbers for each name, and of texts for time stamps."""
        import pyarrow
        from pyarrow import parquet

        text, number = pyarrow.string(), pyarrow.float64()
        kinds = [text if name == "time" or name in WORDS else number for name in names]
        self._schema = pyarrow.schema(list(zip(names, kinds, strict=True)))
        self._writer = parquet.ParquetWriter(self._file, self._schema)

    def write(self, replies: Sequence[Reply]) -> None:
        """Keep the replies until they fill a row group."""
        self._rows += replies
        if len(self._rows) >= ROW_GROUP:
            self._put_out()

    def close(self) -> None:
        """The last row group, and the footer."""
        if self._writer is not None:
            self._put_out()
            self._writer.close()

    def _put_out(self) -> None:
        import pyarrow

        rows = [(time, *values) for time, values in self._rows]
        self._rows = []
        if rows:
            columns = [
                pyarrow.array(column, kind)
                for column, kind in zip(zip(*rows, strict=True), self._schema.types, strict=True)
            ]
            self._writer.write_table(pyarrow.table(columns, schema=self._schema))


class _Forward(io.RawIOBase):
    """A file for pyarrow whose bytes go straight to the output of the stream."""

    def __init__(self, output: ByteOutput) -> None:
        self._output, self._position = output, 0

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def write(self, data: Any) -> int:
        self._output.write(bytes(data))
        self._position += len(data)
        return len(data)
