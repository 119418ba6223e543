"""The set points last written, beside a checkpoint: what a restart begins from, and who runs.

A checkpoint is some seconds old; the actuator stands where the last line put it. This file follows
before every line that moves it. It is locked while a stream runs: two would undo each other.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import struct
import zlib
from collections.abc import Sequence

from thermaltool.errors import OutputError

SUFFIX = ".setpoints"
# Two records take turns: one that is cut leaves the other whole [byte].
RECORD_SIZE = 4096


class SetpointJournal:
    """The file ``CHECKPOINT.setpoints``.

    Parameters
    ----------
    checkpoint : str
        Path of the checkpoint.
    names : sequence of str
        Of the set points.

    Attributes
    ----------
    taken : bool
        Another stream has locked the file.
    """

    def __init__(self, checkpoint: str, names: Sequence[str]) -> None:
        # A link to a checkpoint is the same checkpoint.
        self.path = os.path.realpath(checkpoint) + SUFFIX
        owner = hashlib.sha256("\n".join(names).encode()).digest()[:8]
        # Number of the record, whose set points, the set points; a checksum follows.
        self._form = struct.Struct(f"<Q8s{len(names)}d")
        self._owner, self._setpoints = owner, len(names)
        self._descriptor, self._number = -1, 0
        self.taken = False
        self._last: tuple[float, ...] | None = None

    def open(self) -> tuple[float, ...] | None:
        """Lock the file; the set points in it, None where it holds none of these.

        Raises
        ------
        OutputError
            Another stream runs on this checkpoint, or the file cannot be written.
        """
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
            self._descriptor = os.open(self.path, flags, 0o644)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = os.pread(self._descriptor, 2 * RECORD_SIZE, 0)
            # Room is taken now: a disk that fills up later does not matter.
            os.pwrite(self._descriptor, content.ljust(2 * RECORD_SIZE, b"\0"), 0)
        except OSError as error:
            self.close()
            self.taken = isinstance(error, BlockingIOError)
            reason = "another stream runs on this checkpoint" if self.taken else error.strerror
            raise OutputError(f"{self.path}: {reason}") from error
        for at in (0, RECORD_SIZE):
            self._read(content[at : at + RECORD_SIZE])
        return self._last

    def record(self, setpoints: Sequence[float]) -> None:
        """Keep the set points of the line that leaves next; raises OutputError."""
        if self._descriptor < 0 or (values := tuple(setpoints)) == self._last:
            return
        self._last, self._number = values, self._number + 1
        body = self._form.pack(self._number, self._owner, *values)
        body += zlib.crc32(body).to_bytes(4, "little")
        try:
            os.pwrite(self._descriptor, body, self._number % 2 * RECORD_SIZE)
        except OSError as error:
            raise OutputError(f"{self.path}: {error.strerror}") from error

    def close(self) -> None:
        """Give the file free."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _read(self, record: bytes) -> None:
        body, crc = record[: self._form.size], record[self._form.size : self._form.size + 4]
        if len(crc) < 4 or zlib.crc32(body).to_bytes(4, "little") != crc:
            return
        number, owner, *setpoints = self._form.unpack(body)
        if owner == self._owner and number >= self._number:
            self._number, self._last = number, tuple(setpoints)
