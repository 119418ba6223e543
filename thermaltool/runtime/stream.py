"""The streaming loop: lines, watchdog, checkpoint, and the safe reply at every end."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermaltool.errors import LogError, ModelError, OutputError
from thermaltool.runtime.checkpoint import REMEDY, Checkpoint
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.process import Process, Reply
from thermaltool.runtime.rows import open_rows
from thermaltool.runtime.rows.row import RowReader
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.sinks import Sink, open_sink

BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def open_stream(
    process: Process, settings: Settings, source: int, sink: int, messages: Messages
) -> Stream:
    """The stream of a process between two file descriptors; nothing is read or written yet.

    Parameters
    ----------
    process : Process
    settings : Settings
        As the process was made with.
    source, sink : int
        File descriptors.
    messages : Messages

    Raises
    ------
    LogError
        The column map cannot be read.
    ValueError
        A format that a stream cannot read, or not be written as.
    """
    pipe = LinePipe(source, sink)
    timeout = process.patience if settings.timeout is None else settings.timeout
    return Stream(
        pipe,
        open_rows(settings.from_format, settings.wanted(process.columns, process.clock_advice)),
        open_sink(settings.to_format, pipe),
        process,
        messages,
        timeout or math.inf,
        Checkpoint(settings.checkpoint, process.digest) if settings.checkpoint else None,
        settings.checkpoint_every,
    )


@dataclass
class Stream:
    """A process between a source and a sink.

    Attributes
    ----------
    pipe : LinePipe
    rows : RowReader
    sink : Sink
    process : Process
    messages : Messages
    timeout : float [s]
        Without a line that counts for this long the process answers silence; inf never.
    checkpoint : Checkpoint or None
    checkpoint_every : float [s]
        Of stream time.
    """

    pipe: LinePipe
    rows: RowReader
    sink: Sink
    process: Process
    messages: Messages
    timeout: float = math.inf
    checkpoint: Checkpoint | None = None
    checkpoint_every: float = 10.0
    now: Callable[[], float] = time.monotonic
    _heard_at: float = field(default=0.0, init=False)
    _due: float = field(default=math.inf, init=False)
    _silent: bool = field(default=False, init=False)
    _replied_at: float | None = field(default=None, init=False)
    _saved_at: float | None = field(default=None, init=False)
    _resumed: dict[str, Any] = field(default_factory=dict, init=False)

    def run(self) -> int:
        """Answer lines until the source ends or a signal comes; returns the signal, or 0.

        However it ends, the safe reply is the last one, where the sink still takes one.

        Raises
        ------
        LogError, ModelError, OutputError, FitError, BrokenPipeError
        """
        # Estimates that overflow are caught by the process.
        with self.pipe, np.errstate(all="ignore"):
            self._resume()
            with contextlib.closing(self.sink):
                self.sink.open(("time_s", *self.process.names))
                try:
                    self._loop()
                finally:
                    self._finish()
        return self.pipe.signal

    def _loop(self) -> None:
        self._heard()
        while not self.pipe.signal:
            patience = self._due - self.now()
            if self.pipe.wait(max(patience, 0.0) if patience < math.inf else None):
                lines = self.pipe.read()
                if lines is None:
                    self._end()
                    return
                accepted = self.process.accepted
                self.sink.write([reply for line in lines if (reply := self._reply(line))])
                if self.process.accepted > accepted or not self.process.actuates:
                    self._heard()
                if self.process.accepted > accepted:
                    self._save()
            if self.now() >= self._due and not self.pipe.signal:
                self._silence()

    def _reply(self, line: bytes) -> Reply | None:
        """The reply to a line; none to names, comments and blank lines."""
        self.messages.line += 1
        line = line.rstrip(b"\r")
        if self.messages.line == 1:
            line = line.removeprefix(BYTE_ORDER_MARK)
        start = line.lstrip()
        if not start or start.startswith(b"#"):
            return None
        if self.rows.clock is None and not self._open(line):
            return None
        reply = self.process.take(self.rows.row(line))
        if reply is not None:
            self._replied_at = reply[0]
        return reply

    def _open(self, line: bytes) -> bool:
        is_row = self.rows.open(line, self.messages.source, self.messages.line)
        if self._resumed and self.rows.clock and self.process.time is not None:
            with self._whole_checkpoint():
                self.rows.clock.resume(self._resumed["clock"], self.process.time)
        return is_row

    def _heard(self) -> None:
        """A line that counts has come: the watchdog starts anew."""
        self._silent = False
        self._heard_at = self.now()
        self._due = self._heard_at + self.timeout

    def _silence(self) -> None:
        """One step towards what is safe; more follow until it is reached."""
        elapsed = self.now() - self._heard_at
        if not self._silent:
            self._silent = True
            usable, then = ("usable ", ": safe setpoint") if self.process.actuates else ("", "")
            self.messages("", f"no {usable}line for {self.timeout:.3g} s{then}")
        reply = self.process.silence(elapsed)
        if reply is not None:
            self._replied_at = reply[0]
            self.sink.write([reply])
        self._due = math.inf if self.process.at_safe else self.now() + (self.process.period or 0.0)

    def _end(self) -> None:
        """The source has ended."""
        if self.pipe.torn:
            self.messages.line += 1
            self.messages("", "the last line has no end, it may be cut: not used")
        if self.rows.clock is None:
            raise LogError(
                "empty: a stream begins with a line that names its columns", self.messages.source
            )

    def _finish(self) -> None:
        values, last = self.process.finish(), self._replied_at
        try:
            if values is not None:
                # A row of its own moment, so that the output is a log whose clock only goes on.
                after = None if last is None else last + (self.process.period or 0.0)
                self.sink.write([(after, values)])
        finally:
            # A sink that has failed may fail again: messages and checkpoint come all the same.
            self.messages.close()
            if summary := self.process.summary():
                self.messages.emit(summary)
            if self.checkpoint:
                self.checkpoint.close(self._state())

    def _state(self) -> dict[str, Any]:
        clock = self.rows.clock.state() if self.rows.clock else self._resumed.get("clock", {})
        return {"clock": clock, **self.process.state()}

    def _save(self) -> None:
        time = self.process.time
        if not self.checkpoint or time is None:
            return
        if self._saved_at is None or abs(time - self._saved_at) >= self.checkpoint_every:
            self._saved_at = time
            try:
                self.checkpoint.save(self._state())
            except OutputError as error:
                self.messages("", f"checkpoint not written: {error}")

    def _resume(self) -> None:
        self._resumed = (self.checkpoint.load() if self.checkpoint else None) or {}
        if self._resumed:
            with self._whole_checkpoint():
                self._resumed["clock"].items()
                self.process.resume(self._resumed)

    @contextlib.contextmanager
    def _whole_checkpoint(self) -> Iterator[None]:
        try:
            yield
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            path = self.checkpoint.path if self.checkpoint else ""
            raise ModelError(f"{path}: a checkpoint that is damaged; {REMEDY}") from error
