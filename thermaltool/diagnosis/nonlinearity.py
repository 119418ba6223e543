"""What a model leaves that only products and powers of drives and output explain.

A search among causes finds something for every misfit: a period for a curve, a conversion for a
reaction. Of a machine that is not linear the test of linearity says so at once, and what a cause
takes of that says whether it is the reason or stands for another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.simulation import SimulatedLogs, without
from thermaltool.diagnosis.state import DiagnosisTask, SearchState
from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.fitting.data import Array, even_training_data
from thermaltool.fitting.linearity import LinearityTest, linearity_test
from thermaltool.model import Model, started_outputs
from thermaltool.record import Record

# Columns that hold what a model simulates, and the course of a source that nobody logged.
SIMULATED, COURSE = "x_simulated_1", "x_course_1"
# Share of what linear terms leave that products and powers explain where a machine is not linear
# in the first place; and what a cause may leave of that power.
MIN_NONLINEAR, MAX_LEFT = 0.5, 0.5
# Of single readings, of the record, of its clock: nothing of these stands for a curve.
BESIDE = frozenset(("outliers", "noise_state", "record_too_short", "unknown"))


@dataclass(frozen=True)
class _SimulatedOutput:
    """One output of a model document as the test of linearity takes it."""

    model: Model
    names: tuple[str, ...]
    target: str
    zeros: tuple[float, ...]

    @property
    def sample_delays(self) -> tuple[int, ...]:
        return (0,) * len(self.names)

    def simulate(self, record: Record) -> Array:
        """What the model gave over the log, effects included."""
        return record.column(SIMULATED)

    def response_to(self, record: Record) -> Array:
        """Of the terms alone, drives counting from zero."""
        return self.model.simulate(record)[self.target]


def nonlinearity(
    model: Model, logs: Sequence[Record], output: str, beside: Sequence[str] = ()
) -> LinearityTest | None:
    """Test of what a model leaves of one output; None where the logs are too few.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    output : str
    beside : sequence of str
        Channels that may act, too, linearly and in products.
    """
    own = next(o for o in model.outputs if o.channel == output)
    drives = dict.fromkeys(t.drive for t in model.terms if t.output == output)
    names = tuple(dict.fromkeys((*drives, *beside)))
    parts = []
    try:
        for log in logs:
            if output in log.columns:
                started = started_outputs(model, log, model.simulate(log))[output]
                level = started.computed + started.zero.value
                parts.append(log.with_columns({SIMULATED: level}))
        data = even_training_data(parts, (*names, SIMULATED), (output,)).driven_by(names)
        moved = np.ptp(np.hstack(data.u), axis=1)
        if not moved.any():
            return None
        data = data.driven_by([n for n, span in zip(names, moved, strict=True) if span > 0])
        linear = replace(
            model,
            drives=tuple(
                replace(d, reference=0.0, rest=None)
                for d in model.drives
                if d.channel in data.inputs
            ),
            outputs=(own,),
            terms=tuple(t for t in model.terms if t.output == output and t.drive in data.inputs),
            effects=(),
            redundancy=None,
        )
        zeros = (0.0,) * data.experiments
        return linearity_test(_SimulatedOutput(linear, data.inputs, output, zeros), data)
    except (FitError, LogError, ModelError, IndexError):
        return None


def nonlinear_power(test: LinearityTest | None) -> float:
    """Share of the output's power that products and powers explain of the error; 0 for none.

    Parameters
    ----------
    test : LinearityTest or None
    """
    if test is None or not test.nonlinear:
        return 0.0
    linear, whole = (1 - fit / 100 for fit in (test.linear_fit_percent, test.nonlinear_fit_percent))
    return max(linear**2 - whole**2, 0.0)


def is_bent(test: LinearityTest | None) -> bool:
    """Whether most of what linear terms leave is products and powers.

    Parameters
    ----------
    test : LinearityTest or None
    """
    return test is not None and test.nonlinear and test.explained >= MIN_NONLINEAR


def explains_more(without: LinearityTest | None, with_channel: LinearityTest | None) -> bool:
    """Whether a channel explains what products and powers of the others do not.

    Parameters
    ----------
    without, with_channel : LinearityTest or None
        Of one output, with the drives of the model alone and with the channel beside them.
    """
    if without is None or with_channel is None:
        return False
    if not is_bent(with_channel):
        return True
    left, less = (1 - test.nonlinear_fit_percent / 100 for test in (without, with_channel))
    return less**2 <= MAX_LEFT * left**2


def stands_for_another(
    effect: Effect, before: LinearityTest | None, after: LinearityTest | None
) -> bool:
    """Whether a cause is none, for what a model leaves is bent otherwise.

    Parameters
    ----------
    effect : Effect
    before, after : LinearityTest or None
        Of the model without any cause, and with all of them.
    """
    if effect.name in BESIDE or not is_bent(before):
        return False
    if not (effect.bends or effect.channel):
        return True
    return is_bent(after) and nonlinear_power(after) > MAX_LEFT * nonlinear_power(before)


def stand_ins(task: DiagnosisTask, search: SearchState) -> list[tuple[Cause, str]]:
    """Causes that stand for a curve which is none of them, and what the record says of it.

    Parameters
    ----------
    task : DiagnosisTask
    search : SearchState
    """
    causes = [cause for cause in search.causes if cause.effect.name not in BESIDE]
    if not causes:
        return []
    model, logs = task.model, task.logs
    before = {o: nonlinearity(model, logs, o) for o in search.hypothesis.groups}
    # What the calibration left is no news of these logs.
    known = task.calibrated_misfit
    bent = {
        o: test
        for o, test in before.items()
        if test is not None and is_bent(test) and _bend(test, logs, o) > known.get(o, 0.0)
    }
    if not bent:
        return []
    written = search.written(task)
    after = {o: nonlinearity(written, logs, o) for o in bent}
    own = {d.channel for d in model.drives} | {o.channel for o in model.outputs}
    found = []
    for cause in causes:
        effect = cause.effect
        # A channel that the model lacks may be what products of the others stand for.
        lacked = () if effect.bends or effect.channel in own | {""} else (effect.channel,)
        moved = SimulatedLogs(without(written, effect), tuple(logs), {}).displacement(effect)
        for output, test in bent.items():
            change = moved.get(output)
            if change is None or not any(np.any(each) for each in change):
                continue  # it acts on another output alone
            if lacked and explains_more(test, nonlinearity(model, logs, output, lacked)):
                continue
            if not effect.channel:
                course = [
                    log.with_columns({COURSE: c}) for log, c in zip(logs, change, strict=True)
                ]
                if explains_more(test, nonlinearity(model, course, output, (COURSE,))):
                    continue
            if stands_for_another(effect, test, after[output]):
                found.append((cause, f"{output} is not linear, {_reached(test)}"))
                break
    return found


def _bend(test: LinearityTest, logs: Sequence[Record], output: str) -> float:
    """RMS of what products and powers explain of the error [unit of the output]."""
    logged = [log.column(output) for log in logs if output in log.columns]
    # Each about its own mean: logs have zeros of their own.
    about = np.concatenate([values - np.nanmean(values) for values in logged])
    return float(np.sqrt(nonlinear_power(test)) * np.nanstd(about))


def _reached(test: LinearityTest) -> str:
    return (
        f"linear models reach {test.linear_fit_percent:.3g} %, with products and powers "
        f"{test.nonlinear_fit_percent:.3g} % (most: {test.term}): see what identify says of it"
    )
