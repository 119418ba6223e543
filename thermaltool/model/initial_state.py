"""The state in which a log begins, where the machine was not at rest: from the rows before a time.

A machine that comes from elsewhere brings along what its modes have kept. That decays with the
modes of the terms; how much of each there was follows from what was measured before the rows that
are judged, by least squares.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.linalg import lstsq

from thermaltool.errors import LogError
from thermaltool.model.rest import Zero, zero_of
from thermaltool.model.simulate import Course, acting_effects, sum_terms
from thermaltool.record import Record, Rows
from thermaltool.responses.modes import Float

if TYPE_CHECKING:
    from thermaltool.model.document import Model, Output

Start = Literal["rest", "free"]

# Modes of an output above which it is taken to come from other levels of its drives, at which it
# had settled: a state of many modes is not told by a few rows.
MAX_FREE_MODES = 8
# Poles that differ by less than this part are one.
SAME_POLE = 1e-6
# Directions of the state weaker than this part of the strongest are left at rest.
MIN_SENSITIVITY = 1e-6


def with_initial_state(
    model: Model, output: Output, record: Record, simulated: Float, initial: Start, rows: Rows
) -> tuple[Float, Zero]:
    """One output of a model over a log, relative to rest, and what it counts from.

    Parameters
    ----------
    model : Model
    output : Output
        That was measured.
    record : Record
        With the output.
    simulated : ndarray, shape (n,) [unit of the output]
        From rest, relative to it.
    initial : {"rest", "free"}
        The machine is at rest at the first row, or in a state that the rows say.
    rows : ndarray of bool, shape (n,)
        Those that count for a free state.

    Returns
    -------
    computed : ndarray, shape (n,) [unit of the output]
    zero : Zero

    Raises
    ------
    LogError
        Fewer rows than twice the states.
    """
    time, measured = record.time, record.column(output.channel)
    if initial == "rest":
        return simulated, zero_of(time, measured, simulated, output.offset)
    decays = free_decays(model, output.channel, *_course(model, record))
    columns = np.vstack([decays, np.ones((int(output.offset == "first"), len(time)))])
    stated = 0.0 if output.offset == "first" else output.offset
    left = measured - simulated - stated
    there = rows & np.isfinite(left)
    if there.sum() < 2 * len(columns):
        raise LogError(
            f"{output.channel}: {there.sum()} readings before the rows that are judged do not say "
            f"in which of {len(columns)} states the log begins: judge from a later row on",
            record.name,
        )
    size = np.max(np.abs(columns), axis=1, keepdims=True)
    found = lstsq((columns / size)[:, there].T, left[there], cond=MIN_SENSITIVITY)[0]
    weights = np.asarray(found) / size[:, 0]
    computed = simulated + weights[: len(decays)] @ decays
    return computed, Zero(stated if output.offset != "first" else float(weights[-1]))


def _course(model: Model, record: Record) -> tuple[Float, Float]:
    """The machine's own time since the first row [s], and Γ there [1]."""
    states = [e for e in acting_effects(model, record.digest) if e.side == "state"]
    if not states:
        return record.elapsed, np.zeros(len(record))
    effects = acting_effects(model, record.digest)
    course = Course.of(states, record, sum_terms(model, effects, record))
    return course.clock - course.clock[0], course.cooling


def free_decays(model: Model, channel: str, elapsed: Float, cooling: Float | None = None) -> Float:
    """How an output can come to rest with all drives at rest, shape (k, n).

    Each mode of its terms, or, where these are many, each term from a level of its drive at which
    it had settled.

    Parameters
    ----------
    model : Model
    channel : str
    elapsed : ndarray, shape (n,) [s]
        Since the first row.
    cooling : ndarray, shape (n,), optional
        Γ, the integral of the rate by which all decays faster.
    """
    responses = [t.response for t in model.terms if t.output == channel]
    modes = [each.modes(model.sample_period) for each in responses]
    found: list[complex] = []
    columns: list[Float] = []
    for each in modes:
        for pole, double in zip(each.poles, each.double, strict=True):
            if not any(abs(pole - other) <= SAME_POLE * abs(pole) for other in found):
                found.append(complex(pole))
                decay = np.exp(pole * elapsed)
                columns += [decay.real, *([decay.imag] if pole.imag else [])]
                columns += [elapsed * decay.real] if double else []
    if len(columns) > MAX_FREE_MODES:
        columns = [each.dc_gain() - each.step(elapsed) for each in responses]
    found_decays = np.array(columns).reshape(-1, len(elapsed))
    return found_decays if cooling is None else found_decays * np.exp(-cooling)
