"""Lines to a descriptor that may stall: a terminal that is held, a pipe that nobody reads."""

from __future__ import annotations

import os
import threading
from collections import deque

from thermaltool.runtime.pipe import LAST_WORD

# Lines that wait for a descriptor that stalls; what comes after them is dropped and counted.
MAX_WAITING = 1000


class LineWriter:
    """Writes lines in the background, in order; who calls never waits.

    How many lines were dropped is said as soon as one leaves again.

    Parameters
    ----------
    descriptor : int
        Open for writing; it stays open.

    Attributes
    ----------
    dropped : int
        Lines that did not leave.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = self._failed = False
        self.dropped = self._said = 0

    def write(self, line: str) -> None:
        """Put a line, without its end, in the queue; it is dropped where the queue is full."""
        with self._changed:
            if self._closed or self._failed or len(self._waiting) >= MAX_WAITING:
                self.dropped += 1
                return
            if self.dropped > self._said:
                lost, self._said = self.dropped - self._said, self.dropped
                self._waiting.append(b"%d messages dropped: nobody took them\n" % lost)
            self._waiting.append(line.encode(errors="replace") + b"\n")
            self._changed.notify_all()
            if self._thread is None:
                # A daemon: a write that never returns does not keep the process alive.
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()

    def close(self, patience: float = LAST_WORD) -> bool:
        """Wait for the queue to empty; False where `patience` [s] ends before.

        Parameters
        ----------
        patience : float [s]
        """
        with self._changed:
            empty = self._changed.wait_for(lambda: self._failed or not self._waiting, patience)
            self._closed = True
            self.dropped += len(self._waiting)
            self._changed.notify_all()
        return empty

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                line = self._waiting[0]
            try:
                while line:
                    line = line[os.write(self._descriptor, line) :]
            except OSError:
                # A terminal that has gone stops nothing.
                self._failed = True
            with self._changed:
                self._waiting.popleft()
                self._changed.notify_all()
