"""What a terminal sees of a command at work, and in which colours; files and pipes see nothing."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from time import monotonic

import click

# A command that is done before has said nothing; later the line is written again so often [s].
SILENT, PERIOD = 2.0, 1.0
CLEARED = "\r\033[K"


class ProgressLine:
    """A line on a terminal that is written anew every second: how long, and at what.

    `say` takes what is being done; what ends with a new line is the last word, and the line stays.
    `clear` takes the line away until it is written again, `close` for good.
    """

    def __init__(self, label: str) -> None:
        self._label, self._message = label, ""
        self._start, self._visible = monotonic(), False
        self._lock, self._closed = threading.Lock(), threading.Event()
        threading.Thread(target=self._tick, daemon=True).start()

    def say(self, message: str) -> None:
        self._message = message.rstrip("\n")
        if message.endswith("\n"):
            with self._lock:
                if self._visible:
                    self._write("\n")
                    self._visible = False
            self._closed.set()

    def clear(self) -> None:
        with self._lock:
            if self._visible:
                click.echo(CLEARED, nl=False, err=True, color=True)
                self._visible = False

    def close(self) -> None:
        self._closed.set()
        self.clear()

    def _tick(self) -> None:
        wait = SILENT
        while not self._closed.wait(wait):
            with self._lock:
                if not self._closed.is_set():
                    self._write("")
                    self._visible = True
            wait = PERIOD

    def _write(self, end: str) -> None:
        what = f": {self._message}" if self._message else ""
        line = f"{self._label}, {monotonic() - self._start:.0f} s{what}"
        click.echo(f"{CLEARED}{coloured(line, dim=True)}{end}", nl=False, err=True, color=True)


_line: ProgressLine | None = None


def terminal_progress(label: str) -> Callable[[str], None]:
    """What takes words on the progress of a command: a line on a terminal, nothing elsewhere.

    The line is gone when the command ends, whatever ends it.
    """
    global _line
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda message: None
    _line = ProgressLine(label)
    click.get_current_context().call_on_close(_line.close)
    return _line.say


def clear_line() -> None:
    """Take the line of progress away before something else is said."""
    if _line is not None:
        _line.clear()


def coloured(text: str, **style: bool | str) -> str:
    """A text in colours (as `click.style`) for a stderr that is a terminal with colours.

    NO_COLOR (no-color.org) and a dumb terminal have none.
    """
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    if plain or sys.stderr is None or not sys.stderr.isatty():
        return text
    return click.style(text, **style)  # type: ignore[arg-type]
