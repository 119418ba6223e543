"""Messages of a stream: one line each, and never a flood."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

Report = Callable[[str, str], None]  # (channel, message)


@dataclass
class Messages:
    """Passes messages on, `burst` at once and then `rate` per second.

    What is left out is counted, and the count goes out with the next message or at `close`.

    Attributes
    ----------
    emit : callable
        Gets each line.
    source : str
        The stream's name, for ``source:line: channel: message``.
    line : int
        The line being read, from 1; 0 before any, which a message does not name.
    """

    emit: Callable[[str], None]
    source: str = "<stdin>"
    burst: float = 20.0
    rate: float = 1.0
    now: Callable[[], float] = time.monotonic
    line: int = 0
    _credit: float = field(init=False)
    _last: float = field(init=False)
    _left_out: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._credit, self._last = self.burst, self.now()

    def __call__(self, channel: str, message: str) -> None:
        now = self.now()
        self._credit = min(self.burst, self._credit + self.rate * (now - self._last))
        self._last = now
        if self._credit < 1:
            self._left_out += 1
            return
        self._credit -= 1
        self.close()
        place = f"{channel}: " if channel else ""
        at = f"{self.source}:{self.line}" if self.line else self.source
        self.emit(f"{at}: {place}{message}")

    def close(self) -> None:
        """Say how many messages were left out since the last one."""
        if self._left_out:
            self.emit(f"{self.source}: {self._left_out} more messages left out")
            self._left_out = 0
