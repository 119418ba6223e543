"""Signs of life for systemd (``Type=notify``, ``WatchdogSec=``): a loop that hangs is restarted."""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections.abc import Callable, Mapping


class Heartbeat:
    """Speaks to the socket in ``NOTIFY_SOCKET``; without one it says nothing.

    Parameters
    ----------
    environment : mapping
    now : callable
        Seconds that only go on.

    Attributes
    ----------
    interval : float [s]
        Time between two signs: half of what ``WATCHDOG_USEC`` allows; inf for none.
    """

    def __init__(self, environment: Mapping[str, str], now: Callable[[], float]) -> None:
        self._now, self._beat_at = now, -math.inf
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        self.interval = math.inf
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            with contextlib.suppress(ValueError):
                self.interval = int(environment.get("WATCHDOG_USEC", "")) / 2e6 or math.inf

    def ready(self) -> None:
        """The stream answers from now on."""
        self._send(b"READY=1")

    def beat(self) -> None:
        """The loop has come round."""
        if self._now() - self._beat_at >= self.interval:
            self._beat_at = self._now()
            self._send(b"WATCHDOG=1")

    def close(self) -> None:
        """The stream has ended."""
        self._send(b"STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, word: bytes) -> None:
        # Who watches may be gone or slow: that is not the stream's trouble.
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(word, self._address)


def heartbeat_of_process(now: Callable[[], float]) -> Heartbeat:
    """The one that the environment of this process asks for."""
    return Heartbeat(os.environ, now)
