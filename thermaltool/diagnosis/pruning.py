"""Causes that do not stand beside the others are taken out of a search again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermaltool.diagnosis.assumptions import STARTS
from thermaltool.diagnosis.balance import loses
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.lasting import may_recur, recurrences
from thermaltool.diagnosis.nonlinearity import stand_ins
from thermaltool.diagnosis.residual_budget import reading_noise, weigh_residuals
from thermaltool.diagnosis.result import Cause
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.simulation import SimulatedLogs, without
from thermaltool.diagnosis.state import DiagnosisTask, SearchState, judged_by
from thermaltool.diagnosis.verdict import unknown_cause
from thermaltool.diagnosis.written import cannot_run, gains_of
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.detrend import find_outliers

# Share of the misfit that a cause of the written model explains at least: told as 2 %.
MIN_EXPLAINED = 0.02
# An only cause that lasts may lose this part of what it gains with zeros free, and as they count no
# more than it gains.
MAX_LOST = 0.1
# What is wrong every day leaves this part at least of what a change explains in its log.
MIN_EVERYDAY = 0.1


def pruned(task: DiagnosisTask, first: Hypothesis, search: SearchState) -> SearchState:
    """The search without the causes that later ones made idle, that help or hold nothing.

    Parameters
    ----------
    task : DiagnosisTask
    first : Hypothesis
        Before any cause.
    search : SearchState
        At the end of the forward selection.
    """
    used = _of_use(task, _backward(search))
    safe = _of_no_harm(task, _harmless(task, used))
    if safe is not used:
        safe = _of_use(task, safe)
    search = _of_no_accident(task, _of_gain(task, safe))
    return _of_no_rest(task, first, _of_no_curve(task, search))


def _backward(search: SearchState) -> SearchState:
    """The search without the causes that later ones made idle."""
    while idle := [cause for cause in search.causes[:-1] if _is_idle(search, cause)]:
        search = search.without(idle[0])
    return search


def _is_idle(search: SearchState, cause: Cause) -> bool:
    """Whether a cause has no evidence beside the others."""
    opened = search.open()
    rest = without(opened.model, cause.effect)
    if len(opened.model.effects) < 2 or rest is opened.model:
        return False
    bare = opened.with_model(rest).fitted()
    again = fit_candidate(bare, CauseCandidate.unfitted(cause.effect, bare.assumptions))
    return again.evidence < (0.0 if "white" in bare.assumptions else DECISIVE_EVIDENCE)


def _of_use(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without causes that change nothing for the better in the written model.

    Where a log does not begin at rest, what `simulate` leaves of one output says too little of a
    cause; all of them together do not. A model that would be worse than the one that came in is not
    written, and says nothing of its causes.
    """
    while search.spoiled(task, search.written(task)) is None:
        useless = _useless(task, search)
        if useless is None:
            break
        search = _dropped(search, useless, "explains nothing in the written model")
    return search


def _dropped(search: SearchState, cause: Cause, why: str) -> SearchState:
    """The search without one of its causes."""
    return search.noted(f"{cause.effect.name} {why}").without(cause)


def _of_no_curve(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without causes that stand for a nonlinearity which is none of them."""
    found = stand_ins(task, search)
    for cause, why in found:
        search = search.noted(f"{cause.effect.name} stands for what it is not: {why}")
    return search.without(*(cause for cause, _ in found))


def _of_no_accident(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without changes in one log that explain less than an unseen log is wrong by.

    What a model is off by on every day bends to a change on one. A change that lasts, or happened
    again, is none of these.
    """
    while everyday := _everyday(task, search):
        search = _dropped(
            search,
            everyday,
            "is left out: the unseen logs, too, are wrong by more than it explains",
        )
    return search


def _everyday(task: DiagnosisTask, search: SearchState) -> Cause | None:
    """The first change in one log that is none, beside what is wrong every day."""
    changes = (cause for cause in search.causes if may_recur(cause.effect))
    return next((cause for cause in changes if _is_everyday(task, search, cause)), None)


def _is_everyday(task: DiagnosisTask, search: SearchState, cause: Cause) -> bool:
    """Whether all unseen logs are wrong by as much as a change explains, and not by the same.

    What is there every day is in the log of the change, too: where it explains all, it is none.
    """
    written, noise = search.written(task), search.noise
    rest, masked = without(written, cause.effect), search.hypothesis.simulation.masked
    own = [log for log in task.logs if log.digest == cause.effect.log]
    runs = [SimulatedLogs(model, tuple(own), masked) for model in (rest, written)]
    explained = {
        o: (gain.rms_before**2 - gain.rms_after**2) / noise[o] ** 2
        for o, gain in gains_of(runs[0], runs[1], lambda output: True).items()
        if o in noise and gain.rms_after < gain.rms_before
    }
    seen, size = {o: noise[o] for o in explained}, sum(explained.values())
    if sum(_wrong(task, written, log, seen) for log in own) < MIN_EVERYDAY * size:
        return False
    unseen = [log for log in task.validate if cannot_run(written, log) is None]
    return bool(unseen) and all(
        _wrong(task, written, log, seen) > size
        and not recurrences(written, cause.effect, [log], noise, task.calibrated_misfit)
        for log in unseen
    )


def _wrong(task: DiagnosisTask, model: Model, log: Record, noise: Mapping[str, float]) -> float:
    """What a model leaves of a log beyond noise and its calibration's error, over the noise.

    As powers, outliers apart.
    """
    runs, found = SimulatedLogs(model, (log,), {}), 0.0
    for o in noise.keys() & runs.groups.keys():
        (measured, computed), rows = runs.as_simulated(o)[0], runs.groups[o].rows[0]
        left = (measured - computed)[rows]
        power = float(np.var(left[~find_outliers(left, noise[o])]))
        known = noise[o] ** 2 + task.calibrated_misfit.get(o, 0.0) ** 2
        found += max(power - known, 0.0) / noise[o] ** 2
    return found


def _of_no_rest(task: DiagnosisTask, first: Hypothesis, search: SearchState) -> SearchState:
    """The search without courses of one log beside which more is left than they explain.

    What any misfit looks like in part is not known by that part.
    """
    while courses := [c for c in search.causes if c.effect.log is not None and c.effect.course]:
        rest = rest_of(task, first, search)
        weakest = min(courses, key=lambda c: c.evidence)
        if rest is None or rest.evidence <= weakest.evidence:
            break
        why = f"is not told: beside it more is left (evidence {rest.evidence:.0f})"
        search = _dropped(search, weakest, why)
    return search


def rest_of(task: DiagnosisTask, first: Hypothesis, search: SearchState) -> Cause | None:
    """What is left of a model that is not adequate; None where it is noise.

    Parameters
    ----------
    task : DiagnosisTask
    first : Hypothesis
        Before any cause.
    search : SearchState
    """
    last = search.hypothesis if search.causes else search.ended
    noise = {output: reading_noise(last, output) for output in last.groups}
    _, before = weigh_residuals(first, first, noise)
    plain = last
    if search.causes:
        written = search.written(task)
        plain, last = last.with_model(written), judged_by(last, task, written)
    reports, left = weigh_residuals(last, plain, noise)
    return unknown_cause(left, before, reports, last, named=bool(search.causes))


def _of_no_harm(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without the one cause that keeps the others from being written."""
    effects = search.hypothesis.model.effects
    acting = [cause for cause in search.causes if cause.effect in effects]
    harmed = search.harmed(task, search.written(task)) if len(acting) > 1 else None
    if harmed is None:
        return search
    # What was found last explains least.
    for cause in reversed(acting):
        rest = _dropped(search, cause, _worse(*harmed))
        if rest.harmed(task, rest.written(task)) is None:
            return rest
    return search


def _worse(log: Record, output: str) -> str:
    return f"is left out: with it {output} in {log.name or 'a log'} would be worse"


def _harmless(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without causes by which some log loses more than slightly.

    One that costs next to nothing, or little of what it gains, is right, though what it makes is
    not to be written.
    """
    while (harmful := _harmful(task, search)) is not None:
        cause, why = harmful
        search = _dropped(search, cause, why)
    return search


def _harmful(task: DiagnosisTask, search: SearchState) -> tuple[Cause, str] | None:
    """The last cause that harms by the written model, and what it harms.

    Of several that together harm nothing one that lasts makes up for what another does there.
    """
    written = search.written(task)
    acting = [cause for cause in search.causes if cause.effect in written.effects]
    for cause in reversed(acting):
        harmed = search.harmed(task, written, without(written, cause.effect))
        if harmed is None:
            continue
        strictly = len(acting) > 1 and (
            cause.effect.log is not None or search.harmed(task, written) is not None
        )
        if strictly or _mostly_harms(task, search, cause, written):
            return cause, _worse(*harmed)
    return None


def _mostly_harms(task: DiagnosisTask, search: SearchState, cause: Cause, written: Model) -> bool:
    """Whether a cause that lasts loses a practical part of what it gains.

    What happened in one log alone is told by that log: a frozen sensor has a zero of its own.
    """
    if cause.effect.log is not None:
        return False
    logs = [log for log in (*task.logs, *task.validate) if cannot_run(written, log) is None]
    rest, masked = without(written, cause.effect), search.hypothesis.simulation.masked
    return loses(rest, written, logs, masked, search.noise, (MAX_LOST, 1.0))


def _of_gain(task: DiagnosisTask, search: SearchState) -> SearchState:
    """The search without causes that together leave the written model no better than it came.

    Each may be of use beside the others where one undoes what another does.
    """
    while acting := [c for c in search.causes if c.effect in search.hypothesis.model.effects]:
        if search.spoiled(task, task.model, search.written(task)) is not None:
            break
        weakest = min(acting, key=lambda cause: cause.evidence)
        search = _dropped(search, weakest, "is left out: with it no log is better")
    return search


def _useless(task: DiagnosisTask, search: SearchState) -> Cause | None:
    """The first cause without which the written model is as good."""
    assumptions = search.open().assumptions
    written = search.written(task)
    noise = search.noise
    masked = search.hypothesis.simulation.masked
    for cause in search.causes:
        rest = without(written, cause.effect)
        if rest is written:
            continue
        if task.explained(written, cause.effect, masked, noise, assumptions) < MIN_EXPLAINED:
            return cause
        harmless = search.spoiled(task, rest, written, surely=True) is None
        if harmless and not STARTS & assumptions:
            return cause
    return None
