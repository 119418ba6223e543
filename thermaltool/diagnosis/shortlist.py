"""Which trials are refitted, which form of a cause is taken, and what is told of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from thermaltool.diagnosis import geometry
from thermaltool.diagnosis.evidence import STRONG, State
from thermaltool.diagnosis.result import Tried
from thermaltool.diagnosis.scan import LEAST, Candidate
from thermaltool.diagnosis.sight import Sight, noise_before
from thermaltool.diagnosis.workbench import Workbench
from thermaltool.effects.effect import reference_of

# Forms of one cause that differ by less in evidence are taken for equal.
SAME = 10.0


# Causes that are refitted at each step, of one name at most two.
REFINED, OF_A_NAME = 8, 2


def shortlist(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best trial of every form of a cause, the strongest first, few of one name."""
    chosen: list[Candidate] = []
    for c in candidates:
        if c.evidence < LEAST:
            break
        same = [x for x in chosen if x.effect.name == c.effect.name]
        if len(same) < OF_A_NAME and c.form not in [x.form for x in chosen]:
            chosen.append(c)
        if len(chosen) == REFINED:
            break
    return chosen


def plain_forms_first(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Of the forms of one cause that these logs hardly tell apart, the catalogue's first one."""
    result = list(candidates)
    for k, c in enumerate(result):
        same = [
            x
            for x in result[k + 1 :]
            if x.place == c.place and x.evidence > c.evidence - SAME and _rank(x) < _rank(c)
        ]
        if same:
            best = min(same, key=_rank)
            result.remove(best)
            result.insert(k, best)
    return result


def other_form(c: Candidate, chosen: Candidate) -> bool:
    return c.place == chosen.place and c.form != chosen.form and c.evidence > 0


def _rank(candidate: Candidate) -> int:
    """Place of its first parameter among those that the cause knows."""
    known = list(candidate.effect.known)
    return min((known.index(reference_of(n)[0]) for n in candidate.effect.searched()), default=0)


def every_place(
    bench: Workbench,
    candidates: Sequence[Candidate],
    refined: Sequence[Candidate],
    correction: float,
    alone: Mapping[State, float],
) -> tuple[Tried, ...]:
    """Every cause at its best, and the size from which these logs would show it."""
    best: dict[tuple[str, str], Candidate] = {}
    for c in candidates:
        place = c.effect.name, c.effect.channel
        best.setdefault(place, replace(c, evidence=c.evidence - correction))
    for c in reversed(refined):
        best[c.effect.name, c.effect.channel] = c
    ranked = sorted(best.values(), key=lambda c: -(c.evidence - alone[c.state]))
    sight = Sight(bench, bench.state, noise_before(bench, bench.state))
    result = []
    for c in ranked:
        seen = geometry.detectable(bench, c.effect, bench.state, correction, sight)
        evidence = c.evidence - alone[c.state]
        verdict = "evidence" if evidence > STRONG else "no evidence"
        result.append(
            Tried(
                c.effect.name,
                c.effect.channel,
                evidence,
                None if seen is None else seen.change,
                verdict if seen else "cannot be seen",
                None if seen is None else seen.output,
            )
        )
    return tuple(result)
