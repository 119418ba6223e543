"""The state in which a log begins: at rest, or one that its readings say.

A machine that comes from elsewhere brings along what its modes have kept, also those that its
drives hardly move. That decays; how much of each decay there was follows from what was measured
before the rows that are judged, by least squares. One rule for all commands that compare a model
with a log.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.dynamics import lagged
from thermaltool.errors import LogError, counted
from thermaltool.model.decays import (
    START_TIME_CONSTANTS,
    free_decays,
    lag_decays,
    mode_decays,
    start_decays,
)
from thermaltool.model.rest import Zero, drive_rests, rest_shifts, zero_of
from thermaltool.model.simulate import (
    Course,
    acting_drives,
    acting_effects,
    with_acting_terms,
)
from thermaltool.record import Record, Rows
from thermaltool.responses.modes import Float

if TYPE_CHECKING:
    from thermaltool.model.document import Model, Output

Start = Literal["auto", "rest", "free"]

# Directions of the state weaker than this part of the strongest are left at rest.
MIN_SENSITIVITY = 1e-6
# Rows that a state is taken from at most: more say no more of so few unknowns.
MAX_STATE_ROWS = 20_000
# A log begins away from rest where a free state leaves less than this share of an output's errors
# (standard deviations), and the second half has no more either, or than the first quarter (a start
# that decays at once is little of a long log): else a drift goes on there.
# Asked in so many of its slowest time constants, of so many readings for each state.
MAX_LEFT_BY_STATE, MIN_TIME_CONSTANTS, MIN_ROWS_PER_STATE = 0.35, 2.0, 10
# ... and what it does later than so many of the slowest time constants is this share of all at
# most: what begins there is no start.
MAX_LATE, LATE_TIME_CONSTANTS = 0.5, 2.0
# ... and less than this share of what any other responses to the commanded drives leave: where one
# acts once, as the log begins, a wrong gain looks like a start.
MAX_LEFT_BESIDE_DRIVES = 0.5
# First readings that are off a known rest by more than this share of what the calibration has seen,
# before the model itself has moved by this part of that, are no wrong gain: a start then has to
# leave less than other responses to the drives, and no more. They lie within this share of the
# slowest time constant.
FIRST_READINGS, FIRST_OFF, FIRST_MOVED, FIRST_TIME = 5, 0.03, 0.3, 0.1


@dataclass(frozen=True)
class StartedOutput:
    """A measured output of a model over a log, with the state in which the log begins.

    Attributes
    ----------
    computed : ndarray, shape (n,) [unit of the output]
        Relative to rest.
    zero : Zero
        What the readings count from.
    initial : {"rest", "free"}
        At rest at the first row, or in a state that the readings say.
    """

    computed: Float
    zero: Zero
    initial: Literal["rest", "free"]


def started_outputs(
    model: Model,
    record: Record,
    simulated: Mapping[str, Float],
    initial: Start = "auto",
    rows: Rows | None = None,
) -> dict[str, StartedOutput]:
    """Every measured output of a model over a log, and what each counts from.

    "auto" takes the machine to be at rest at the first row unless its calibration did not begin at
    rest either, or some output says clearly that it is not: most of what the model leaves of it
    from rest is a start that decays, or its first readings are off a known zero, and its last are
    not. A machine is at rest as a whole, or not.

    Parameters
    ----------
    model : Model
    record : Record
        With the drives, and outputs that were measured.
    simulated : mapping of output to ndarray, shape (n,) [unit of the output]
        From rest, relative to it.
    initial : {"auto", "rest", "free"}
    rows : ndarray of bool, shape (n,), optional
        Those that say how the log begins. Default: all.

    Raises
    ------
    LogError
        Of "free": fewer readings than twice the states.
    """
    model = with_acting_terms(model, record.digest)
    rested = {
        o.channel: StartedOutput(
            simulated[o.channel],
            zero_of(record.time, record.columns[o.channel], simulated[o.channel], o.offset),
            "rest",
        )
        for o in model.outputs
        if o.channel in record.columns
    }
    if initial == "rest" or not rested or not len(record):
        return rested
    judged = np.ones(len(record), bool) if rows is None else rows
    shifted = set(rest_shifts(model, drive_rests(model, record)))
    course = Course.over(model, record)
    found = {}
    for o in model.outputs:
        if o.channel in rested:
            values = record.columns[o.channel]
            there = np.flatnonzero(judged & np.isfinite(values - simulated[o.channel]))
            is_zero_free = o.offset == "first" or o.channel in shifted
            state = _FreeState(model, o, record, there, is_zero_free, not judged.all(), course)
            found[o.channel] = state.fit(simulated[o.channel])
    if initial == "auto":
        known = any(o.fit.get("free_start") for o in model.outputs)
        if not any(fit.is_start(known) for fit in found.values()):
            return rested
    for channel, fit in found.items():
        if initial == "free" and not fit.is_determined:
            raise LogError(
                f"{channel}: {counted(len(fit.state.rows), 'reading')} before the rows that are "
                f"judged do not say in which of {len(fit.weights)} states the log begins: judge "
                "from a later row on",
                record.name,
            )
        if fit.is_determined:
            rested[channel] = fit.added(simulated[channel])
    return rested


@dataclass(frozen=True, eq=False)
class _StateFit:
    """What the first state of an output may be.

    Attributes
    ----------
    state : _FreeState
    decays_at : callable
        How the output may come to rest, shape (k, rows).
    weights : ndarray, shape (k,) [unit of the output]
        Of the decays, and of the zero where it is free.
    reaches, explains : bool
        Whether decays and zero are most of what the output is off by from rest; decays, of what it
        is off by beside its zero.
    is_over : bool
        ... and most of that, or of what the first quarter is off by, is over in the second half.
    begins_off : bool
        Whether the first readings are clearly off a rest that is known, and the last are not.
    """

    state: _FreeState
    decays_at: Callable[[NDArray[np.intp] | slice], Float]
    weights: Float
    reaches: bool = False
    explains: bool = False
    is_over: bool = False
    begins_off: bool = False

    def is_start(self, expected: bool) -> bool:
        """Whether the output says that the machine is not at rest, or is `expected` to be so."""
        if self.state.is_seen:
            says = self.explains or (self.begins_off and self.reaches)
            return (says and self.is_over) or expected
        if expected:
            # It needs no record that tells it from a drift or a gain.
            return self.reaches and self.state.is_sampled
        return self.state.is_seen_in_part and self.explains and self.is_over

    @property
    def is_determined(self) -> bool:
        """Whether there are readings enough to tell."""
        return len(self.state.rows) >= 2 * len(self.weights)

    def added(self, simulated: Float) -> StartedOutput:
        """The output with its state at the first row."""
        decays = self.decays_at(slice(None))
        computed = simulated + self.weights[: len(decays)] @ decays
        zero = self.state.stated
        if self.state.is_zero_free:
            zero += float(self.weights[-1])
        return StartedOutput(computed, Zero(zero), "free")


@dataclass(frozen=True, eq=False)
class _FreeState:
    """What an output may do at first beside what its drives do.

    Attributes
    ----------
    model : Model
    output : Output
    record : Record
    rows : ndarray of int
        That have a reading and say how the log begins.
    is_zero_free : bool
        No zero is stated, or it goes with a room, and the gain of the response to it is uncertain.
    is_forecast : bool
        What is judged are other rows: what many decays may do there is not what they do here.
    course : Course
        The machine's own time, and how much faster every mode has decayed.
    """

    model: Model
    output: Output
    record: Record
    rows: NDArray[np.intp]
    is_zero_free: bool
    is_forecast: bool
    course: Course

    @property
    def stated(self) -> float:
        """The zero from which deviations count."""
        return 0.0 if self.output.offset == "first" else self.output.offset

    @property
    def slowest(self) -> float:
        """Slowest time constant of the output [s]."""
        own = (t.response for t in self.model.terms if t.output == self.output.channel)
        return max((each.slowest() for each in own), default=0.0)

    @cached_property
    def is_sampled(self) -> bool:
        """Whether the rows are enough to tell any decay."""
        states = len(START_TIME_CONSTANTS) + self.is_zero_free
        return len(self.rows) >= MIN_ROWS_PER_STATE * states

    @cached_property
    def is_seen(self) -> bool:
        """Whether the rows are many and long enough to tell any decay, and a start from a drift."""
        time = self.record.time[self.rows]
        return self.is_sampled and float(np.ptp(time)) >= MIN_TIME_CONSTANTS * self.slowest

    @cached_property
    def is_seen_in_part(self) -> bool:
        """Whether the rows are many and long enough for some of the modes, slower ones apart."""
        if self.is_forecast or self.has_many_modes or not self.is_sampled:
            return False
        return len(self.told_modes(self.rows[:1])) > 0

    @cached_property
    def has_many_modes(self) -> bool:
        """Whether the output has more modes than are fitted one by one."""
        return not mode_decays(self.model, self.output.channel, np.zeros(1))

    def modes(self, rows: NDArray[np.intp] | slice = slice(None)) -> Float:
        """How the output may come to rest by the modes and lags of the model, shape (k, n)."""
        channel, elapsed = self.output.channel, self.course.clock[rows]
        own = free_decays(self.model, channel, elapsed, self.course.cooling[rows])
        effects = acting_effects(self.model, self.record.digest)
        return np.vstack(
            [own, *lag_decays(self.model, effects, channel, self.record.elapsed[rows])]
        )

    def told_modes(self, rows: NDArray[np.intp] | slice = slice(None)) -> Float:
        """Of the modes those that are over within the rows that say, shape (k, n)."""
        decays = self.modes(rows)
        judged = self.modes(self.rows[-1:])[:, 0]
        return decays[np.abs(judged) <= np.exp(-MIN_TIME_CONSTANTS)]

    def any_decays(self, rows: NDArray[np.intp] | slice = slice(None)) -> Float:
        """How the output may come to rest by modes that its drives hardly move, shape (k, n)."""
        slowest = self.slowest
        if self.is_zero_free:
            # What hardly decays in these rows is not told from the zero.
            slowest = min(slowest, float(np.ptp(self.record.time[self.rows])) / MIN_TIME_CONSTANTS)
        decays = start_decays(self.course.clock[rows], slowest, self.record.period)
        return decays * np.exp(-self.course.cooling[rows])

    @property
    def is_told_by_few(self) -> bool:
        """Whether the rows are too few, or others than those judged, for any but the modes."""
        expected = self.output.fit.get("free_start") or self.has_many_modes
        return self.is_forecast or not (self.is_seen or (self.is_sampled and expected))

    def fit(self, simulated: Float) -> _StateFit:
        """The state and the zero that fit the rows best.

        Any decays follow whatever is slow in a log: they are taken where what they do beside the
        modes of the model is a start by itself.
        """
        if self.is_told_by_few:
            decays_at = self.told_modes if self.is_seen_in_part else self.modes
            return self._fit(simulated, decays_at)[0]
        found, left = self._fit(simulated, self.any_decays)
        if self.has_many_modes:
            return found
        # What hardly decays is not told from a zero that is free.
        missed = self._fit(simulated, self.told_modes if self.is_zero_free else self.modes)[1]
        more = missed - left
        late, early = more[len(more) // 2 :], more[: len(more) // 4]
        is_start = float(np.std(late)) < MAX_LEFT_BY_STATE * float(np.std(early))
        if is_start and float(np.std(left)) < float(np.std(missed)):
            return found
        plain = self._fit(simulated, self.modes)[0]
        if plain.explains and plain.is_over:
            return plain
        # Whether there is a start at all is asked of whatever a machine may bring along.
        return replace(
            plain,
            reaches=found.reaches,
            explains=found.explains,
            is_over=found.is_over,
            begins_off=found.begins_off,
        )

    def _fit(
        self, simulated: Float, decays_at: Callable[[NDArray[np.intp] | slice], Float]
    ) -> tuple[_StateFit, Float]:
        """The state and the zero that fit the rows best by some decays, and what they leave."""
        # Imported on use: the stream reads models and needs no scipy.
        from scipy.linalg import lstsq

        rows = self.rows[:: max(-(-len(self.rows) // MAX_STATE_ROWS), 1)]
        off = self.record.columns[self.output.channel][rows] - simulated[rows] - self.stated
        decays = decays_at(rows)
        columns = np.vstack([decays, np.ones((int(self.is_zero_free), len(rows)))])
        if not 0 < 2 * len(columns) <= len(rows):
            return _StateFit(self, decays_at, np.zeros(len(columns))), off
        size = np.max(np.abs(columns), axis=1)
        size[size == 0] = 1.0
        table = columns.T / size
        found = np.asarray(lstsq(table, off, cond=MIN_SENSITIVITY)[0])
        left, early, late = off - table @ found, off[: len(off) // 4], off[len(off) // 2 :]
        most = MAX_LEFT_BY_STATE * float(np.std(off))
        at_once = self._begins_at_once((found / size)[: len(decays)] @ decays, rows)
        begins_off = at_once and self._begins_off(off, simulated, rows)
        explains = at_once and float(np.std(left)) < most
        if explains or begins_off:
            other = float(np.std(self._without_drives(off, rows)))
            explains &= float(np.std(left)) < MAX_LEFT_BESIDE_DRIVES * other
            begins_off &= float(np.std(left)) < other
        reaches = float(np.std(left)) < MAX_LEFT_BY_STATE * float(np.sqrt(np.mean(off**2)))
        is_over = float(np.std(late)) < max(most, MAX_LEFT_BY_STATE * float(np.std(early)))
        fitted = _StateFit(self, decays_at, found / size, reaches, explains, is_over, begins_off)
        return fitted, left

    def _begins_off(self, off: Float, simulated: Float, rows: NDArray[np.intp]) -> bool:
        """Whether the first readings are clearly off a known rest, and the last are not."""
        first, late = slice(0, FIRST_READINGS), off[len(off) // 2 :]
        begun = abs(float(np.median(off[first])))
        moved = float(np.max(np.abs(simulated[rows[first]])))
        return (
            not self.is_zero_free
            and float(self.course.clock[rows[first]][-1]) < FIRST_TIME * self.slowest
            and begun > FIRST_OFF * max(map(abs, self.output.range))
            and moved < FIRST_MOVED * begun
            and float(np.sqrt(np.mean(late**2))) < MAX_LEFT_BY_STATE * begun
        )

    def _begins_at_once(self, decay: Float, rows: NDArray[np.intp]) -> bool:
        """Whether most of a way to rest lies in the first time constants."""
        ahead = np.abs(decay - decay[-1])
        late = self.course.clock[rows] > LATE_TIME_CONSTANTS * self.slowest
        return float(np.max(ahead[late], initial=0.0)) <= MAX_LATE * float(np.max(ahead))

    def _without_drives(self, off: Float, rows: NDArray[np.intp]) -> Float:
        """What is left of the errors where the responses to the drives are others."""
        model, record = self.model, self.record
        acting = acting_drives(model, acting_effects(model, record.digest), record)
        own = {t.drive for t in model.terms if t.output == self.output.channel}
        drives = [d for d in model.drives if d.channel in own]
        drives = [d for d in drives if d.hold == "zero"] or drives  # a room may look like anything
        lags = [
            lagged(record.time, acting[d.channel], share * self.slowest, d.hold)[rows]
            for d in drives
            for share in START_TIME_CONSTANTS
        ]
        table = np.column_stack([np.ones(len(rows)), *lags])
        table /= np.maximum(np.max(np.abs(table), axis=0), np.finfo(float).tiny)
        return off - table @ np.linalg.lstsq(table, off, rcond=MIN_SENSITIVITY)[0]
