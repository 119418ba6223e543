"""Simulation of whole records: the block form of `thermaltool.model.step`.

What acts in place of every drive, the sums of the terms, and what is read of them; the same
effects and the same responses as row by row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.effects.effect import SIDES, Effect, Memory, Outputs, needed
from thermaltool.errors import ModelError
from thermaltool.model.rest import drive_rests, relative, rest_shifts
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.varying_loss import run_with_loss

if TYPE_CHECKING:
    from thermaltool.model.document import Model, Term

# By which a drive acts, whatever happens to it before.
LAWS_OF_DRIVES = ("drive_nonlinearity", "drive_curve")
# What changes with the state may depend on the outputs: the record is repeated until the integral
# of the loss [1] and the machine's own time [duration] change by less than this, and at most so
# often.
STATE_TOLERANCE, MAX_STATE_ITERATIONS = 1e-7, 60
# The same beside a model that differs little.
NEAR_TOLERANCE = 1e-5
# Beyond this rise of the integral of a varying loss [1] in one sample nothing is followed.
MAX_SAMPLE_COOLING = 50.0


def simulate(model: Model, record: Record) -> dict[str, Float]:
    """Outputs of every channel, relative to rest; see `Model.simulate`.

    Parameters
    ----------
    model : Model
    record : Record
        The drives, without NaN, and what the effects need.
    """
    effects = acting_effects(model, record.digest)
    return read_outputs(effects, sum_terms(model, effects, record), record)


def acting_effects(model: Model, digest: str | None = None) -> tuple[Effect, ...]:
    """The effects that act in a record of this digest: those of every record, and its own.

    What happens to a drive comes before the law by which it acts: a voltage saturates, its square
    heats.

    Parameters
    ----------
    model : Model
    digest : str, optional
    """
    own = (e for e in model.effects if e.log in (None, digest))
    return tuple(sorted(own, key=lambda effect: effect.name in LAWS_OF_DRIVES))


def acting_drives(model: Model, effects: Sequence[Effect], record: Record) -> dict[str, Float]:
    """What acts in place of every drive, relative to its reference; each by its dead time later.

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
        Those that act.
    record : Record

    Returns
    -------
    dict of channel to ndarray, shape (n,)

    Raises
    ------
    ModelError
        A drive is missing.
    """
    result = {}
    for drive in model.drives:
        if drive.channel not in record.columns:
            raise ModelError(f"the model's drive {drive.channel} is not in the log")
        u = relative(record.columns[drive.channel], drive.reference, drive.hold)
        for effect in effects:
            if effect.side == "drive" and effect.channel == drive.channel:
                u = effect.drive(record, u)
        result[drive.channel] = u
    return result


def acting_terms(model: Model, effects: Sequence[Effect]) -> tuple[Term, ...]:
    """The terms with the responses that act in place of their own.

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
        Those that act.
    """
    terms = model.terms
    for effect in effects:
        if effect.responds:
            terms = tuple(
                replace(t, response=effect.response(t.response, t.drive, t.output)) for t in terms
            )
    return terms


def with_acting_terms(model: Model, digest: str | None = None) -> Model:
    """A model whose terms are those that act in every record, instead of effects on them.

    Parameters
    ----------
    model : Model
    digest : str, optional
        Of a record, in which those that are its own act, too.
    """
    lasting = [e for e in acting_effects(model, digest) if e.responds]
    rest = tuple(e for e in model.effects if e not in lasting)
    return replace(model, terms=acting_terms(model, lasting), effects=rest) if lasting else model


def dead_times(model: Model, effects: Sequence[Effect]) -> dict[str, float]:
    """Time by which every drive acts later than it is logged [s].

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
        Those that act.
    """
    return {
        drive.channel: sum(
            e.dead_time for e in effects if (e.side, e.channel) == ("drive", drive.channel)
        )
        for drive in model.drives
    }


def term_input(model: Model, term: Term, inputs: Mapping[str, Float], record: Record) -> Float:
    """What a term takes of its drive, one of `inputs`: all of it, or its level's share.

    Parameters
    ----------
    model : Model
    term : Term
    inputs : mapping of channel to ndarray, shape (n,)
    record : Record
    """
    if term.band is None:
        return inputs[term.drive]
    chooser = term.band.channel
    hold: Hold = next((d.hold for d in model.drives if d.channel == chooser), "zero")
    values = relative(needed(record, chooser), model.reference(chooser), hold)
    return inputs[term.drive] * term.band.share(values)


def sum_terms(
    model: Model,
    effects: Sequence[Effect],
    record: Record,
    near: Mapping[str, Float] | None = None,
) -> dict[str, Float]:
    """Sums of the terms of every output: what the machine does, before sources and sensors.

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
        Those that act.
    record : Record
    near : mapping of channel to ndarray, shape (n,), optional
        Sums of a model that differs little: the state is taken from there to begin with, and
        repeated less often.

    Returns
    -------
    dict of channel to ndarray, shape (n,)

    Raises
    ------
    ModelError
        A loss of heat that does not settle to one course.
    """
    inputs = acting_drives(model, effects, record)
    holds = {d.channel: d.hold for d in model.drives}
    late = dead_times(model, effects)
    terms = acting_terms(model, effects)
    acting = [term_input(model, term, inputs, record) for term in terms]
    states = [e for e in effects if e.varies]

    moves = any(drive.rest is not None for drive in model.drives)
    shifts = rest_shifts(model, drive_rests(model, record)) if moves else {}

    def sums(course: Course | None) -> dict[str, Float]:
        outputs = {
            o.channel: np.full(len(record.time), shifts.get(o.channel, 0.0)) for o in model.outputs
        }
        for term, u in zip(terms, acting, strict=True):
            outputs[term.output] += simulate_response(
                term.response, record.time, u, holds[term.drive], course, late[term.drive]
            )
        return outputs

    if not states:
        return sums(None)
    if near is None:
        tolerance, course, outputs = STATE_TOLERANCE, Course.of([], record, {}), sums(None)
    else:
        tolerance, course = NEAR_TOLERANCE, Course.of(states, record, near)
        outputs = sums(course)
    for _ in range(MAX_STATE_ITERATIONS):
        before, course = course, Course.of(states, record, outputs)
        if course.differs(before) < tolerance:
            return outputs
        outputs = sums(course)
    raise ModelError(f"{states[0].name}: the loss of heat does not settle to one course")


def state_rates(
    effects: Sequence[tuple[Effect, Memory]], record: Record, outputs: Mapping[str, Float]
) -> tuple[Float, Float]:
    """By how much modes decay faster [1/s], and the factor of the machine's own time, at each row.

    Parameters
    ----------
    effects : sequence of (Effect, memory)
        On the state; None for a whole record.
    record : Record
    outputs : mapping of channel to ndarray, shape (n,)
        Relative to rest.
    """
    rate, pace = np.zeros(len(record.time)), np.ones(len(record.time))
    for effect, memory in effects:
        if (more := effect.loss(record, outputs, memory)) is not None:
            rate = rate + more
        if (factor := effect.pace(record, outputs, memory)) is not None:
            pace = pace * factor
    return rate, pace


@dataclass(frozen=True)
class Course:
    """How the state of a machine changes what its responses are.

    Attributes
    ----------
    clock : ndarray, shape (n,) [s]
        Its own time at every row: x' = a(t)·(A x + B u) is x' = A x + B u in ∫ a dt.
    cooling : ndarray, shape (n,)
        Γ, the integral of a rate by which every mode decays faster. Each mode z' = −(λ + Γ')z + u
        is that of e^Γ u without Γ, times e^(−Γ).
    """

    clock: Float
    cooling: Float

    @classmethod
    def of(cls, effects: Sequence[Effect], record: Record, outputs: Mapping[str, Float]) -> Course:
        """By effects on the state, each sample as its first row has it.

        Parameters
        ----------
        effects : sequence of Effect
        record : Record
        outputs : mapping of channel to ndarray, shape (n,)
            Relative to rest.
        """
        steps = np.diff(record.time)
        # A loss that runs away with what it changes is found further on, by what is not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            rate, pace = state_rates([(effect, None) for effect in effects], record, outputs)
            clock = np.append(0.0, np.cumsum(pace[:-1] * steps))
            return cls(record.time[:1] + clock, np.append(0.0, np.cumsum(rate[:-1] * steps)))

    @classmethod
    def over(cls, model: Model, record: Record) -> Course:
        """Over a log by a model and the effects that act in it, its clock from 0 at the first row.

        Parameters
        ----------
        model : Model
        record : Record
        """
        effects = acting_effects(model, record.digest)
        states = [e for e in effects if e.varies]
        if not states:
            return cls(record.elapsed, np.zeros(len(record)))
        course = cls.of(states, record, sum_terms(model, effects, record))
        return cls(course.clock - course.clock[0], course.cooling)

    def differs(self, other: Course) -> float:
        """Largest difference of the cooling [1], or of the clock [its duration].

        Parameters
        ----------
        other : Course
        """
        duration = np.ptp(other.clock) or 1.0
        clocks = np.max(np.abs(self.clock - other.clock), initial=0.0) / duration
        return float(max(clocks, np.max(np.abs(self.cooling - other.cooling), initial=0.0)))


def read_outputs(
    effects: Sequence[Effect], outputs: Mapping[str, Float], record: Record
) -> dict[str, Float]:
    """What is read of `outputs`: sources, structure, sensors, wiring, in this order.

    Parameters
    ----------
    effects : sequence of Effect
        Those that act.
    outputs : mapping of channel to ndarray, shape (n,)
        Relative to rest.
    record : Record
    """
    result: Outputs = dict(outputs)
    for effect in sorted(effects, key=lambda e: SIDES.index(e.side)):
        result = effect.read(result, record)
    return dict(result)


def simulate_response(
    response: Response,
    time: Float,
    u: Float,
    hold: Hold,
    course: Course | None = None,
    dead_time: float = 0.0,
) -> Float:
    """One response to any input at any (increasing) times; at rest at the first.

    Parameters
    ----------
    time, u : ndarray, shape (n,)
    hold : "zero" or "first"
    course : Course, optional
        How the state changes the response.
    dead_time : float [s]
        Time by which the input acts later; below zero, earlier.

    Returns
    -------
    y : ndarray, shape (n,)

    Raises
    ------
    ModelError
        The loss of heat spans more than can be followed.
    """
    if len(time) < 2:
        return np.zeros(len(time))
    known: Any = response  # frozen, therefore hashable
    modes = _modes(known, float(np.min(np.diff(time))))
    if course is None:
        return modes.at(time, u, hold, time - dead_time) if dead_time else modes.run(time, u, hold)
    if not np.max(np.abs(np.diff(course.cooling))) < MAX_SAMPLE_COOLING:
        raise ModelError("the loss of heat changes too much in a sample to be followed")
    moments, u = _acting_clock(time, u, hold, dead_time) if dead_time else (time, u)
    along, own = np.interp(moments, time, course.cooling), np.interp(moments, time, course.clock)
    rows = np.searchsorted(moments, time)
    return run_with_loss(modes, own, u, hold, along)[rows] + modes.direct * u[rows]


def _acting_clock(time: Float, u: Float, hold: Hold, dead_time: float) -> tuple[Float, Float]:
    """The clock's moments and those at which the late input changes, and what acts there."""
    acting = time + dead_time
    clock = np.unique(np.concatenate([time, acting[acting < time[-1]]]))
    if hold == "first":
        return clock, np.interp(clock, acting, u, left=0.0)
    row = np.searchsorted(acting, clock, side="right") - 1
    return clock, np.where(row < 0, 0.0, u[row])


@lru_cache(maxsize=256)
def _modes(response: Any, shortest: float) -> Modes:
    return response.modes(shortest)
