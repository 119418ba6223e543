"""Plain text: tables, and sentences about a row of a log."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thermaltool.logs import Log
    from thermaltool.model import Excursion


def aligned(rows: list[list[str]]) -> str:
    """Columns aligned by blanks; the first row is the heading."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def row_message(log: Log, row: int, message: str) -> str:
    """A sentence with the file and the line of a row."""
    return f"{log.name}:{log.lines[row]}: {message}"


def excursion_message(log: Log, e: Excursion) -> str:
    """Where a channel leaves what the calibration has seen."""
    return row_message(
        log,
        e.first,
        f"{e.channel}: {e.value:.4g} is outside the calibrated range {e.low:.4g} to {e.high:.4g} "
        f"({e.rows} rows): the model extrapolates",
    )


def pause_messages(log: Log, meaning: str) -> Iterator[str]:
    """The pauses of a log (above ``max_gap``), and what they mean here."""
    for part in log.segments[1:]:
        pause = log.time[part.start] - log.time[part.start - 1]
        yield row_message(log, part.start, f"a pause of {pause:g} s; {meaning}")
