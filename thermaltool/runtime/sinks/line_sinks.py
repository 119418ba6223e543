"""Replies as lines of text, one each, at once: CSV and NDJSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermaltool.status import WORDS

if TYPE_CHECKING:
    from thermaltool.runtime.process import Reply
    from thermaltool.runtime.sinks import ByteOutput


class LineSink:
    """One line per reply; a format gives `_layout`."""

    def __init__(self, output: ByteOutput) -> None:
        self._output = output

    def _layout(self, names: Sequence[str]) -> tuple[str, str, str]:
        """Header, pattern of a line (time and status as %s, numbers as %r), a missing time."""
        raise NotImplementedError

    def open(self, names: Sequence[str]) -> None:
        """The header, where the format has one."""
        header, self._line, self._no_time = self._layout(names)
        self._output.write(header.encode())

    def write(self, replies: Sequence[Reply]) -> None:
        """One line each, at once."""
        self._output.write("".join([self._text(*reply) for reply in replies]).encode())

    def _text(self, time: float | str | None, values: Sequence[float]) -> str:
        stamp = self._no_time if time is None else self._stamp(time)
        return self._line % (stamp, *values)

    def _stamp(self, time: float | str) -> str:
        return time if isinstance(time, str) else repr(time)

    def close(self) -> None:
        """Every line is out already."""


class CsvSink(LineSink):
    """A line of names, then a line per reply; a missing time is an empty field.

    Parameters
    ----------
    output : ByteOutput
    header : bool
        Whether the names are written.
    """

    def __init__(self, output: ByteOutput, header: bool = True) -> None:
        super().__init__(output)
        self._header = header

    def _layout(self, names: Sequence[str]) -> tuple[str, str, str]:
        fields = ["%s", *("%s" if name in WORDS else "%r" for name in names[1:])]
        header = ",".join(names) + "\n" if self._header else ""
        return header, ",".join(fields) + "\n", ""

    def _stamp(self, time: float | str) -> str:
        text = super()._stamp(time)
        return f'"{text}"' if "," in text else text


class NdjsonSink(LineSink):
    """A JSON object per reply; a missing time is null."""

    def _layout(self, names: Sequence[str]) -> tuple[str, str, str]:
        keys = [json.dumps(name).replace("%", "%%") for name in names]
        values = ["%s", *('"%s"' if name in WORDS else "%r" for name in names[1:])]
        fields = [f"{key}: {value}" for key, value in zip(keys, values, strict=True)]
        return "", "{" + ", ".join(fields) + "}\n", "null"

    def _stamp(self, time: float | str) -> str:
        return json.dumps(time)
