"""Simulation of whole records: the block form of `thermaltool.model.step`.

What acts in place of every drive, the sums of the terms, and what is read of them; the same
effects and the same responses as row by row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.effects.effect import SIDES, Effect, needed
from thermaltool.errors import ModelError
from thermaltool.model.rest import relative
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.responses.modes import Float, Hold, Modes

if TYPE_CHECKING:
    from thermaltool.model.document import Model, Term

# The loss of heat may depend on the outputs: the record is repeated until the integral of the rate
# changes by less than this [1], and at most so often.
LOSS_TOLERANCE, MAX_LOSS_ITERATIONS = 1e-6, 12
# Beyond this span of the integral of a varying loss [1] the weights e^Γ overflow.
MAX_COOLING_SPAN = 300.0


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


def acting_effects(model: Model, digest: str) -> tuple[Effect, ...]:
    """The effects that act in a record of this digest: those of every record, and its own.

    Parameters
    ----------
    model : Model
    digest : str
    """
    return tuple(e for e in model.effects if e.log in (None, digest))


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


def sum_terms(model: Model, effects: Sequence[Effect], record: Record) -> dict[str, Float]:
    """Sums of the terms of every output: what the machine does, before sources and sensors.

    Parameters
    ----------
    model : Model
    effects : sequence of Effect
        Those that act.
    record : Record

    Returns
    -------
    dict of channel to ndarray, shape (n,)
    """
    inputs = acting_drives(model, effects, record)
    holds = {d.channel: d.hold for d in model.drives}
    late = dead_times(model, effects)
    acting = [term_input(model, term, inputs, record) for term in model.terms]
    losses = [e for e in effects if e.side == "state"]

    def sums(cooling: Float | None) -> dict[str, Float]:
        outputs = {output.channel: np.zeros(len(record.time)) for output in model.outputs}
        for term, u in zip(model.terms, acting, strict=True):
            outputs[term.output] += simulate_response(
                term.response, record.time, u, holds[term.drive], cooling, late[term.drive]
            )
        return outputs

    outputs, cooling = sums(None), np.zeros(len(record.time))
    for _ in range(MAX_LOSS_ITERATIONS if losses else 0):
        # A loss that runs away with what it changes is found further on, by what is not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            rates = [r for e in losses if (r := e.loss(record, outputs)) is not None]
        total = np.sum(rates, axis=0) if rates else np.zeros(len(record.time))
        exponent = np.append(0.0, np.cumsum(total[:-1] * np.diff(record.time)))
        change, cooling = float(np.max(np.abs(exponent - cooling))), exponent
        if change < LOSS_TOLERANCE:
            break
        outputs = sums(cooling)
    return outputs


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
    result = dict(outputs)
    for effect in sorted(effects, key=lambda e: SIDES.index(e.side)):
        result = {name: effect.output(name, result, record) for name in result}
    return result


def simulate_response(
    response: Response,
    time: Float,
    u: Float,
    hold: Hold,
    cooling: Float | None = None,
    dead_time: float = 0.0,
) -> Float:
    """One response to any input at any (increasing) times; at rest at the first.

    Parameters
    ----------
    time, u : ndarray, shape (n,)
    hold : "zero" or "first"
    cooling : ndarray, shape (n,), optional
        Γ, the integral of a rate by which every mode decays faster. Each mode z' = −(λ + Γ')z + u
        is that of e^Γ u without Γ, times e^(−Γ).
    dead_time : float [s]
        Time by which the input acts later; below zero, earlier.

    Returns
    -------
    y : ndarray, shape (n,)

    Raises
    ------
    ModelError
        Γ spans more than can be followed.
    """
    if len(time) < 2:
        return np.zeros(len(time))
    known: Any = response  # frozen, therefore hashable
    modes = _modes(known, float(np.min(np.diff(time))))
    if cooling is None:
        return modes.at(time, u, hold, time - dead_time) if dead_time else modes.run(time, u, hold)
    if not np.ptp(cooling) < MAX_COOLING_SPAN:
        raise ModelError("the loss of heat changes too much over this log to be followed")
    centred = cooling - (cooling.max() + cooling.min()) / 2
    clock, u = _acting_clock(time, u, hold, dead_time) if dead_time else (time, u)
    along = np.interp(clock, time, centred)
    # A held drive acts, on the mean, half a sample later than its first moment.
    inside = np.append((along[1:] + along[:-1]) / 2, along[-1])
    y = modes.run(clock, u * np.exp(inside if hold == "zero" else along), hold)
    return y[np.searchsorted(clock, time)] * np.exp(-centred)


def _acting_clock(time: Float, u: Float, hold: Hold, dead_time: float) -> tuple[Float, Float]:
    """The clock's moments and those at which the late input changes, and what acts there."""
    acting = time + dead_time
    clock = np.unique(np.concatenate([time, acting[acting < time[-1]]]))
    if hold == "first":
        return clock, np.interp(clock, acting, u, left=0.0)
    row = np.searchsorted(acting, clock, side="right") - 1
    return clock, np.where(row < 0, 0.0, u[row])


@lru_cache(maxsize=64)
def _modes(response: Any, shortest: float) -> Modes:
    return response.modes(shortest)
