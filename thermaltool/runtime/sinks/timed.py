"""The sink of a stream, which writes the time as the lines have it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thermaltool.runtime.clocks import LineClock
    from thermaltool.runtime.process import Reply
    from thermaltool.runtime.sinks import Sink


class TimedSink:
    """Opens a sink as soon as its first name is known: ``time_s``, or ``time`` of ISO 8601 stamps.

    Parameters
    ----------
    sink : Sink
    names : sequence of str
        What is written behind the time.

    Attributes
    ----------
    refused : bool
        The sink could not be opened: it takes nothing.
    """

    def __init__(self, sink: Sink, names: Sequence[str]) -> None:
        self._sink, self._names = sink, names
        self._time_name: str | None = None
        self._clock: LineClock | None = None
        self.refused = False

    def follow(self, clock: LineClock) -> bool:
        """Write the time of this clock; False where the sink is open, and writes another kind."""
        self.open(clock.written_name)
        fits = self._time_name == clock.written_name
        self._clock = clock if fits else self._clock
        return fits

    def open(self, time_name: str) -> None:
        """Open the sink, where it is not."""
        if self._time_name is not None:
            return
        self._time_name = time_name
        self.refused = True
        self._sink.open((time_name, *self._names))
        self.refused = False

    def timed(self, reply: Reply) -> Reply:
        """The reply with its time as it is written."""
        time, values = reply
        if time is None or self._clock is None or isinstance(time, str):
            return reply
        return self._clock.written(time), values

    def write(self, replies: Sequence[Reply]) -> None:
        """Put replies out."""
        # Nothing has said how time is written: the first reply is one to silence.
        self.open("time_s")
        self._sink.write(replies)

    def close(self) -> None:
        """Nothing comes any more."""
        self._sink.close()
