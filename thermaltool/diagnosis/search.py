"""The search for causes, one after another, until what is left is noise or none explains it.

Forward selection: at each step the whole catalogue is scored against what is left over, the best
few are fitted, and the strongest is accepted if its evidence is decisive after correction for the
number of causes tried, if it helps on data that its fit has not seen, and if what it explains is
not smaller than the error that the model had on its clean calibration. Backward check: what later
causes made idle is taken out again, and so is what the written model has no use for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.alternatives import tried_causes
from thermaltool.diagnosis.assumptions import STARTS, Assumptions, released
from thermaltool.diagnosis.balance import balance
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CauseCandidate
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
from thermaltool.diagnosis.unseen import UnseenLogs, preferred_by_diagnosed
from thermaltool.diagnosis.validate import judge
from thermaltool.diagnosis.written import cannot_run, gains_of

# Causes that are named at most, and that are held out at each step before the search is given up:
# the strongest, and others by what they have beyond their assumptions.
MAX_CAUSES, MAX_HELD_OUT, MAX_OTHERS = 6, 4, 2
# Evidence of an accident beside another cause: that both fall into one log is a coincidence, and
# what the other's form leaves looks like one.
MIN_FURTHER_ACCIDENT = 40.0
# Without sound logs a search counts where it leaves at most this share of the power above noise.
MAX_LEFT = 0.5
HAS_CHANGED = (
    "the model's own parameters have changed since the calibration, beyond its uncertainty: "
    "calibrate again"
)
BEGINS_AWAY = "a log does not begin at rest: its start decays are fitted apart"
BEGINS_AS_A_WHOLE = (
    "a log does not begin at rest: the machine as a whole is warmer or colder than its "
    "surroundings, and follows them"
)
# A search before its model was free to change, and what it found then.
Held = tuple[SearchState, Hypothesis, Ranking]


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
    held: Held | None = None
    while True:
        ranking = ranked(hypothesis, blind, task.progress)
        # Of the last assumptions before the first cause: what a start says is none's evidence.
        if not search.causes:
            search = replace(search, tried=tried_causes(hypothesis, ranking))
        told = [c for c in ranking.fitted if not is_trend(c.effect, task.model, task.logs)]
        ranking = replace(ranking, fitted=told)
        better = ranking.better_assumptions()
        strong: list[CauseCandidate] = []
        of_logs: list[CauseCandidate] = []
        refused: list[CauseCandidate] = []
        if better is None:
            of_logs, strong = _strong(task, search, hypothesis, ranking)
            refused = [c for c in of_logs if not any(c is each for each in strong)]
            # A start explains more than causes that do not stand: it comes before weaker causes
            # than the strongest, and before any unknown; but for the one that explains the most
            # by itself, and more than the start.
            better = ranking.own_start(hypothesis.assumptions)
            first = strong
            if better is not None and strong:
                plain = max(strong, key=ranking.beyond)
                beside = ranking.beyond(plain) > ranking.alone[better]
                first = [strong[0], plain] if beside and plain is not strong[0] else strong[:1]
            found = _confirmed(task, search, hypothesis, ranking, first)
            if found is not None:
                other = preferred_by_diagnosed(strong, found.causes[-1].effect)
                return found if other is None else found.noted(other)
        if better is None:
            suspects = [c for c in ranking.strong(0.0) if not any(c is each for each in refused)]
            found = _confirmed_unseen(task, search, hypothesis, ranking, suspects)
            found = found or _too_short(task, search, hypothesis)
            found = found or _of_held_model(task, search, hypothesis, held)
            return found or replace(
                search,
                ended=hypothesis,
                unconfirmed=of_logs[0] if of_logs else None,
                suspects=tuple(ranking.strong(0.0)),
                exhausted=True,
            )
        before = search, hypothesis, ranking
        search, changed = _own_change(task, search, hypothesis, better)
        if changed is None:
            return search
        if _is_freed(hypothesis, changed):
            held = before
        hypothesis = changed


def _strong(
    task: DiagnosisTask, search: SearchState, hypothesis: Hypothesis, ranking: Ranking
) -> tuple[list[CauseCandidate], list[CauseCandidate]]:
    """Candidates with decisive evidence that all logs bear out, and their order by all logs."""
    strong = ranking.strong(0.0 if "white" in hypothesis.assumptions else DECISIVE_EVIDENCE)
    if search.causes:
        strong = [
            c for c in strong
            if c.effect.log is None or ranking.beyond(c) > MIN_FURTHER_ACCIDENT
        ]  # fmt: skip
    if task.validate:
        task.progress("unseen logs")
    unseen = UnseenLogs(hypothesis, task.validate, task.model)
    of_logs = unseen.borne_out(strong)
    return of_logs, unseen.ranked(of_logs)


def _of_held_model(
    task: DiagnosisTask, search: SearchState, freed: Hypothesis, held: Held | None
) -> SearchState | None:
    """The search with a first cause beside the model as calibrated, where a free one is no help.

    None where the free model leaves noise, and where no cause stands.
    """
    if held is None or search.causes:
        return None
    if rest_of(task, search.hypothesis, replace(search, ended=freed)) is None:
        return None
    _, strong = _strong(task, *held)
    return _confirmed(task, *held, strong)


def _confirmed(
    task: DiagnosisTask,
    search: SearchState,
    hypothesis: Hypothesis,
    ranking: Ranking,
    candidates: Sequence[CauseCandidate],
    faint: bool = False,
) -> SearchState | None:
    """The search with the first of the candidates that stands; None where none does."""
    for candidate in _judged(ranking, candidates):
        task.progress(f"held-out gain of {candidate.effect.name}")
        verdict = judge(
            hypothesis,
            candidate,
            ranking.fitted,
            task.model,
            task.validate,
            task.calibrated_misfit,
            faint,
        )
        if verdict is not None:
            search = search.accepting(verdict.cause, verdict.after, verdict)
            if _is_freed(hypothesis, verdict.after):
                search = search.noted("the model's own parameters are free beside the cause")
            if STARTS & (verdict.after.assumptions - hypothesis.assumptions):
                search = _begun(search, verdict.after.assumptions)
            return search
    return None


def _confirmed_unseen(
    task: DiagnosisTask,
    search: SearchState,
    hypothesis: Hypothesis,
    ranking: Ranking,
    suspects: Sequence[CauseCandidate],
) -> SearchState | None:
    """The search with a first cause that unseen logs confirm; None where there is none."""
    if search.causes:
        return None
    unseen = UnseenLogs(hypothesis, task.validate, task.model)
    faint = unseen.shown_by_all(suspects, ranking.correction)
    found = _confirmed(task, search, hypothesis, ranking, faint, faint=True)
    if found is None:
        return None
    return found.noted(
        f"{found.causes[0].effect.name} is told by the unseen logs: parts of the diagnosed ones "
        "alone do not confirm it"
    )


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
    if _is_freed(hypothesis, changed):
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
        return _begun(search, better), changed
    # What a short calibration has not seen may pass for a start: it comes first.
    freed = hypothesis.under(released(hypothesis.assumptions), task.model).fitted()
    found = _with_left_open(task, search, hypothesis, freed)
    # Beside a longer calibration nothing is left of what only looked like a start.
    begun = (freed.assumptions - STARTS) | (better & STARTS)
    started = freed.evidence_of(begun) > DECISIVE_EVIDENCE
    if found is not None and not started:
        return found, None
    return _begun(search, better), changed


def _begun(search: SearchState, started: Assumptions) -> SearchState:
    """The search with a note on how a log begins, in place of one on a plainer start."""
    own = BEGINS_AS_A_WHOLE if "uniform" in started else BEGINS_AWAY
    other = BEGINS_AWAY, BEGINS_AS_A_WHOLE
    return replace(search, notes=tuple(n for n in search.notes if n not in other)).noted(own)


def _judged(ranking: Ranking, strong: Sequence[CauseCandidate]) -> list[CauseCandidate]:
    """The strongest, then other places by what they have beyond their assumptions.

    Beside a model that is free to change every cause looks strong.
    """
    first = strong[:MAX_HELD_OUT]
    places = {c.place for c in first}
    others: dict[object, CauseCandidate] = {}
    for candidate in sorted(strong, key=lambda c: -ranking.beyond(c)):
        if candidate.place not in places:
            others.setdefault(candidate.place, candidate)
    return [*first, *list(others.values())[:MAX_OTHERS]]


def _is_freed(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the model's own parameters are free that were held by the calibration."""
    return "tight" in before.assumptions and "released" in after.assumptions


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
