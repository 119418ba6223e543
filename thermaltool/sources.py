"""Inputs that are read whole: within bounds, and not waited for without a word."""

from __future__ import annotations

import errno
import os
import select
import stat
import sys
import time
import warnings
from contextvars import ContextVar
from typing import BinaryIO

from thermaltool.errors import ThermalToolWarning

# Bytes of a line: a hundred thousand columns fit, an input without lines does not.
MAX_LINE = 2**24
# Bytes of an input, where nobody says otherwise: ten million rows of twenty columns fit.
max_bytes: ContextVar[int] = ContextVar("max_bytes", default=2 * 2**30)
# How files begin that have no lines: Parquet, a workbook, TDMS, MATLAB files of both kinds.
WITHOUT_LINES = (b"PAR1", b"PK\x03\x04", b"TDSm", b"MATLAB ", b"\x89HDF\r\n")
READ_AT_ONCE = 2**20
# Silence of a pipe that is told, and after which one that nobody writes to is given up [s].
TOLD_AFTER, GIVEN_UP_AFTER = 10.0, 60.0
WAITING = "nothing has come for {:g} s: waits for who writes it"


def read_input(path: str) -> bytes:
    """All bytes of a file, of a named pipe, or of stdin for ``-``.

    A pipe that says nothing for `TOLD_AFTER` is told with a `ThermalToolWarning`.

    Raises
    ------
    OSError
        It cannot be read; it has more than `max_bytes`, or a line longer than `MAX_LINE` where it
        has lines; nobody has opened a named pipe for writing within `GIVEN_UP_AFTER`.
    """
    if path == "-":
        if sys.stdin is None:
            raise OSError(errno.EBADF, "closed", "<stdin>")
        stream = sys.stdin.buffer
        _tell_silence(stream, "<stdin>")
        return _read_whole(stream, "<stdin>")
    with open(path, "rb", opener=_open) as stream:
        mode = os.fstat(stream.fileno())
        if stat.S_ISREG(mode.st_mode) and mode.st_size > max_bytes.get():
            raise _too_long(path)
        first = b""
        if stat.S_ISFIFO(mode.st_mode):
            first = _first_piece(stream.fileno(), path)
            os.set_blocking(stream.fileno(), True)
        return _read_whole(stream, path, first)


def _open(path: str, flags: int) -> int:
    # A named pipe without a writer would keep `open` for ever.
    waits = os.path.exists(path) and stat.S_ISFIFO(os.stat(path).st_mode)
    return os.open(path, flags | (os.O_NONBLOCK if waits else 0))


def _first_piece(handle: int, name: str) -> bytes:
    """What comes first through a named pipe; nothing where its writer has left without a word."""
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    begun, told, left = time.monotonic(), False, False
    while True:
        try:
            piece, opened = os.read(handle, READ_AT_ONCE), False
        except BlockingIOError:
            piece, opened = b"", True
        if piece or left:
            return piece
        waited = time.monotonic() - begun
        if waited >= GIVEN_UP_AFTER and not opened:
            message = f"nobody has written to this pipe for {GIVEN_UP_AFTER:g} s"
            raise OSError(errno.ETIMEDOUT, message, name)
        if waited >= TOLD_AFTER and not told:
            _tell(name)
            told = True
        patience = (GIVEN_UP_AFTER if told else TOLD_AFTER) - waited
        events = poll.poll(1000 * (patience if patience > 0 else TOLD_AFTER))
        left = any(event & select.POLLHUP for _, event in events)


def _tell_silence(stream: BinaryIO, name: str) -> None:
    """Tell where nothing comes from a pipe for long."""
    try:
        handle = stream.fileno()
    except (OSError, ValueError):  # no file: bytes that are there already
        return
    if not hasattr(select, "poll"):  # Windows
        return
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    if not poll.poll(1000 * TOLD_AFTER):
        _tell(name)


def _tell(name: str) -> None:
    message = f"{name}: {WAITING.format(TOLD_AFTER)}"
    warnings.warn(message, ThermalToolWarning, stacklevel=2)


def _too_long(name: str) -> OSError:
    limit = max_bytes.get()
    size = f"{limit / 2**30:.3g} GiB" if limit >= 2**30 else f"{limit} bytes"
    message = (
        f"more than {size}: where that is meant, "
        "thermaltool --max-bytes 20GB COMMAND ... reads as much"
    )
    return OSError(errno.EFBIG, message, name)


def _read_whole(stream: BinaryIO, name: str, first: bytes = b"") -> bytes:
    """All bytes of a stream that has begun with `first`."""
    pieces: list[bytes] = []
    length = 0  # of the last line so far
    room = max_bytes.get()
    while piece := first or stream.read(READ_AT_ONCE):
        first = b""
        pieces.append(piece)
        room -= len(piece)
        if room < 0:
            raise _too_long(name)
        end = max(piece.rfind(b"\n"), piece.rfind(b"\r"))
        length = length + len(piece) if end < 0 else len(piece) - end - 1
        if length > MAX_LINE and not pieces[0].startswith(WITHOUT_LINES):
            size = f"{MAX_LINE // 2**20} MiB"
            raise OSError(errno.EFBIG, f"a line longer than {size}: no log and no document", name)
    return b"".join(pieces)
