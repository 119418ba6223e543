"""What commands say on stderr, one line each."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from time import monotonic

import click

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


def terminal_progress(label: str) -> Callable[[str], None]:
    """A line that is overwritten and says how long it has been, on a terminal only."""
    if not sys.stderr.isatty():
        return lambda message: None
    start = monotonic()

    def say(message: str) -> None:
        seconds = monotonic() - start
        click.echo(f"\r\033[K{label}, {seconds:.0f} s: {message}", nl=False, err=True)

    return say
