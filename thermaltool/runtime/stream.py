"""The streaming loop: lines, watchdog, checkpoint, and the safe reply at every end."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from thermaltool.errors import LogError
from thermaltool.runtime.audit import Audit
from thermaltool.runtime.heartbeat import Heartbeat, heartbeat_of_process
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.process import Process, Reply
from thermaltool.runtime.restart.keeper import Restart, open_restart
from thermaltool.runtime.rows import merger_of, open_rows
from thermaltool.runtime.rows.row import Row, RowReader
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.sinks import open_sink
from thermaltool.runtime.sinks.timed import TimedSink

if TYPE_CHECKING:
    from thermaltool.runtime.rows.merger import Merger

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
# Time between two lines of a stream that has no period and is silent [s].
USUAL_TICK = 1.0


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
    OutputError
        The audit log cannot be written.
    ValueError
        A format that a stream cannot read, or not be written as; a start for a set point that is
        not there.
    """
    pipe = LinePipe(source, sink)
    timeout = process.patience if settings.timeout is None else settings.timeout
    wanted = settings.wanted(process.columns, process.clock_advice)
    merger = merger_of(wanted, process.period or USUAL_TICK)
    return Stream(
        pipe,
        open_rows(settings.from_format, wanted),
        TimedSink(
            open_sink(settings.to_format, pipe, **settings.sink_options(process.names)),
            process.names,
        ),
        process,
        messages,
        open_restart(process, settings, messages, merger),
        timeout or math.inf,
        merger,
        Audit(settings.audit),
        heartbeat_of_process(time.monotonic),
        ramps=settings.end == "ramp",
    )


@dataclass
class Stream:
    """A process between a source and a sink.

    Attributes
    ----------
    pipe : LinePipe
    rows : RowReader
    sink : TimedSink
    process : Process
    messages : Messages
    timeout : float [s]
        Without a line that counts for this long the process answers silence; inf never.
    restart : Restart
    merger : Merger or None
        Makes rows of messages of one sensor each.
    audit : Audit
    heartbeat : Heartbeat
    ramps : bool
        Whether the end goes to the safe reply line by line.
    """

    pipe: LinePipe
    rows: RowReader
    sink: TimedSink
    process: Process
    messages: Messages
    restart: Restart
    timeout: float = math.inf
    merger: Merger | None = None
    audit: Audit = field(default_factory=lambda: Audit(None))
    heartbeat: Heartbeat = field(default_factory=lambda: Heartbeat({}, time.monotonic))
    ramps: bool = False
    now: Callable[[], float] = time.monotonic
    _heard_at: float = field(default=0.0, init=False)
    _due: float = field(default=math.inf, init=False)
    _silent: bool = field(default=False, init=False)
    _replied_at: float | None = field(default=None, init=False)
    _save_due: bool = field(default=False, init=False)
    _status: str = field(default="", init=False)

    def run(self) -> int:
        """Answer lines until the source ends or a signal comes; returns the signal, or 0.

        However it ends, the safe reply is the last one, where the sink still takes one.

        Raises
        ------
        LogError, ModelError, OutputError, FitError, BrokenPipeError
        """
        # Estimates that overflow are caught by the process.
        with self.pipe, np.errstate(all="ignore"), contextlib.closing(self.sink):
            if self.rows.wanted.time_name is not None:
                self.sink.open(self.rows.wanted.time_name)
            # The first line shows what the time is called; who has left is known before.
            self.pipe.wait(0.0)
            try:
                self._begin()
                self.heartbeat.ready()
                self._loop()
            except BaseException as error:
                self.audit.add("error", message=str(error) or type(error).__name__)
                raise
            finally:
                try:
                    self._approach()
                finally:
                    self._finish()
        return self.pipe.signal

    def _begin(self) -> None:
        begin = self.restart.begin()
        if self.process.title:
            self.messages.emit(f"{self.process.title}: starts {begin}")
        self.audit.add("start", of=self.process.title, begin=begin)

    def _loop(self) -> None:
        self._heard()
        while not self.pipe.signal:
            self.heartbeat.beat()
            patience = min(self._due - self.now(), self.heartbeat.interval, self._merges_in())
            if self.pipe.wait(max(patience, 0.0) if patience < math.inf else None):
                if self.rows.clock is not None:
                    self.rows.clock.nothing_waited = self.pipe.was_empty
                lines = self.pipe.read()
                if lines is None:
                    self._end()
                    return
                accepted = self.process.accepted
                self._answer(reply for line in lines for reply in self._replies(line))
                if self.process.accepted > accepted or not self.process.actuates:
                    self._heard()
                if self.process.accepted > accepted:
                    self._save()
            if self.pipe.was_empty and self._merges_in() <= 0 and not self.pipe.signal:
                self._flush()
            if self.now() >= self._due and not self.pipe.signal:
                self._silence()

    def _merges_in(self) -> float:
        """Until a row that waits for messages has to leave [s]."""
        return math.inf if self.merger is None else self.merger.due - self.now()

    def _flush(self) -> None:
        """The row that waits leaves without what has not come."""
        if self.merger is not None:
            accepted = self.process.accepted
            self._answer(self._taken(row) for row in self.merger.flush())
            if self.process.accepted > accepted:
                self._heard()
                self._save()

    def _answer(self, answers: Iterable[Reply | None]) -> None:
        """Write replies as they are made; one that moves an actuator alone, where it is kept."""
        replies: list[Reply] = []
        standing = self.process.values()
        for reply in answers:
            if reply is None:
                continue
            if self.restart.journal is not None and (values := self.process.values()) != standing:
                self.sink.write(replies)
                replies, before, standing = [], standing, values
                self._put(reply, before)
            else:
                replies.append(reply)
        self.sink.write(replies)

    def _put(self, reply: Reply, before: Sequence[float]) -> None:
        """Write a reply that moves an actuator, and keep where it stands then."""
        self.restart.record(self.process.values())
        self.sink.write([reply])
        if self.pipe.sink_failed:
            self.restart.record(before)

    def _replies(self, line: bytes) -> Iterator[Reply | None]:
        """The replies to a line; none to names, comments and blank lines."""
        self.messages.line += 1
        line = line.rstrip(b"\r")
        if self.messages.line == 1:
            line = line.removeprefix(BYTE_ORDER_MARK)
        start = line.lstrip()
        if self.rows.skips(line, self.messages.line) or not start or start.startswith(b"#"):
            return
        if self.rows.clock is None and not self._open(line):
            return
        row = self.rows.row(line)
        if (row.time is None or all(row.faults)) and self.rows.is_header(line):
            if self.rows.clock is not None:
                self.rows.clock.take_back()
            if message := self.rows.reopen(line, self.process.time):
                self.messages("", message)
                if self.rows.clock is not None:
                    self.sink.follow(self.rows.clock)
            return
        for each in (row,) if self.merger is None else self.merger.take(row):
            yield self._taken(each)

    def _taken(self, row: Row) -> Reply | None:
        """What the process replies to a row."""
        reply = self.process.take(row)
        if reply is not None:
            self._replied_at = reply[0]
        if self.process.status != self._status:
            self._changed()
        return None if reply is None else self.sink.timed(reply)

    def _changed(self) -> None:
        """The process is in another state: kept at once, and noted."""
        self._status, self._save_due = self.process.status, True
        self.audit.add(
            "state",
            status=self._status,
            stream_s=self.process.time,
            setpoints=list(self.process.values()),
            line=self.messages.line,
        )

    def _open(self, line: bytes) -> bool:
        is_row = self.rows.open(line, self.messages.source, self.messages.line)
        if self.rows.clock is not None:
            self.rows.clock.tell(self.messages)
            self.restart.resume_clock(self.rows.clock)
            if not self.sink.follow(self.rows.clock):
                self.messages("", "times are written in seconds: so is the first line")
        return is_row

    def _save(self) -> None:
        at_once, self._save_due = self._save_due, False
        self.restart.save(self.rows.clock, at_once)

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
        # What actuates says at each tick that it is safe: who reads it knows that it lives.
        ticks = self._step_to_safe(elapsed) and self.process.actuates
        again = self.process.period or USUAL_TICK
        if self.process.at_safe:
            again = max(again, USUAL_TICK)
        self._due = self.now() + again if ticks or not self.process.at_safe else math.inf

    def _step_to_safe(self, elapsed: float) -> bool:
        """The reply to nothing, `elapsed` [s] after the last line; whether there is one."""
        before = self.process.values()
        reply = self.process.silence(elapsed)
        if reply is not None:
            self._replied_at = reply[0]
            self._put(self.sink.timed(reply), before)
        if self.process.status != self._status:
            self._changed()
            self._save()
        return reply is not None

    def _approach(self) -> None:
        """After the last line, to what is safe at the slew rate; a second signal ends it."""
        # Where another stream has the actuators, this one leaves them alone.
        if not self.ramps or self.process.at_safe or self.restart.taken or self.sink.refused:
            return
        self.messages.emit("ends: to the safe setpoint at the slew rate")
        tick = min(self.process.period or USUAL_TICK, USUAL_TICK)
        while not self.pipe.sink_failed:
            self.heartbeat.beat()
            self._step_to_safe(self.now() - self._heard_at)
            if self.process.at_safe:
                return
            if not self.pipe.pause(tick):
                self.messages.emit("a second signal: the safe setpoint at once")
                return

    def _end(self) -> None:
        """The source has ended."""
        if self.pipe.torn:
            self.messages.line += 1
            self.messages("", "the last line has no end, it may be cut: not used")
        if self.rows.clock is None:
            raise LogError(
                "empty: a stream begins with a line that names its columns", self.messages.source
            )
        if self.restart.checkpoint is None:
            # Else it waits there for the messages of the next run.
            self._flush()

    def _finish(self) -> None:
        self.heartbeat.close()
        before, values, last = self.process.values(), self.process.finish(), self._replied_at
        try:
            # Where another stream has the actuators, this one leaves them alone.
            if values is not None and not self.restart.taken and not self.sink.refused:
                # A row of its own moment, so that the output is a log whose clock only goes on.
                after = None if last is None else last + (self.process.period or 0.0)
                self._put(self.sink.timed((after, values)), before)
            elif not self.sink.refused:
                self.sink.write([])
        finally:
            # A sink that has failed may fail again: messages and checkpoint come all the same.
            self.messages.close()
            if summary := self.process.summary():
                self.messages.emit(summary)
            self.audit.add("end", signal=self.pipe.signal, setpoints=[*self.process.values()])
            self.audit.close()
            self.restart.close(self.rows.clock)
