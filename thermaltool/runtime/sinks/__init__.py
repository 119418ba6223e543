"""Where the replies of a stream go: a new sink is one file in this folder and one line below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from thermaltool.runtime.registry import load

if TYPE_CHECKING:
    from thermaltool.runtime.process import Reply

SINKS = {
    "csv": "thermaltool.runtime.sinks.line_sinks:CsvSink",
    "ndjson": "thermaltool.runtime.sinks.line_sinks:NdjsonSink",
    "values": "thermaltool.runtime.sinks.values_sink:ValuesSink",
    "template": "thermaltool.runtime.sinks.template_sink:TemplateSink",
    "parquet": "thermaltool.runtime.sinks.parquet_sink:ParquetSink",
}

# They put replies out later than at once: for recordings, not for what moves an actuator.
RECORDING_SINKS = ("parquet",)


class ByteOutput(Protocol):
    """Where bytes go: stdout, with signals that do not tear a line."""

    def write(self, data: bytes) -> None:
        """Write all of it; raises OutputError or BrokenPipeError."""


class Sink(Protocol):
    """What takes replies. It is made with the `ByteOutput` of the stream, which it need not use.

    `open` comes first, and nothing is written where it fails; `close` comes last and always.
    Each may raise OutputError, which ends the stream.
    """

    def open(self, names: Sequence[str]) -> None:
        """The names of what is written: the first is ``time_s``, or ``time`` of ISO 8601 stamps."""

    def write(self, replies: Sequence[Reply]) -> None:
        """Put replies out, at once if something acts on them."""

    def close(self) -> None:
        """Nothing comes any more."""


def open_sink(name: str, output: ByteOutput, **options: Any) -> Sink:
    """The sink of that name; nothing is written yet.

    Parameters
    ----------
    name : str
    output : ByteOutput
    **options
        Of this sink alone.

    Raises
    ------
    ValueError
        There is none, or it refuses an option.
    """
    sink: Sink = load(SINKS, name, "no stream is written as")(output, **options)
    return sink
