"""What the model that is written makes of every log, run as `simulate` runs it.

A diagnosis fits more than it writes: lags, starts and offsets beside the model. What is told of a
cause is therefore measured once more, with the file that a user gets and nothing beside it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermaltool.diagnosis.gain import MIN_LOSS_COUNTED, Gain, compare
from thermaltool.diagnosis.readings import as_readings, hidden_noise
from thermaltool.diagnosis.simulation import Mask, SimulatedLogs
from thermaltool.diagnosis.starts import start_free as free_of_start
from thermaltool.effects.effect import Effect, Float
from thermaltool.errors import ModelError
from thermaltool.model import Model, agreements
from thermaltool.record import Record
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.signals.detrend import difference_sigma
from thermaltool.units import is_temperature, kelvins

# The zero of a sensor moves from so many times the RMS of what else is left.
MIN_ZERO_MOVE = 5.0
# ... and by no more than it moved in the calibration, a temperature by this [K] at most: two
# thermocouples of class 2 and their converters differ by less.
MAX_ZERO_MOVE = 10.0
# What the fit of an output in a model file says of how it agrees with logs.
FIT_STATISTICS = ("rmse", "rmse_zero_free", "max_error", "fit_percent", "rows")


@dataclass(frozen=True)
class WrittenStep:
    """A model on one output of one log, as `simulate` counts.

    Attributes
    ----------
    step : int
        How many causes the model holds.
    cause : Effect or None
        The last one of them.
    log : str
        Digest.
    output : str
    agreement : Agreement
        The start and the zero as `simulate` has them.
    """

    step: int
    cause: Effect | None
    log: str
    output: str
    agreement: Agreement

    def document(self) -> dict[str, Any]:
        """As JSON."""
        cause = self.cause
        return {
            "step": self.step,
            "cause": None if cause is None else {"name": cause.name, "channel": cause.channel},
            "log": self.log,
            "output": self.output,
            "rmse": self.agreement.rmse,
            "zero_off_by": self.agreement.mean,
            "rmse_zero_free": self.agreement.rmse_zero_free,
            "fit_percent": self.agreement.fit_percent,
            "rows": self.agreement.rows,
        }


def steps_of(model: Model, extended: Model, causes: Sequence[Effect]) -> list[Model]:
    """The model that came in, and with one cause more at a time, up to the extended one.

    What else the extended model changes, it changes with the first cause; outliers, which are left
    out of the readings, are none.

    Parameters
    ----------
    model, extended : Model
    causes : sequence of Effect
    """
    models = [model]
    for k in range(len(causes)):
        if all(cause.name == "outliers" for cause in causes[: k + 1]):
            models.append(model)
            continue
        rest = tuple(e for e in extended.effects if e not in causes[k + 1 :])
        models.append(replace(extended, effects=rest))
    return models


def written_steps(
    models: Sequence[Model], causes: Sequence[Effect], logs: Sequence[Record]
) -> tuple[WrittenStep, ...]:
    """Every model on every output of every log.

    Parameters
    ----------
    models : sequence of Model
        See `steps_of`.
    causes : sequence of Effect
    logs : sequence of Record
    """
    found = []
    for step, (cause, model) in enumerate(zip([None, *causes], models, strict=True)):
        simulated = SimulatedLogs(model, tuple(logs), {})
        for k, log in enumerate(logs):
            for output in simulated.started[k]:
                fit = agreement(*simulated.as_simulated(output)[k])
                found.append(WrittenStep(step, cause, log.digest, output, fit))
    return tuple(found)


def gains_of(
    before: SimulatedLogs,
    after: SimulatedLogs,
    zero_free: Callable[[str], bool],
    start_free: Collection[int] | None = None,
) -> dict[str, Gain]:
    """Gain of every output over the same logs, both models as they stand.

    Parameters
    ----------
    before, after : SimulatedLogs
    zero_free : callable
        Of an output: whether its errors count about their mean in each log.
    start_free : collection of int, optional
        Logs in which they count about any start that fits them best, and in others from rest.
        Without it the logs begin as `simulate` has it.
    """

    def errors(runs: SimulatedLogs, output: str) -> Float:
        groups = before.groups[output]
        if start_free is None:
            found = [measured - computed for measured, computed in runs.as_simulated(output)]
        else:
            found = runs.residual(output)
            free = free_of_start(runs, output) if start_free else found
            found = [free[k] if k in start_free else each for k, each in enumerate(found)]
        if zero_free(output):
            found = [
                error - error[rows].mean() if len(rows) else error
                for error, rows in zip(found, groups.rows, strict=True)
            ]
        return groups.joined(found)

    return {
        output: compare(
            before.measured_rows(output),
            errors(before, output),
            errors(after, output),
            hidden=hidden_noise(before, output),
        )
        for output in before.groups
    }


def rezeroed(model: Model, logs: Sequence[Record], masked: Mask) -> Model:
    """The model with the zeros that logs have: a sensor's zero is that of the last time.

    A zero moves where all logs say so, by more than they differ, and by so much that what else is
    left is small beside it, and by no more than the outputs of the calibration spread, or some
    kelvin: beyond that it is a sensor that does not measure. What counts from its first readings
    has none.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    masked : mapping of (digest, output) to ndarray of bool
        Outliers: rows that do not count.
    """
    simulated = SimulatedLogs(model, tuple(logs), masked)
    # A reading that repeats itself says nothing of its zero.
    frozen = {effect.channel for effect in model.effects if effect.name == "sensor_frozen"}
    outputs = []
    for o in model.outputs:
        groups = simulated.groups.get(o.channel)
        if o.offset != "first" and groups is not None and o.channel not in frozen:
            residual = simulated.residual(o.channel)
            own = [r[k] for r, k in zip(residual, groups.rows, strict=True) if len(k)]
            off = np.array([np.mean(each) for each in own])
            least = max(MIN_ZERO_MOVE * max(float(np.std(each)) for each in own), np.ptp(off))
            most = float(np.ptp(o.range))
            if is_temperature(o.channel):
                most = max(most, MAX_ZERO_MOVE / kelvins(o.channel))
            if np.min(np.abs(off)) > least and np.max(np.abs(off)) < most:
                o = replace(o, offset=o.offset + float(np.mean(off)))
        outputs.append(o)
    return replace(model, outputs=tuple(outputs))


def with_agreements(model: Model, logs: Sequence[Record]) -> Model:
    """The model with the errors that `simulate` finds in logs, in place of those of its making.

    An output that no log has tells none: what it was before is that of another model.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    """
    outputs = []
    for o in model.outputs:
        judged = [log for log in logs if o.channel in log.columns and not cannot_run(model, log)]
        # Instants of switches are those of the calibration's own fit.
        dropped = (*FIT_STATISTICS, "instants")
        kept = {key: value for key, value in o.fit.items() if key not in dropped}
        if judged:
            found = agreements(model, judged, [o])[o.channel].document()
            kept |= {key: found[key] for key in FIT_STATISTICS if found[key] is not None}
        outputs.append(replace(o, fit=kept))
    return replace(model, outputs=tuple(outputs))


def cannot_run(model: Model, log: Record) -> str | None:
    """Why a model cannot be run over a log; None where it can.

    Parameters
    ----------
    model : Model
    log : Record
    """
    try:
        model.simulate(log)
    except ModelError as error:
        return str(error)
    return None


def spoiled_by(
    before: Model,
    after: Model,
    logs: Sequence[Record],
    masked: Mask,
    noise: Mapping[str, float],
    surely: bool = False,
) -> tuple[Record, str] | None:
    """Log and output of which a model is worse than another beyond noise; None where it is not.

    Worse as `simulate` counts, which finds out how the log begins, or with the zero of the log
    free; outliers do not count.

    Parameters
    ----------
    before, after : Model
    logs : sequence of Record
    masked : mapping of (digest, output) to ndarray of bool, shape (rows of the log,)
        Outliers: rows that do not count.
    noise : mapping of output to float [unit of the output]
        Of a reading; from the readings themselves where it is not there.
    surely : bool
        Worse on other logs as well, by bootstrap; on these very rows by default.

    Raises
    ------
    ModelError
        A model cannot be run over a log.
    """
    if before == after:
        return None
    is_worse = Gain.worse if surely else Gain.lost
    for log in logs:
        old, new = (SimulatedLogs(m, (log,), masked) for m in (before, after))
        free = gains_of(old, new, lambda output: True)
        counted = gains_of(old, new, lambda output: False)
        for output in old.groups:
            sigma = noise.get(output) or difference_sigma(
                as_readings(old, output, old.residual(output))
            )
            if is_worse(free[output], sigma) or is_worse(counted[output], sigma, MIN_LOSS_COUNTED):
                return log, output
    return None


@dataclass(frozen=True)
class WrittenAccount:
    """What the written model is worth.

    Attributes
    ----------
    steps : tuple of WrittenStep
        Of every log over which the models can be run.
    gains : tuple of (mapping of output to Gain, or None), one for each cause
        None where a cause changes nothing of the model.
    spoiled : str or None
        Log and output of which the extended model is worse than the one that came in.
    notes : tuple of str
    """

    steps: tuple[WrittenStep, ...]
    gains: tuple[Mapping[str, Gain] | None, ...]
    spoiled: str | None
    notes: tuple[str, ...]


def account(
    model: Model,
    extended: Model,
    causes: Sequence[Effect],
    logs: Sequence[Record],
    validate: Sequence[Record],
    calibration: Sequence[Record],
    masked: Mask,
    noise: Mapping[str, float],
    simulated: Mapping[str, Record],
    sound: Sequence[Record] = (),
) -> WrittenAccount:
    """The written model beside the one that came in, on all logs.

    Parameters
    ----------
    model, extended : Model
    causes : sequence of Effect
        In the order of acceptance.
    logs, validate, calibration : sequence of Record
        Diagnosed, unseen, and the calibration's. Gains are those on the unseen ones, where there
        are some; the calibration's are no veto.
    masked, noise
        As in `spoiled_by`.
    simulated : mapping of digest to Record
        Logs as `simulate` has them, where that is otherwise.
    sound : sequence of Record
        Unseen as well, without what is wrong: no gain is told of them.
    """
    models, notes, spoiled = steps_of(model, extended, causes), [], None
    every = (*logs, *validate, *sound, *calibration)
    why = {id(log): cannot_run(extended, log) for log in every}
    for log in every:
        if why[id(log)] is not None:
            notes.append(f"{_name(log)} cannot be run by the written model: {why[id(log)]}")
    own, unseen, healthy, before = (
        [log for log in group if why[id(log)] is None]
        for group in (logs, validate, sound, calibration)
    )
    if len(own) < len(logs):
        spoiled = next(_name(log) for log in logs if why[id(log)] is not None)
    elif worse := spoiled_by(model, extended, [*own, *unseen, *healthy], masked, noise):
        spoiled = f"{worse[1]} in {_name(worse[0])}"
    if worse := spoiled_by(model, extended, before, masked, noise, surely=True):
        since = "the machine has changed since, or the cause is another"
        if any(cause.responds for cause in causes):
            since = "it is the machine as it has become"
        notes.append(
            f"{worse[1]} in {_name(worse[0])}, a log of the calibration, is worse by the written "
            f"model: {since}"
        )
    gains: list[Mapping[str, Gain] | None] = []
    for cause, (one, other) in zip(causes, itertools.pairwise(models), strict=True):
        # What happened in one log is worth something there alone.
        judged = tuple(own if cause.log is not None else unseen or own)
        runs = [SimulatedLogs(each, judged, masked) for each in (one, other)]
        gains.append(gains_of(runs[0], runs[1], lambda output: True) if one != other else None)
    told = [simulated.get(log.digest, log) for log in (*own, *unseen, *healthy, *before)]
    steps = written_steps(models, causes, told)
    return WrittenAccount(steps, tuple(gains), spoiled, tuple(notes))


def _name(log: Record) -> str:
    return log.name or "a log"


def explained(noise: Mapping[str, float], gains: Mapping[str, Gain]) -> float:
    """Share of the misfit above noise that is gone, the channels weighed by their noise.

    Parameters
    ----------
    noise : mapping of output to float [unit of the output]
        Of a reading.
    gains : mapping of output to Gain
    """
    before = after = 0.0
    for output, g in gains.items():
        if output not in noise:  # measured in unseen logs alone
            continue
        before += max((g.rms_before / noise[output]) ** 2 - 1, 0.0)
        after += max((g.rms_after / noise[output]) ** 2 - 1, 0.0)
    return float(np.clip(1 - after / before, 0.0, 1.0)) if before else 0.0
