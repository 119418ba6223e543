"""What commands say on stderr, one line each."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from thermaltool.report.text import excursion_message, pause_messages, row_message

if TYPE_CHECKING:
    from thermaltool.logs import Log
    from thermaltool.model import Excursion, Model


# Exit code where a command ran and what it checked did not pass.
DID_NOT_PASS = 3


def command_line() -> str:
    """The call as it goes into a model's provenance."""
    return "thermaltool " + " ".join(sys.argv[1:])


def warn(message: str) -> None:
    """One line on stderr."""
    click.echo(message, err=True)


def emitter(command: str, quiet: int) -> Callable[[str], None]:
    """Where a stream's messages go: one line each on stderr, nowhere with --quiet."""

    def emit(message: str) -> None:
        # A terminal that has gone must not stop the stream.
        if not quiet:
            with contextlib.suppress(OSError):
                click.echo(f"thermaltool {command}: {message}", err=True)

    return emit


def warn_row(log: Log, row: int, message: str) -> None:
    """One line on stderr, with the file and the line of a row."""
    warn(row_message(log, row, message))


def terminal_progress(label: str) -> Callable[[str], None]:
    """A line that is overwritten, on a terminal only."""
    if not sys.stderr.isatty():
        return lambda message: None
    return lambda message: click.echo(f"\r\033[K{label}: {message}", nl=False, err=True)


def warn_excursions(model: Model, log: Log) -> None:
    """Say where the log leaves what the calibration has seen."""
    from thermaltool.model import excursions

    for e in excursions(model, log.columns):
        warn_excursion(log, e)


def warn_excursion(log: Log, e: Excursion) -> None:
    """Say where one channel leaves it."""
    warn(excursion_message(log, e))


def warn_pauses(log: Log, meaning: str) -> None:
    """Say where the log has pauses (above --max-gap), and what they mean here."""
    for message in pause_messages(log, meaning):
        warn(message)
