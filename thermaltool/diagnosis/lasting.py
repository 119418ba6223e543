"""Other logs in which what happened in one lasts from their first row on, or happens again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.written import cannot_run
from thermaltool.effects.effect import Effect
from thermaltool.model import Model
from thermaltool.record import Record

# A log is wrong from this many times the power of noise and of the calibration's own error, and
# shows the same trouble where a change as large leaves less than this share of the power above: it
# is then between half and one and a half times as large.
MIN_TIMES_ALLOWED, MAX_LEFT = 4.0, 0.25
# Instants of another log that are tried.
INSTANTS = 23


@dataclass(frozen=True)
class Recurrence:
    """Another log that shows what happened in one.

    Attributes
    ----------
    log : str
        Digest.
    time : float or None [s]
        How long after the first row it happened there; None where it lasts from the first row on.
    """

    log: str
    time: float | None


def may_recur(effect: Effect) -> bool:
    """Whether an effect changes something in one log from its ``time`` on.

    Parameters
    ----------
    effect : Effect
    """
    return effect.event and effect.log is not None and "time" in effect.parameters


def recurrences(
    model: Model,
    effect: Effect,
    logs: Sequence[Record],
    noise: Mapping[str, float],
    misfit: Mapping[str, float],
) -> tuple[Recurrence, ...]:
    """Other logs that show a change of the same outputs, and as large; as `simulate` counts.

    Parameters
    ----------
    model : Model
        As written, with the effects.
    effect : Effect
        For others than `may_recur` says, the result is empty.
    logs : sequence of Record
        The others.
    noise, misfit : mapping of output to float [unit of the output]
        Noise of a reading, and what the calibration was off by beside it.
    """
    if not may_recur(effect):
        return ()
    known = {(e.name, e.channel, e.log) for e in model.effects}
    allowed = {
        o: max(n**2 + misfit.get(o, 0.0) ** 2, np.finfo(float).tiny) for o, n in noise.items()
    }
    found = []
    for log in logs:
        if (effect.name, effect.channel, log.digest) in known or cannot_run(model, log):
            continue
        before = _above(model, log, allowed)
        if not any(above > (MIN_TIMES_ALLOWED - 1) * allowed[o] for o, above in before.items()):
            continue
        span = float(log.time[-1] - log.time[0])
        instants = log.time[0] + span * np.arange(1, INSTANTS + 1) / (INSTANTS + 1)
        left = []
        for time in (None, *instants.tolist()):
            # Before the first row, it lasts.
            at = log.time[0] - max(span, 1.0) if time is None else time
            there = replace(effect.changed({"time": at}), log=log.digest)
            after = _above(replace(model, effects=(*model.effects, there)), log, allowed)
            moved = [o for o in before if after[o] != before[o]]
            worst = max(moved, key=lambda o: before[o] / allowed[o], default=None)
            if worst is not None and before[worst] > (MIN_TIMES_ALLOWED - 1) * allowed[worst]:
                left.append((after[worst] / before[worst], time))
        # What lasts needs no instant.
        lasts = [each for each in left if each[1] is None and each[0] < MAX_LEFT]
        share, time = min(lasts or left, key=lambda each: each[0], default=(np.inf, None))
        if share < MAX_LEFT:
            into = None if time is None else time - float(log.time[0])
            found.append(Recurrence(log.digest, into))
    return tuple(found)


def _above(model: Model, log: Record, allowed: Mapping[str, float]) -> dict[str, float]:
    """Power of what a model leaves of each output above what is allowed, none below zero."""
    runs = SimulatedLogs(model, (log,), {})
    power = {}
    for output in runs.groups:
        measured, computed = runs.as_simulated(output)[0]
        if output in allowed:
            mean_square = float(np.nanmean(np.square(measured - computed)))
            power[output] = max(mean_square - allowed[output], 0.0)
    return power
