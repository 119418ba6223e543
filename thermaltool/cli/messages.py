"""What commands say on stderr, one line each."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from collections.abc import Callable, Iterator

import click

from thermaltool.cli import progress

# Exit code where a command ran and what it checked did not pass.
DID_NOT_PASS = 3


def command_line() -> str:
    """The call as it goes into a model's provenance."""
    return "thermaltool " + " ".join(sys.argv[1:])


def warn(message: str) -> None:
    """One line on stderr."""
    progress.clear_line()
    click.echo(message, err=True)


@contextlib.contextmanager
def background_emitter(command: str, quiet: int) -> Iterator[Callable[[str], None]]:
    """Where a stream's messages go: one line each on stderr, nowhere with --quiet.

    Nobody waits for stderr, not even at the end: where it stalls, messages are dropped.
    """
    from thermaltool.runtime.line_writer import LineWriter

    try:
        descriptor = -1 if sys.stderr is None else sys.stderr.fileno()
    except (OSError, ValueError):  # no file: somebody catches what is said
        yield lambda message: None if quiet else warn(f"thermaltool {command}: {message}")
        return
    lines = LineWriter(descriptor)
    try:
        if quiet or descriptor < 0:
            yield lambda message: None
        else:
            yield lambda message: lines.write(f"thermaltool {command}: {message}")
    finally:
        if descriptor >= 0 and not (lines.close() and _takes_more(descriptor)):
            # The command and the interpreter write their last words there, and would wait.
            os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _takes_more(descriptor: int) -> bool:
    """Whether a descriptor takes a line at once."""
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return any(event & select.POLLOUT for _, event in poll.poll(0))
