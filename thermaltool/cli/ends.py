"""Signals that end a command, as exceptions: what is half written is taken away."""

from __future__ import annotations

import signal
import sys
from types import FrameType

# Those that a supervisor or a terminal sends; Windows has no SIGHUP.
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
# Their commands move an actuator: a signal while they load waits for the safe line.
ACTUATING = frozenset({"compensate", "fcc"})

_waits = False
_waiting = 0


def _end(number: int, frame: FrameType | None) -> None:
    global _waiting
    if _waits and not _waiting:
        _waiting = number
    elif number == signal.SIGINT:
        raise KeyboardInterrupt
    else:
        sys.exit(128 + number)


def end_by_signals(command: str) -> None:
    """Raise SystemExit or KeyboardInterrupt where a signal comes.

    Of a command that actuates the first one waits for `take_signals`, the second does not.
    """
    global _waits
    _waits = command in ACTUATING
    for name in NAMES:
        number = getattr(signal, name, None)
        # nohup has its command go on.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def take_signals() -> None:
    """From here on signals raise at once; one that has come before does now."""
    global _waits
    _waits = False
    if _waiting:
        _end(_waiting, None)
