"""Plain text: tables, and sentences about a row of a log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thermaltool.logs import Log
    from thermaltool.model import Excursion, Zero


def aligned(rows: Sequence[Sequence[str]], texts: int | None = None) -> str:
    """Table of columns that are aligned by blanks.

    Parameters
    ----------
    rows : sequence of sequence of str
        The heading first.
    texts : int, optional
        Columns from this one on stand to the right. Default: none.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = len(widths) if texts is None else texts
    sides = [str.ljust] * texts + [str.rjust] * (len(widths) - texts)
    lines = (
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True))
        for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)


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


def start_message(log: Log) -> str:
    """Of a log that does not begin at rest, where its start was taken from."""
    return (
        f"{log.name}: does not begin at rest: the state of the machine at the first row is "
        "estimated (--initial rest takes it to be at rest)"
    )


def zero_message(channel: str, zero: Zero, log: Log) -> str:
    """From what the zero of an output was taken that has none of its own."""
    return (
        f"{channel}: counts from the median of measured minus simulated over the first "
        f"{zero.stop - log.time[0]:.4g} s ({zero.rows} readings)"
    )
