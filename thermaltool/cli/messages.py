"""What commands say on stderr, one line each."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
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


@contextlib.contextmanager
def background_emitter(command: str, quiet: int) -> Iterator[Callable[[str], None]]:
    """Where a stream's messages go: one line each on stderr, nowhere with --quiet.

    Nobody waits for stderr, not even at the end: where it stalls, messages are dropped.
    """
    from thermaltool.runtime.line_writer import LineWriter

    if quiet or sys.stderr is None:
        yield lambda message: None
        return
    try:
        lines = LineWriter(sys.stderr.fileno())
    except (OSError, ValueError):  # no file: somebody catches what is said
        yield lambda message: warn(f"thermaltool {command}: {message}")
        return
    sys.stderr.flush()
    try:
        yield lambda message: lines.write(f"thermaltool {command}: {message}")
    finally:
        if not lines.close():
            # The interpreter writes its own last words there.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def terminal_progress(label: str) -> Callable[[str], None]:
    """A line that is overwritten and says how long it has been, on a terminal only."""
    if not sys.stderr.isatty():
        return lambda message: None
    start = monotonic()

    def say(message: str) -> None:
        seconds = monotonic() - start
        click.echo(f"\r\033[K{label}, {seconds:.0f} s: {message}", nl=False, err=True)

    return say
