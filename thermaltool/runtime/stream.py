"""The streaming loop: lines, watchdog, checkpoint, and the safe setpoint at every end."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermaltool.errors import LogError, ModelError, OutputError
from thermaltool.runtime.checkpoint import MEND, Checkpoint
from thermaltool.runtime.compensator import Compensator
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.records import RowReader

BYTE_ORDER_MARK = b"\xef\xbb\xbf"


class Writer:
    """Answers as CSV or NDJSON; a missing time is an empty field, or null."""

    def __init__(self, form: str, names: Sequence[str]) -> None:
        columns = ("time_s", *names)
        if form == "csv":
            self.header = ",".join(columns).encode() + b"\n"
            self._line = ",".join(["%s"] + ["%r"] * len(names)) + "\n"
            self._no_time = ""
        else:
            self.header = b""
            fields = [f"{json.dumps(c)}: %{'s' if c == 'time_s' else 'r'}" for c in columns]
            self._line = "{" + ", ".join(fields) + "}\n"
            self._no_time = "null"

    def line(self, time: float | None, values: Sequence[float]) -> bytes:
        # Adding zero turns -0.0 into 0.0.
        stamp = self._no_time if time is None else repr(time)
        return (self._line % (stamp, *[value + 0.0 for value in values])).encode()


@dataclass
class Stream:
    """A compensator between a source and a sink.

    Attributes
    ----------
    pipe : LinePipe
    records : RowReader
    writer : Writer
    compensator : Compensator
    messages : Messages
    estimates : bool
        Whether an answer carries the estimates too.
    timeout : float [s]
        Without a usable line for this long the safe setpoint is written; inf never.
    tick : float [s]
        Time between the lines of a ramp to the safe setpoint while the source is silent.
    checkpoint : Checkpoint or None
    checkpoint_every : float [s]
        Of stream time.
    """

    pipe: LinePipe
    records: RowReader
    writer: Writer
    compensator: Compensator
    messages: Messages
    estimates: bool = False
    timeout: float = math.inf
    tick: float = 1.0
    checkpoint: Checkpoint | None = None
    checkpoint_every: float = 10.0
    now: Callable[[], float] = time.monotonic
    _heard_at: float = field(default=0.0, init=False)
    _due: float = field(default=math.inf, init=False)
    _silent: bool = field(default=False, init=False)
    _written_at: float | None = field(default=None, init=False)
    _saved_at: float | None = field(default=None, init=False)
    _kept: dict[str, Any] = field(default_factory=dict, init=False)

    def run(self) -> int:
        """Answer lines until the source ends or a signal comes; returns the signal, or 0.

        However it ends, the safe setpoint is the last line, where the sink still takes one.

        Raises
        ------
        LogError, ModelError, OutputError, FitError, BrokenPipeError
        """
        # Estimates that overflow are caught by the compensator.
        with self.pipe, np.errstate(all="ignore"):
            self._resume()
            try:
                self.pipe.write(self.writer.header)
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
                accepted = self.compensator.accepted
                self.pipe.write(b"".join([self._answer(line) for line in lines]))
                if self.compensator.accepted > accepted:
                    self._heard()
                    self._save()
            if self.now() >= self._due and not self.pipe.signal:
                self._silence()

    def _answer(self, line: bytes) -> bytes:
        """The setpoint line for a sensor line; nothing for names, comments and blank lines."""
        self.messages.line += 1
        line = line.rstrip(b"\r")
        if self.messages.line == 1:
            line = line.removeprefix(BYTE_ORDER_MARK)
        start = line.lstrip()
        if not start or start.startswith(b"#"):
            return b""
        if self.records.clock is None and not self._open(line):
            return b""
        self.compensator.take(self.records.record(line))
        return self._state_line(self.compensator.time)

    def _open(self, line: bytes) -> bool:
        is_record = self.records.open(line, self.messages.source, self.messages.line)
        if self._kept and self.records.clock and self.compensator.time is not None:
            with self._whole_checkpoint():
                self.records.clock.resume(self._kept["clock"], self.compensator.time)
        return is_record

    def _state_line(self, time: float | None) -> bytes:
        values = self.compensator.values()
        self._written_at = time
        return self.writer.line(
            time, values + self.compensator.estimates if self.estimates else values
        )

    def _heard(self) -> None:
        """A usable line has come: the watchdog starts anew."""
        self._silent = False
        self._heard_at = self.now()
        self._due = self._heard_at + self.timeout

    def _silence(self) -> None:
        """One line towards the safe setpoint; more follow until it is reached."""
        elapsed = self.now() - self._heard_at
        if not self._silent:
            self._silent = True
            self.messages("", f"no usable line for {self.timeout:.3g} s: safe setpoint")
        self.pipe.write(self._state_line(self.compensator.silence(elapsed)))
        self._due = math.inf if self.compensator.at_safe else self.now() + self.tick

    def _end(self) -> None:
        """The source has ended."""
        if self.pipe.torn:
            self.messages.line += 1
            self.messages("", "the last line has no end, it may be cut: not used")
        if self.records.clock is None:
            raise LogError(
                "empty: a stream begins with a line that names its columns", self.messages.source
            )

    def _finish(self) -> None:
        self.compensator.finish()
        # A line of its own moment, so that the output is a log with a clock that only goes on.
        last = self._written_at
        self.pipe.write(self._state_line(None if last is None else last + self.tick))
        self.messages.close()
        if self.checkpoint:
            self.checkpoint.close(self._state())

    def _state(self) -> dict[str, Any]:
        clock = self.records.clock.state() if self.records.clock else self._kept.get("clock", {})
        return {"clock": clock, **self.compensator.state()}

    def _save(self) -> None:
        time = self.compensator.time
        if not self.checkpoint or time is None:
            return
        if self._saved_at is None or abs(time - self._saved_at) >= self.checkpoint_every:
            self._saved_at = time
            try:
                self.checkpoint.save(self._state())
            except OutputError as error:
                self.messages("", f"checkpoint not written: {error}")

    def _resume(self) -> None:
        self._kept = (self.checkpoint.load() if self.checkpoint else None) or {}
        if self._kept:
            with self._whole_checkpoint():
                self._kept["clock"].items()
                self.compensator.resume(self._kept)

    @contextlib.contextmanager
    def _whole_checkpoint(self) -> Iterator[None]:
        try:
            yield
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            path = self.checkpoint.path if self.checkpoint else ""
            raise ModelError(f"{path}: a checkpoint that is damaged: {MEND}") from error
