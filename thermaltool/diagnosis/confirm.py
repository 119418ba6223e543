"""Which of the decisive candidates stands: all logs bear it out, and rows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from thermaltool.diagnosis.assumptions import STARTS, Assumptions
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.select import Ranking
from thermaltool.diagnosis.state import DiagnosisTask, SearchState
from thermaltool.diagnosis.unseen import UnseenLogs, preferred_by_diagnosed
from thermaltool.diagnosis.validate import judge

# Causes that are held out at each step before the search is given up: the strongest, and others by
# what they have beyond their assumptions.
MAX_HELD_OUT, MAX_OTHERS = 4, 2
# Evidence of an accident beside another cause: that both fall into one log is a coincidence, and
# what the other's form leaves looks like one.
MIN_FURTHER_ACCIDENT = 40.0
BEGINS_AWAY = "a log does not begin at rest: its start decays are fitted apart"
BEGINS_AS_A_WHOLE = (
    "a log does not begin at rest: the machine as a whole is warmer or colder than its "
    "surroundings, and follows them"
)


@dataclass(frozen=True)
class Confirmation:
    """What came of the candidates of a ranking.

    Attributes
    ----------
    found : SearchState or None
        With the first one that stands, if any does.
    start : frozenset of str or None
        Assumptions with a start that comes before all others.
    of_logs, strong : list of CauseCandidate
        Decisive ones that all logs bear out, and those that none refuses.
    """

    found: SearchState | None = None
    start: Assumptions | None = None
    of_logs: Sequence[CauseCandidate] = ()
    strong: Sequence[CauseCandidate] = ()

    def refuses(self, candidate: CauseCandidate) -> bool:
        """Whether a candidate is decisive, and unseen logs refuse it.

        Parameters
        ----------
        candidate : CauseCandidate
        """
        return any(candidate is c for c in self.of_logs) and not any(
            candidate is c for c in self.strong
        )


def confirmation(
    task: DiagnosisTask, search: SearchState, hypothesis: Hypothesis, ranking: Ranking
) -> Confirmation:
    """The first of the decisive candidates that stands, or the start that comes before all.

    Parameters
    ----------
    task : DiagnosisTask
    search : SearchState
    hypothesis : Hypothesis
    ranking : Ranking
        Under it.
    """
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
    strong = unseen.ranked(of_logs)
    # A start explains more than causes that do not stand: it comes before weaker causes than the
    # strongest, and before any unknown; but for the one that explains the most by itself, and more
    # than the start.
    start = ranking.own_start(hypothesis.assumptions)
    first = strong
    if start is not None and strong:
        plain = max(strong, key=ranking.beyond)
        beside = ranking.beyond(plain) > ranking.alone[start]
        first = [strong[0], plain] if beside and plain is not strong[0] else strong[:1]
    found = _confirmed(task, search, hypothesis, ranking, first)
    if found is not None:
        other = preferred_by_diagnosed(strong, found.causes[-1].effect)
        found = found if other is None else found.noted(other)
    return Confirmation(found, start, of_logs, strong)


def confirmed_unseen(
    task: DiagnosisTask,
    search: SearchState,
    hypothesis: Hypothesis,
    ranking: Ranking,
    suspects: Sequence[CauseCandidate],
) -> SearchState | None:
    """The search with a first cause that unseen logs confirm; None where there is none.

    Parameters
    ----------
    task : DiagnosisTask
    search : SearchState
    hypothesis : Hypothesis
    ranking : Ranking
    suspects : sequence of CauseCandidate
        With some evidence, the strongest first.
    """
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
            if is_freed(hypothesis, verdict.after):
                search = search.noted("the model's own parameters are free beside the cause")
            if STARTS & (verdict.after.assumptions - hypothesis.assumptions):
                search = begun(search, verdict.after.assumptions)
            return search
    return None


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


def begun(search: SearchState, started: Assumptions) -> SearchState:
    """The search with a note on how a log begins, in place of one on a plainer start.

    Parameters
    ----------
    search : SearchState
    started : frozenset of str
        The assumptions with the start.
    """
    own = BEGINS_AS_A_WHOLE if "uniform" in started else BEGINS_AWAY
    other = BEGINS_AWAY, BEGINS_AS_A_WHOLE
    return replace(search, notes=tuple(n for n in search.notes if n not in other)).noted(own)


def is_freed(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the model's own parameters are free that were held by the calibration.

    Parameters
    ----------
    before, after : Hypothesis
    """
    return "tight" in before.assumptions and "released" in after.assumptions
