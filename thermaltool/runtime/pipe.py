"""Lines in and lines out, with signals that never tear one."""

from __future__ import annotations

import os
import select
import signal
import stat
from types import FrameType, TracebackType

from thermaltool.errors import LogError, OutputError

READ_SIZE = 16384
# A write of at most this many bytes to a pipe that polls as writable neither blocks nor tears.
PIPE_BUF = select.PIPE_BUF
# What ends a process where nobody takes it.
ENDS = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGALRM, signal.SIGUSR1,
    signal.SIGUSR2, signal.SIGVTALRM, signal.SIGPROF, signal.SIGXCPU,
)  # fmt: skip
# A wait is taken up again after so long [s]: the system counts it in 32 bits of ms.
LONGEST = 1e6
# A line longer than this is garbage: it is cut, so that memory stays bounded.
LONGEST_LINE = 65536
# At the end, what still waits for a sink, a terminal or a disk has this long [s] to leave.
LAST_WORD = 1.0


class LinePipe:
    """A source and a sink of lines, as file descriptors.

    Inside ``with`` the signals of `ENDS` raise nothing: they set `signal` and wake the wait.

    Attributes
    ----------
    signal : int
        The signal that came first; 0 for none.
    signals : int
        How many have come.
    torn : bytes
        What followed the last newline when the source ended; of a file it is the last line.
    was_empty : bool
        Nothing waited to be read when `wait` was called last.
    sink_failed : bool
        The sink has failed, or did not take the last lines: it takes nothing more.
    """

    def __init__(self, source: int, sink: int) -> None:
        self.source, self.sink = source, sink
        self.signal = self.signals = 0
        self.torn = b""
        self.was_empty = False
        self.sink_failed = False

    def __enter__(self) -> LinePipe:
        def note(number: int, frame: FrameType | None) -> None:
            self.signal = self.signal or number
            self.signals += 1

        self._woken, self._wake = os.pipe()
        os.set_blocking(self._wake, False)
        self._incoming, self._outgoing, self._last_word = (select.poll() for _ in range(3))
        self._signalled = select.poll()
        self._incoming.register(self.source, select.POLLIN)
        self._incoming.register(self.sink, 0)  # tells of a reader that has left
        self._outgoing.register(self.sink, select.POLLOUT)
        self._last_word.register(self.sink, select.POLLOUT)
        for poll in (self._incoming, self._outgoing, self._signalled):
            poll.register(self._woken, select.POLLIN)
        self._handlers = {
            number: signal.signal(number, note)
            for number in ENDS
            if signal.getsignal(number) is not signal.SIG_IGN
        }
        self._old_wake = signal.set_wakeup_fd(self._wake, warn_on_full_buffer=False)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        signal.set_wakeup_fd(self._old_wake)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        os.close(self._wake)
        os.close(self._woken)

    def wait(self, timeout: float | None) -> bool:
        """Until there is something to read; False after `timeout` [s] or on a signal.

        Raises BrokenPipeError when the sink's reader has left.
        """
        ready = self._incoming.poll(0)
        self.was_empty = not ready
        if not ready:
            ready = self._incoming.poll(None if timeout is None else 1000 * min(timeout, LONGEST))
        for descriptor, event in ready:
            if descriptor == self.sink and event & (select.POLLERR | select.POLLNVAL):
                self.sink_failed = True
                raise BrokenPipeError
        return not self.signal and any(d == self.source for d, _ in ready)

    def pause(self, seconds: float) -> bool:
        """Let time pass, until a signal comes, and read nothing; False after the second signal.

        Parameters
        ----------
        seconds : float
        """
        if self.signals < 2 and self._signalled.poll(1000 * seconds):
            os.read(self._woken, READ_SIZE)
        return self.signals < 2

    def read(self) -> list[bytes] | None:
        """The lines that have arrived, without their ends; None at the end of the source.

        Raises
        ------
        LogError
            The source cannot be read.
        """
        try:
            chunk = os.read(self.source, READ_SIZE)
        except OSError as error:
            raise LogError(f"cannot be read: {error.strerror}") from error
        if not chunk:
            if not (self.torn and self._is_file()):
                return None
            lines, self.torn = [self.torn], b""
            return lines
        *lines, self.torn = (self.torn + chunk).split(b"\n")
        if len(self.torn) > LONGEST_LINE:
            lines.append(self.torn)
            self.torn = b""
        return lines

    def _is_file(self) -> bool:
        """Whether the source is a file, whose last line is whole without a newline."""
        try:
            return stat.S_ISREG(os.fstat(self.source).st_mode)
        except OSError:
            return False

    def write(self, data: bytes) -> None:
        """Write whole lines.

        Waits for a sink that is full, after a signal no longer than `LAST_WORD`: then what is
        left is dropped, between two lines. A sink that has failed takes nothing more.

        Raises
        ------
        OutputError
            Disk full, or the like.
        BrokenPipeError
            The reader has left.
        """
        while data and not self.sink_failed and self._writable():
            size = len(data)
            if size > PIPE_BUF:
                size = data.rfind(b"\n", 0, PIPE_BUF) + 1 or PIPE_BUF
            try:
                data = data[os.write(self.sink, data[:size]) :]
            except BrokenPipeError:
                self.sink_failed = True
                raise
            except OSError as error:
                self.sink_failed = True
                raise OutputError(f"<stdout>: {error.strerror}") from error

    def _writable(self) -> bool:
        if not self.signal and any(d == self.sink for d, _ in self._outgoing.poll()):
            return True
        self.sink_failed = not self._last_word.poll(1000 * LAST_WORD)
        return not self.sink_failed
