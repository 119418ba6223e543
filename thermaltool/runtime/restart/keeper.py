"""What a stream keeps so that a restart makes no step, and how it begins from that."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from thermaltool.errors import ModelError, OutputError
from thermaltool.runtime.clocks import LineClock
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.process import Process
from thermaltool.runtime.restart.checkpoint import REMEDY, Checkpoint, Kept
from thermaltool.runtime.restart.journal import SetpointJournal
from thermaltool.runtime.settings import Settings

if TYPE_CHECKING:
    from thermaltool.runtime.rows.merger import Merger


def open_restart(
    process: Process, settings: Settings, messages: Messages, merger: Merger | None = None
) -> Restart:
    """What a process keeps by its settings; no file is touched yet.

    Raises
    ------
    ValueError
        A start is given for a set point that is not there, or not for each.
    """
    path, names = settings.checkpoint, process.names[: len(process.values())]
    return Restart(
        process,
        messages,
        settings,
        _start(settings.at, names),
        Checkpoint(path, process.digest) if path else None,
        SetpointJournal(path, names) if path and names else None,
        merger,
    )


def _start(at: Mapping[str, float] | float | None, names: Sequence[str]) -> list[float] | None:
    """Where each actuator stands, as the user says."""
    if at is None or isinstance(at, float):
        return None if at is None else [at] * len(names)
    for name in (*at, *names):
        if name not in names:
            raise ValueError(f"no set point {name}; there are: {', '.join(names)}")
        if name not in at:
            raise ValueError(f"where the actuator of {name} stands is not said")
    return [at[name] for name in names]


@dataclass
class Restart:
    """The state of a stream on disk, and where its actuators stand.

    Attributes
    ----------
    process : Process
    messages : Messages
    settings : Settings
    start : list of float or None
        Where the actuators stand, where the user says it.
    checkpoint : Checkpoint or None
    journal : SetpointJournal or None
        Where they stood when the last line left.
    merger : Merger or None
        Whose row waits for the rest of its messages.
    """

    process: Process
    messages: Messages
    settings: Settings
    start: list[float] | None = None
    checkpoint: Checkpoint | None = None
    journal: SetpointJournal | None = None
    merger: Merger | None = None
    _clock: dict[str, Any] | None = field(default=None, init=False)
    _age: float = field(default=0.0, init=False)
    _saved_at: float | None = field(default=None, init=False)
    _keeps: bool = field(default=False, init=False)

    @property
    def taken(self) -> bool:
        """Whether another stream has the actuators."""
        return self.journal is not None and self.journal.taken

    def begin(self) -> str:
        """Begin where an earlier run stopped, or where the user says; returns from what.

        Raises
        ------
        ModelError
            The checkpoint is none of this process, or damaged; it stays as it is.
        OutputError
            Another stream runs on it, or nothing can be kept there.
        """
        if self.checkpoint is not None:
            self.checkpoint.check_folder()
        standing = self.journal.open() if self.journal is not None else None
        where = self.start if self.start is not None else standing
        if where is not None:
            # Before the state, which may be refused: the way to the safe set point begins there.
            self.process.stand_at(where)
        kept = self.checkpoint.load() if self.checkpoint is not None else None
        begin = self.process.begins
        if kept is not None:
            with self._whole_checkpoint():
                begin = self._resume(kept)
        if where is not None:
            self.process.stand_at(where)
        elif kept is not None and self.journal is not None:
            self.messages("", "no set points of the last line: from those of the kept state; "
                          "--at says where the actuators stand")  # fmt: skip
        self._keeps = True
        return begin

    def _resume(self, kept: Kept) -> str:
        if kept.damage:
            self.messages("", f"{kept.damage}: the state before it is taken")
        longest = self.settings.checkpoint_max_age
        if kept.age > longest:
            # The machine has changed since; where its actuators stand has not.
            self.process.stand_at([value for value, _ in kept.state["setpoints"]])
            return (
                f"from rest: the kept state is {kept.age:.3g} s old (--checkpoint-max-age "
                f"{longest:g})"
            )
        # A wall clock that was put back says nothing.
        self._age = kept.age if kept.age >= 0 else math.nan
        self._clock = kept.state["clock"]
        self._clock.items()
        self.process.resume(kept.state, self._age)
        if self.merger is not None and kept.state.get("pending") is not None:
            self.merger.resume(kept.state["pending"])
        return f"from the state of {kept.age:.3g} s ago"

    def resume_clock(self, clock: LineClock) -> None:
        """Let the clock of the lines go on, where a state was resumed."""
        if self._clock is not None and self.process.time is not None:
            with self._whole_checkpoint():
                clock.resume(self._clock, self.process.time, self._age)

    def record(self, values: Sequence[float]) -> None:
        """Keep where the actuators stand after the line that leaves next."""
        if self.journal is not None:
            try:
                self.journal.record(values)
            except OutputError as error:
                self.messages("", f"set points not kept: {error}")

    def save(self, clock: LineClock | None, at_once: bool = False) -> None:
        """Keep the state, where it is time or `at_once`."""
        time = self.process.time
        if self.checkpoint is None or time is None:
            return
        every = self.settings.checkpoint_every
        if at_once or self._saved_at is None or abs(time - self._saved_at) >= every:
            self._saved_at = time
            try:
                self.checkpoint.save(self._state(clock))
            except OutputError as error:
                self.messages("", f"checkpoint not written: {error}")

    def close(self, clock: LineClock | None) -> None:
        """Keep the last state; raises OutputError. A checkpoint that was refused stays."""
        try:
            if self.checkpoint is not None and self._keeps:
                self.checkpoint.close(self._state(clock))
        finally:
            if self.journal is not None:
                self.journal.close()

    def _state(self, clock: LineClock | None) -> dict[str, Any]:
        state = {"clock": clock.state() if clock else self._clock or {}, **self.process.state()}
        return state if self.merger is None else {**state, "pending": self.merger.state()}

    @contextlib.contextmanager
    def _whole_checkpoint(self) -> Iterator[None]:
        try:
            yield
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            path = self.checkpoint.path if self.checkpoint else ""
            raise ModelError(f"{path}: a checkpoint that is damaged; {REMEDY}") from error
