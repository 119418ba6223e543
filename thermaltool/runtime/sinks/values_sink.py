"""Replies as values alone: for readers that know what they have asked for."""

from __future__ import annotations

from collections.abc import Sequence

from thermaltool.runtime.sinks.line_sinks import CsvSink


class ValuesSink(CsvSink):
    """A line per reply, with commas between its values; neither names nor time."""

    def _layout(self, names: Sequence[str]) -> tuple[str, str, str]:
        _, line, no_time = super()._layout(names)
        # The time is the first field: taken, and not shown.
        return "", line.replace("%s,", "%.0s", 1), no_time
