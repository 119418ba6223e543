"""The answer of a finished search: verdict, causes and what they are worth, what is left open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.alternatives import indistinguishable, suspected
from thermaltool.diagnosis.assumptions import STARTS
from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.gain import Gain
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.lasting import Recurrence, may_recur, recurrences
from thermaltool.diagnosis.noisy_states import noisy_states
from thermaltool.diagnosis.own_change import with_own_change
from thermaltool.diagnosis.residual_budget import (
    reading_noise,
    weigh_residuals,
    worst_logs,
)
from thermaltool.diagnosis.result import Alternative, Cause, Diagnosis, curves_of, unconfirmed
from thermaltool.diagnosis.search import HAS_CHANGED
from thermaltool.diagnosis.severity import (
    Severity,
    severity_of,
    severity_of_outliers,
)
from thermaltool.diagnosis.state import (
    WITHIN_CALIBRATION,
    DiagnosisTask,
    SearchState,
    judged_by,
)
from thermaltool.diagnosis.verdict import (
    nothing_moves,
    undecided,
    unknown_cause,
    verdict_of,
)
from thermaltool.diagnosis.written import account, explained
from thermaltool.effects.effect import Effect
from thermaltool.model import Model, with_acting_terms
from thermaltool.units import is_absolute, parse_channel, printed


def answer(task: DiagnosisTask, first: Hypothesis, search: SearchState) -> Diagnosis:
    """What is told of a finished search.

    Parameters
    ----------
    task : DiagnosisTask
    first : Hypothesis
        Without any cause.
    search : SearchState
    """
    last = search.hypothesis
    if starts := STARTS & search.ended.assumptions:
        # A state at the first row is none of the model's faults: it is told, and counts no more.
        first, last = (
            replace(each, assumptions=(each.assumptions - STARTS) | starts)
            for each in (first, last)
        )
    plain = first.with_model(task.model)
    fitted = search.written(task)
    effects = [c.effect for c in search.causes]
    # What is told of the written model comes from every reading.
    full = task.readings or task
    extended = replace(fitted, drives=full.model.drives)
    noise = {o: reading_noise(first, o) for o in first.groups}
    masked = last.simulation.masked if task.readings is None else search.left_out
    written = account(
        full.model, extended, effects, full.logs, full.validate, full.calibration, masked, noise,
        task.simulated, full.sound,
    )  # fmt: skip
    worse = search.spoiled(task, fitted) if full is not task else None
    if worse is not None and written.spoiled is None:
        written = replace(written, spoiled=f"{worse[1]} in {worse[0].name or 'a log'}")
    reports, budgets = weigh_residuals(first, plain, noise)
    ended = judged_by(last, task, fitted) if effects else search.ended
    worst = worst_logs(budgets)
    # Without a cause the written model is the one that came in, and what is left is what it leaves.
    after, left = reports, budgets
    if effects:
        after, left = weigh_residuals(ended, last.with_model(fitted), noise)
    elif HAS_CHANGED in search.notes:
        search = with_own_change(task, search, budgets, noise)
    changed = next((note for note in search.notes if note.startswith(HAS_CHANGED)), None)
    if any(effect.responds for effect in effects):  # what has changed is named
        search = replace(search, notes=tuple(n for n in search.notes if n != changed))
    unknown = None
    if not search.undecided:
        unknown = unknown_cause(left, budgets, after, ended, bool(search.causes))

    def told(cause: Cause, gain: Mapping[str, Gain] | None) -> Cause:
        if gain is None:  # no part of a model
            return replace(cause, explained=explained(noise, cause.gain))
        # Starts away from rest are fitted to averages.
        warm = full is not task and (bool(STARTS & ended.assumptions) or full.validate)
        judged = (task, fitted, last.simulation.masked) if warm else (full, extended, masked)
        share = judged[0].explained(judged[1], cause.effect, judged[2], noise, ended.assumptions)
        return replace(cause, gain=gain, explained=share)

    causes = [told(*each) for each in zip(search.causes, written.gains, strict=True)]
    if unknown is not None:
        causes.append(unknown)
        # The action of the unknown tells it.
        search = replace(search, notes=tuple(n for n in search.notes if n != changed))
    rests = None if causes or search.undecided else nothing_moves(first, budgets)
    if rests is not None:
        search = replace(search, undecided=rests)
    verdict = verdict_of(budgets, causes, search.undecided is not None)
    # No misfit of the model, so that the verdict stays.
    causes += noisy_states(ended)

    def severity(cause: Cause) -> Mapping[str, Severity]:
        if cause.severity:
            return cause.severity
        if cause.effect.name == "outliers":
            return severity_of_outliers(extended, full.logs, masked)
        return severity_of(extended, cause.effect, full.logs)

    resting = _resting(first)
    heats = [d.channel for d in task.model.drives if not is_absolute(d.channel)]
    idle = [name for name in resting if name in heats]
    begins = {log.digest: float(log.time[0]) for log in full.logs}

    def action(cause: Cause, moved: Mapping[str, Severity]) -> str:
        if cause is unknown and changed is not None:
            return changed
        if cause is unknown and idle and len(idle) == len(heats):
            return (
                f"{' and '.join(idle)} never {'acts' if len(idle) == 1 else 'act'} in these "
                f"logs, and yet {cause.effect.channel} moves: log what the machine did, or look "
                "for a source of heat that has no channel"
            )
        begun = begins.get(cause.effect.log or "", 0.0)
        return action_of(cause.effect, moved, noise, cause.location, begun)

    causes = [
        replace(
            c,
            severity=each,
            action=action(c, each),
            elsewhere=_elsewhere(full, extended, c.effect, noise),
        )
        for c, each in zip(causes, [severity(cause) for cause in causes], strict=True)
    ]
    if search.unconfirmed is not None and (search.causes or not search.suspects):
        search = search.noted(unconfirmed(search.unconfirmed.effect))
    for note in (
        *_changes(task.model, effects),
        *written.notes,
        *_averaged(task),
        *(_between(ended) if unknown is None else ()),
        *(f"{d} never acts in these logs: they say nothing of what it does" for d in resting),
        *_beginning(plain),
        *_off_as_well(task, causes[: len(effects)]),
    ):
        search = search.noted(note)
    alternatives: list[Alternative] = []
    if search.suspects and not search.causes:
        alternatives += suspected(search.ended, search.suspects, task.limits)
    places = [(e.name, e.channel, e.log) for e in effects]
    for each in search.verdicts:
        if each.candidate.place in places:  # not made idle by a later one
            task.progress(f"what else could be {each.candidate.effect.name}")
            alternatives += indistinguishable(
                each.before, each.candidate, each.rivals, effects, task.limits
            )
    open_questions = (search.undecided,) if search.undecided else undecided(first, budgets)
    return Diagnosis(
        verdict,
        min(budgets[at].accounted for at in worst.values()),
        {output: reports[at] for output, at in worst.items()},
        tuple(causes),
        (*alternatives, *search.unseen),
        search.tried,
        tuple(dict.fromkeys(search.notes)),
        _settled(extended),
        extended != full.model,
        written.steps,
        written.spoiled,
        open_questions if verdict == "cannot judge" else (),
        curves_of(first, plain, last.with_model(fitted) if effects else None),
        tuple(log.digest for log in full.sound),
        rests is not None,
        tuple(o.channel for o in task.model.outputs if o.judged and o.channel not in first.groups),
    )


def _settled(model: Model) -> Model:
    """The model with responses that have changed for good, and what changed them where it is from.

    Parameters
    ----------
    model : Model
    """
    changed = [e.document() for e in model.effects if e.responds and e.log is None]
    if not changed:
        return model
    found = with_acting_terms(model)
    return replace(found, provenance={**found.provenance, "changed": changed})


def _averaged(task: DiagnosisTask) -> Iterator[str]:
    """Of logs of very many rows, a sentence that says on what they were judged."""
    if task.readings is None:
        return
    for few, log in zip(
        (*task.logs, *task.validate, *task.sound),
        (*task.readings.logs, *task.readings.validate, *task.readings.sound),
        strict=True,
    ):
        if few.row_readings > 1:
            yield (
                f"{log.name}: causes were sought on averages of {few.row_readings} rows each; "
                "what the written model is worth is told of all rows"
            )


def _between(ended: Hypothesis) -> Iterator[str]:
    """A sentence on drives that switch between the rows of logs that are else explained."""
    at_rows = ended.assumptions - {"instants"}
    if at_rows != ended.assumptions and -ended.evidence_of(at_rows) > DECISIVE_EVIDENCE:
        yield (
            "the drives switch between the rows of these logs: when, within a row, is fitted "
            "beside each cause"
        )


def _beginning(plain: Hypothesis) -> Iterator[str]:
    """A sentence on each log that `simulate` finds to begin away from rest, and the search not."""
    if STARTS & plain.assumptions:
        return
    for k in plain.simulation.warm_logs:
        yield (
            f"{plain.logs[k].name or 'a log'} does not begin at rest, as simulate has it: what is "
            "left is told beside that start"
        )


def _resting(first: Hypothesis) -> list[str]:
    """The drives that act in no log."""
    return [
        drive.channel
        for drive in first.model.drives
        if not any(np.any(acting[drive.channel]) for acting in first.simulation.inputs)
    ]


def _elsewhere(
    task: DiagnosisTask, model: Model, effect: Effect, noise: Mapping[str, float]
) -> tuple[Recurrence, ...]:
    """Other logs that show what happened in one."""
    others = (*task.logs, *task.validate, *task.sound) if effect.log else ()
    others = tuple(log for log in others if log.digest != effect.log)
    return recurrences(model, effect, others, noise, task.calibrated_misfit)


def _off_as_well(task: DiagnosisTask, causes: Sequence[Cause]) -> Iterator[str]:
    """A sentence on each unseen log that is wrong, where no cause is found or accidents alone.

    One is wrong where its own diagnosis would say so.
    """
    if any(cause.effect.log is None for cause in causes):
        return
    other = ", not by the same" if all(may_recur(cause.effect) for cause in causes) else ""
    as_well = f" as well{other}, and stays so" if causes else ""
    same = {each.log for cause in causes for each in cause.elsewhere}
    known = corrected(task.model)
    for log in task.validate:
        if log.digest in same:
            continue
        # A machine that begins as a whole warmer than its surroundings is not wrong.
        alone = Hypothesis.of(known, (log,), known, WITHIN_CALIBRATION | {"uniform"})
        noise = {o: reading_noise(alone, o) for o in alone.groups}
        _, budgets = weigh_residuals(alone, alone.with_model(task.model), noise)
        off = {o: each for (o, _), each in budgets.items() if each.wrong}
        if off:
            worst = max(off, key=lambda o: off[o].total / off[o].white)
            unit = printed(parse_channel(worst).unit)
            yield (
                f"{log.name or 'an unseen log'} is wrong{as_well}: {worst} is off by "
                f"{off[worst].total:.3g} {unit} RMS; diagnose it, too"
            )


def _changes(model: Model, effects: Sequence[Effect]) -> Iterator[str]:
    """Of every cause that changes what the model came with, a sentence that says so."""
    for effect in effects:
        for own in model.effects:
            if (own.name, own.channel) == (effect.name, effect.channel):
                known = ", ".join(f"{name} {value:.4g}" for name, value in own.parameters.items())
                yield (
                    f"{effect.name} of {effect.channel} is added to the one that the model came "
                    f"with ({known}): what is told is the change"
                )
