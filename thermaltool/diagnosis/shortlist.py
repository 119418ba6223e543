"""Which candidates of a scan are fitted, and in which order they are judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.effects.effect import reference_of

# Trials that promise less evidence than this are not fitted.
MIN_EVIDENCE = -10.0
# Causes that are fitted at each step, and of one name.
MAX_FITTED, MAX_OF_A_NAME = 8, 2
# ... and how many of them by what they have beyond their assumptions.
MIN_BEYOND = 3
# Forms of one cause that differ by less in evidence are taken for equal.
EQUAL_EVIDENCE = 10.0


def shortlist(
    candidates: Sequence[CauseCandidate], alone: Mapping[Assumptions, float]
) -> list[CauseCandidate]:
    """The best trials, of every form of a cause one, few of one name.

    Most have the most evidence, some the most beyond that of their assumptions: beside a model that
    is free to change every cause looks strong.

    Parameters
    ----------
    candidates : sequence of CauseCandidate
        The strongest first.
    alone : mapping of assumptions to float
        Evidence of what the model may say for itself.
    """
    there = [c for c in candidates if c.evidence >= MIN_EVIDENCE]
    beyond = sorted(there, key=lambda c: alone[c.assumptions] - c.evidence)
    first = _of_each_form(beyond)[:MIN_BEYOND]
    # A trial may be there twice, by two assumptions.
    forms = [c.form for c in first]
    others = [c for c in _of_each_form(there) if c.form not in forms]
    return [*first, *others[: MAX_FITTED - len(first)]]


def _of_each_form(candidates: Sequence[CauseCandidate]) -> list[CauseCandidate]:
    """The first of every form of a cause, few of one name; one more where all are of one place."""
    chosen: list[CauseCandidate] = []
    for c in candidates:
        same = [x for x in chosen if x.effect.name == c.effect.name]
        places = {x.place for x in same}
        most = MAX_OF_A_NAME + (len(places) == 1 and c.place not in places)
        if len(same) < most and c.form not in [x.form for x in chosen]:
            chosen.append(c)
    return chosen


def plain_forms_first(candidates: Sequence[CauseCandidate]) -> list[CauseCandidate]:
    """Candidates in turn; of forms that these logs hardly tell apart the catalogue's first one.

    Parameters
    ----------
    candidates : sequence of CauseCandidate
        The strongest first.
    """
    result = list(candidates)
    for k, c in enumerate(result):
        same = [
            x
            for x in result[k + 1 :]
            if x.place == c.place
            and x.evidence > c.evidence - EQUAL_EVIDENCE
            and _rank(x) < _rank(c)
        ]
        if same:
            best = min(same, key=_rank)
            result.remove(best)
            result.insert(k, best)
    return result


def _rank(candidate: CauseCandidate) -> tuple[int, int]:
    """Place of its first parameter among those that the cause knows, and how many it searches."""
    known, searched = list(candidate.effect.known), candidate.effect.searched()
    return min((known.index(reference_of(n)[0]) for n in searched), default=0), len(searched)
