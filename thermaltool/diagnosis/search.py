"""The search for causes, one after another, until what is left is noise or none explains it.

Forward selection: at each step the whole catalogue is scored against what is left over, the best
few are fitted, and the strongest is accepted if its evidence is decisive after correction for the
number of causes tried, if it helps on data that its fit has not seen, and if what it explains is
not smaller than the error that the model had on its clean calibration. Backward check: what later
causes made idle is taken out again, and so is what the written model has no use for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.alternatives import tried_causes
from thermaltool.diagnosis.assumptions import STARTS, Assumptions, released
from thermaltool.diagnosis.balance import balance
from thermaltool.diagnosis.confirm import (
    Confirmation,
    begun,
    confirmation,
    confirmed_unseen,
    is_freed,
)
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.no_signature import (
    beyond_calibration,
    is_trend,
    too_short,
    uncovered,
)
from thermaltool.diagnosis.pruning import pruned, rest_of
from thermaltool.diagnosis.select import Ranking, ranked
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.sound_logs import MIN_MISFIT, are_silent, misfit, sound_logs
from thermaltool.diagnosis.state import DiagnosisTask, SearchState
from thermaltool.diagnosis.written import cannot_run, gains_of

# Causes that are named at most.
MAX_CAUSES = 6
# Without sound logs a search counts where it leaves at most this share of the power above noise.
MAX_LEFT = 0.5
HAS_CHANGED = (
    "the model's own parameters have changed since the calibration, beyond its uncertainty: "
    "calibrate again"
)


def searched(task: DiagnosisTask, start: SearchState) -> tuple[DiagnosisTask, SearchState]:
    """The finished search, and the task in which unseen logs without what is wrong are apart.

    On a log that the model as it came fits a cause does not act yet, so that none would hold there.

    Parameters
    ----------
    task : DiagnosisTask
    start : SearchState
        Without any cause.
    """
    search = _found(task, start)
    if task.own or _stands(task, start, search):
        return task, search
    sound = sound_logs(task)
    if not sound:
        return task, search
    apart = task.apart(sound)
    again = _found(apart, start)
    noise = start.hypothesis.white
    left = _left(apart, again, noise)
    if not again.causes or not np.isfinite(left) or left > MAX_LEFT * _left(task, search, noise):
        return task, search
    for log in apart.sound:
        name = log.name or "a log"
        again = again.noted(
            f"{name}, which the model as it came fits, says nothing of this: what causes it is "
            "never there"
            if are_silent(again, log)
            else f"nothing of this is in {name}, which the model as it came fits: the machine has "
            "changed between the logs, or the cause is another"
        )
    return apart, again


def _stands(task: DiagnosisTask, start: SearchState, search: SearchState) -> bool:
    """Whether a search leaves nothing, by a model that makes no log worse."""
    if search.spoiled(task, search.written(task)) is not None:
        return False
    return rest_of(task, start.hypothesis, search) is None


def _found(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search to its end, without the causes that do not stand."""
    first = search.hypothesis
    return pruned(task, first, _second_look(task, _forward(task, search)))


def _left(task: DiagnosisTask, search: SearchState, noise: Callable[[str], float]) -> float:
    """Power that the written model leaves of the worst output, over that of noise, less one."""
    model = search.written(task)
    if search.spoiled(task, model) is not None:
        # It is not written: what came in stays.
        model = task.model
    if any(cannot_run(model, log) is not None for log in task.logs):
        return np.inf
    runs = SimulatedLogs(model, task.logs, search.hypothesis.simulation.masked)
    gains = gains_of(runs, runs, lambda output: True, runs.warm_logs)
    return max(((g.rms_before / noise(o)) ** 2 - 1 for o, g in gains.items()), default=0.0)


# ---------------------------------------------------------------- forward


def _forward(task: DiagnosisTask, search: SearchState) -> SearchState:
    """Causes one after another, until none is left or they are enough."""
    while not search.exhausted and len(search.causes) < MAX_CAUSES:
        search = _step(task, search)
    return search


def _step(task: DiagnosisTask, search: SearchState) -> SearchState:
    """One more cause, or the end of the search."""
    hypothesis = search.hypothesis
    blind = {p for each in search.unseen for p in zip(each.names, each.channels, strict=True)}
    calibrated: tuple[SearchState, Hypothesis, Ranking] | None = None
    while True:
        ranking = ranked(hypothesis, blind, task.progress)
        # Of the last assumptions before the first cause: what a start says is none's evidence.
        if not search.causes:
            search = replace(search, tried=tried_causes(hypothesis, ranking))
        told = [c for c in ranking.fitted if not is_trend(c.effect, task.model, task.logs)]
        ranking = replace(ranking, fitted=told)
        better = ranking.better_assumptions()
        outcome = Confirmation()
        if better is None:
            outcome = confirmation(task, search, hypothesis, ranking)
            if outcome.found is not None:
                return outcome.found
            better = outcome.start
        if better is None:
            suspects = [c for c in ranking.strong(0.0) if not outcome.refuses(c)]
            found = confirmed_unseen(task, search, hypothesis, ranking, suspects)
            found = found or _too_short(task, search, hypothesis)
            found = found or _of_calibrated_model(task, search, hypothesis, calibrated)
            return found or replace(
                search,
                ended=hypothesis,
                unconfirmed=outcome.of_logs[0] if outcome.of_logs else None,
                suspects=tuple(ranking.strong(0.0)),
                exhausted=True,
            )
        before = search, hypothesis, ranking
        search, changed = _own_change(task, search, hypothesis, better)
        if changed is None:
            return search
        if is_freed(hypothesis, changed):
            calibrated = before
        hypothesis = changed


def _of_calibrated_model(
    task: DiagnosisTask,
    search: SearchState,
    freed: Hypothesis,
    calibrated: tuple[SearchState, Hypothesis, Ranking] | None,
) -> SearchState | None:
    """The search with a first cause beside the model as calibrated, where a free one is no help.

    None where the free model leaves noise, and where no cause stands.
    """
    if calibrated is None or search.causes:
        return None
    if rest_of(task, search.hypothesis, replace(search, ended=freed)) is None:
        return None
    before, hypothesis, ranking = calibrated
    plain = [c for c in ranking.fitted if "released" not in c.assumptions]
    return confirmation(task, before, hypothesis, replace(ranking, fitted=plain)).found


def _too_short(
    task: DiagnosisTask, search: SearchState, hypothesis: Hypothesis
) -> SearchState | None:
    """The search with a calibration that was too short as its first cause; None where it was not.

    Where nothing else is one: what such a calibration leaves open explains these logs.
    """
    if search.causes or not uncovered(task.model) or "tight" not in hypothesis.assumptions:
        return None
    freed = hypothesis.under(released(hypothesis.assumptions), task.model).fitted()
    return _with_left_open(task, search, hypothesis, freed)


def _with_left_open(
    task: DiagnosisTask, search: SearchState, hypothesis: Hypothesis, freed: Hypothesis
) -> SearchState | None:
    """The search where what too short a calibration leaves open explains the logs; else None.

    It is a cause where they go further than the calibration; logs that do not cannot judge.
    """
    cause = too_short(task.model, hypothesis, freed)
    if cause is None:
        return None
    if beyond_calibration(task.model, task.logs):
        return search.accepting(cause, freed)
    why = (
        f"{cause.effect.channel}: the calibration covers {cause.effect.parameters['covered']:.2g} "
        "of the slowest time constants, and what that leaves open explains this log: calibrate on "
        "one that lasts three of them"
    )
    return replace(search, ended=freed, undecided=why, exhausted=True)


def _own_change(
    task: DiagnosisTask, search: SearchState, hypothesis: Hypothesis, better: Assumptions
) -> tuple[SearchState, Hypothesis | None]:
    """What the model itself has to say, more than any cause: it did not begin at rest, or changed.

    The hypothesis is None where the search has its step: a calibration that was too short, or logs
    that cannot judge.
    """
    changed = hypothesis.under(better, task.model)
    if is_freed(hypothesis, changed):
        changed = changed.fitted()
        if (found := _with_left_open(task, search, hypothesis, changed)) is not None:
            return found, None
        if beyond := beyond_calibration(task.model, task.logs):
            output, length = next(iter(beyond.items()))
            why = (
                f"{output}: the calibration lasts {length:.0f} s, too short to see a steady "
                f"state, and this log {max(log.duration for log in task.logs):.0f} s: "
                "calibrate on a log as long"
            )
            return replace(search, ended=changed, undecided=why, exhausted=True), None
        return search.noted(HAS_CHANGED), changed
    if "uniform" in better:
        return begun(search, better), changed
    # What a short calibration has not seen may pass for a start: it comes first.
    freed = hypothesis.under(released(hypothesis.assumptions), task.model).fitted()
    found = _with_left_open(task, search, hypothesis, freed)
    # Beside a longer calibration nothing is left of what only looked like a start.
    beside = (freed.assumptions - STARTS) | (better & STARTS)
    started = freed.evidence_of(beside) > DECISIVE_EVIDENCE
    if found is not None and not started:
        return found, None
    return begun(search, better), changed


def _second_look(task: DiagnosisTask, search: SearchState) -> SearchState:
    """Slow causes on the calibration's own log, where a slow discrepancy explains as much.

    Without a clean calibration nothing says how large a discrepancy may be. What is left over
    is then taken for white, its rows count as few as their correlation says, and prediction
    of held-out levels decides.
    """
    if not task.own or misfit(search.hypothesis) < MIN_MISFIT:
        return search
    opened = search.open()
    white = replace(opened, assumptions=opened.assumptions | {"white"}).fitted()
    looked = _forward(task, replace(search, hypothesis=white, ended=white, exhausted=False))
    if len(looked.causes) > len(search.causes) and not _worse_unseen(task, search, looked):
        return looked
    # Nothing more was found: what taking the rest for white made of the model is no finding.
    if search.causes:
        return replace(search, unconfirmed=looked.unconfirmed)
    return replace(looked, hypothesis=search.hypothesis)


def _worse_unseen(task: DiagnosisTask, before: SearchState, after: SearchState) -> bool:
    """Whether unseen logs are worse by the written model of one search than by that of another."""
    models = before.written(task), after.written(task)
    logs = tuple(
        log for log in task.validate if all(cannot_run(model, log) is None for model in models)
    )
    gained, lost = balance(*models, logs, {}, before.noise)
    return lost > gained
