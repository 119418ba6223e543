"""What a stream does with its rows: the plug-in that every streaming command provides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from thermaltool.runtime.clock_check import ClockCheck
from thermaltool.runtime.messages import Report
from thermaltool.runtime.rows.row import Row

# What is written for a row: a time [s] (None where none is known; of a sink's also a stamp, as the
# lines have them) and one finite number per name, never -0.0; under a name of WORDS a word.
Reply = tuple[Any, Sequence[Any]]


class Process:
    """Rows in, replies out; no input or output here.

    A subclass sets `columns`, `names`, `period`, `clock` and `report`, and provides `step`; the
    other methods where they mean something for it.

    Attributes
    ----------
    columns : tuple of str
        That are read.
    names : tuple of str
        That are written behind the time.
    period : float [s] or None
        Sample period; also the time between two replies to silence. None where it is not known.
    clock : ClockCheck
    report : callable
        Gets (channel, message) once per change of state.
    actuates : bool
        Whether replies move something: then only usable lines count as heard, and the last reply
        is the safe one, whatever ends the stream.
    patience : float [s]
        How long the source may be silent, where the user does not say.
    digest : str
        Identifies whose state a checkpoint is.
    clock_advice : str
        What a user can do about a stream without a clock.
    time : float [s] or None
        Of the last row that was accepted.
    accepted : int
        Rows that moved the clock.
    begins : str
        Where it starts without a kept state, for the first message.
    title : str
        What is run, for the first message; empty for none.
    status : str
        What the last reply rests on; empty where there is nothing to say of it.
    """

    columns: tuple[str, ...]
    names: tuple[str, ...]
    period: float | None
    clock: ClockCheck
    report: Report
    actuates = False
    patience = math.inf
    digest = ""
    clock_advice = "--period gives one to a stream without"
    time: float | None = None
    accepted = 0
    begins = "from rest"
    title = ""
    status = ""

    def take(self, row: Row) -> Reply | None:
        """The reply to a row; one whose time is refused leaves everything as it is.

        Raises
        ------
        LogError
            The rows are not what this process is for.
        """
        time = row.time
        # A time that is no number would stay in the clock, and with it in every later setpoint.
        if time is None or not math.isfinite(time):
            fault = next(filter(None, row.faults), "") if time is None else ""
            self.report("", f"{fault or 'no time on this line'}: ignored")
            return self.repeat()
        seconds = self.clock.take(time)
        if seconds is None:
            return self.repeat()
        self.time = time
        self.accepted += 1
        return self.step(row, seconds)

    def step(self, row: Row, seconds: float) -> Reply | None:
        """Advance by a row, so long after the one before (0 for the first); None for no reply."""
        raise NotImplementedError

    def repeat(self) -> Reply | None:
        """The reply to a line that is refused."""
        return None

    def silence(self, elapsed: float) -> Reply | None:
        """The reply to nothing, `elapsed` [s] after the last line that was heard."""
        return None

    @property
    def at_safe(self) -> bool:
        """Whether silence changes nothing any more."""
        return True

    def finish(self) -> Sequence[float] | None:
        """The last values, which are safe for good; None for none."""
        return None

    def summary(self) -> str:
        """What is said at the end; nothing where it is empty."""
        return ""

    def values(self) -> Sequence[float]:
        """Where the actuators stand that are set; nothing where none is."""
        return ()

    def stand_at(self, values: Sequence[float]) -> None:
        """Begin where the actuators stand."""

    def state(self) -> dict[str, Any]:
        """All that a restart needs, as JSON."""
        return {}

    def resume(self, state: dict[str, Any], age: float = 0.0) -> None:
        """Go on from `state`, which was left `age` [s] ago; NaN where nobody knows.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not one of this process.
        """
