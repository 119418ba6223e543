"""Selection of candidates: the catalogue scored in one pass of linear algebra, the best fitted.

At a trial size every cause has a signature; its inner products with the residual and with itself,
prewhitened and with the model's own parameters projected out, give the evidence that a fit of its
amplitude would have (score test). Only what survives is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.evidence import (
    DECISIVE_EVIDENCE,
    Assumptions,
    ProjectedProducts,
    released,
)
from thermaltool.diagnosis.fit import (
    CandidateProducts,
    CauseCandidate,
    fit_candidate,
    score,
    signatures_of,
)
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.simulation import Changes
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect, Float, reference_of

Progress = Callable[[str], None]
Amplitudes = Mapping[str, Changes]  # signatures of one candidate

# Trials that promise less evidence than this are not fitted.
MIN_EVIDENCE = -10.0
# Causes that are fitted at each step, and of one name.
MAX_FITTED, MAX_OF_A_NAME = 8, 2
# Forms of one cause that differ by less in evidence are taken for equal.
EQUAL_EVIDENCE = 10.0


@dataclass(frozen=True)
class Ranking:
    """Candidates under a hypothesis.

    Attributes
    ----------
    scanned : list of CauseCandidate
        The whole catalogue, the strongest first.
    fitted : list of CauseCandidate
        The best few of them, the strongest first.
    correction : float
        Evidence that the number of places tried takes away.
    alone : mapping of assumptions to float
        Evidence of what the model may say for itself, without a cause; the worthless left out.
    """

    scanned: list[CauseCandidate]
    fitted: list[CauseCandidate]
    correction: float
    alone: dict[Assumptions, float]

    def beyond(self, candidate: CauseCandidate) -> float:
        """Evidence of a candidate beyond that of its assumptions."""
        return candidate.evidence - self.alone[candidate.assumptions]

    def better_assumptions(self) -> Assumptions | None:
        """Those under which the model itself has decisively more to say than any cause."""
        best = max(self.alone, key=lambda a: self.alone[a])
        strongest = self.beyond(self.fitted[0]) if self.fitted else -np.inf
        return best if self.alone[best] > max(DECISIVE_EVIDENCE, strongest) else None

    def strong(self, least: float) -> list[CauseCandidate]:
        """Those with more evidence, the strongest first.

        Parameters
        ----------
        least : float
        """
        return [c for c in self.fitted if self.beyond(c) > least]


def ranked(
    hypothesis: Hypothesis,
    unseen: Collection[tuple[str, str]],
    progress: Progress = lambda message: None,
) -> Ranking:
    """The catalogue scored, and the best few candidates fitted.

    Parameters
    ----------
    hypothesis : Hypothesis
    unseen : collection of (name, channel)
        Causes that the logs cannot show: what they cannot show they cannot confirm either.
    progress : callable
    """
    present = hypothesis.assumptions
    possible = [present]
    if "initial" not in present:
        possible.append(present | {"initial"})
    if "tight" in present:
        possible.append(released(present))
    # What the model may say for itself counts where these logs ask for it.
    alone = {a: hypothesis.evidence_of(a) for a in possible}
    alone = {a: evidence for a, evidence in alone.items() if evidence > MIN_EVIDENCE}
    scanned = scan(hypothesis, list(alone), progress)
    # Where held-out levels decide, the number of trials is no matter of the evidence.
    places = max(len({c.place for c in scanned}), 1)
    correction = 0.0 if "white" in present else 2 * float(np.log(places))
    short = shortlist([c for c in scanned if (c.effect.name, c.effect.channel) not in unseen])
    fitted = []
    for k, candidate in enumerate(short):
        progress(f"fitting {candidate.effect.name} ({k + 1} of {len(short)})")
        fitted.append(fit_candidate(hypothesis, candidate))
        if candidate.assumptions != present:
            # Far from its trial size a cause may need no other change of the model.
            fitted.append(fit_candidate(hypothesis, replace(candidate, assumptions=present)))
    fitted = [replace(c, evidence=c.evidence - correction) for c in fitted]
    fitted.sort(key=lambda c: -(c.evidence - DECISIVE_EVIDENCE * (c.assumptions != present)))
    return Ranking(scanned, fitted, correction, alone)


def trials(hypothesis: Hypothesis, names: Iterable[str] = CATALOGUE) -> Iterator[Effect]:
    """Trial sizes of every cause that the model does not hold already.

    Parameters
    ----------
    hypothesis : Hypothesis
    names : iterable of str
        Of the catalogue.
    """
    present = {(e.name, e.channel, e.log) for e in hypothesis.model.effects if not e.event}
    for name in names:
        for trial in effect_class(name).probes(hypothesis.scene):
            if (trial.name, trial.channel, trial.log) not in present:
                yield trial


# ---------------------------------------------------------------- the whole catalogue


def scan(
    hypothesis: Hypothesis,
    assumptions: Sequence[Assumptions],
    progress: Progress = lambda message: None,
) -> list[CauseCandidate]:
    """Evidence of every trial of the catalogue, the strongest first.

    Parameters
    ----------
    hypothesis : Hypothesis
    assumptions : sequence of frozenset of str
        Each trial is judged by its best ones: the present ones, unless others are decisively
        better.
    progress : callable
    """
    found = []
    for trial in trials(hypothesis):
        progress(f"signatures, {trial.name}")
        signatures = signatures_of(hypothesis, trial)
        if signatures:
            found.append((trial, signatures))
    progress("scores")
    catalogue = _Catalogue.of(hypothesis, [s for _, s in found], assumptions)
    candidates = []
    for k, (trial, signatures) in enumerate(found):
        scored = [
            score(hypothesis, trial, list(signatures), catalogue.products(k, s), s)
            for s in assumptions
            if catalogue.promises(hypothesis, k, trial, s)
        ]
        if scored:
            candidates.append(
                max(
                    scored,
                    key=lambda c: (
                        c.evidence - DECISIVE_EVIDENCE * (c.assumptions != hypothesis.assumptions)
                    ),
                )
            )
    return sorted(candidates, key=lambda c: -c.evidence)


@dataclass(frozen=True)
class _Catalogue:
    """Products of the signatures of all trials with all outputs.

    Attributes
    ----------
    index : list of mapping of output to list of int
        Signatures of each trial among all of an output.
    amplitudes : list of mapping of output to list of int
        Which of the trial's amplitudes they have.
    projected : mapping of (output, assumptions) to ProjectedProducts
    """

    index: list[dict[str, list[int]]]
    amplitudes: list[dict[str, list[int]]]
    projected: Mapping[tuple[str, Assumptions], ProjectedProducts]

    @staticmethod
    def of(
        hypothesis: Hypothesis,
        found: Sequence[Amplitudes],
        assumptions: Sequence[Assumptions],
    ) -> _Catalogue:
        index: list[dict[str, list[int]]] = [{} for _ in found]
        amplitudes: list[dict[str, list[int]]] = [{} for _ in found]
        projected = {}
        for output, evidence in hypothesis.evidence.items():
            columns: list[Float] = []
            for k, signatures in enumerate(found):
                here = [j for j, reached in enumerate(signatures.values()) if output in reached]
                if here:
                    index[k][output] = list(range(len(columns), len(columns) + len(here)))
                    amplitudes[k][output] = here
                    columns += [
                        evidence.groups.means(reached[output])
                        for reached in signatures.values()
                        if output in reached
                    ]
            if columns:
                groups = [each[output] for each in index if output in each]
                products = evidence.products(np.column_stack(columns), groups)
                for each in assumptions:
                    projected[output, each] = evidence.projected(each, products)
        return _Catalogue(index, amplitudes, projected)

    def promises(
        self, hypothesis: Hypothesis, k: int, trial: Effect, assumptions: Assumptions
    ) -> bool:
        """Whether a trial could have evidence at all, every output explained on its own."""
        gain = 0.0
        for output, index in self.index[k].items():
            if len(index) > 1:
                return True
            evidence = hypothesis.evidence[output]
            gain += max(float(self.projected[output, assumptions].largest_rise[index[0]]), 0.0)
            gain -= evidence.null(assumptions).best - evidence.null(hypothesis.assumptions).best
        rows = min((hypothesis.groups[o].count for o in self.index[k]), default=1)
        price = (len(trial.searched()) + 1) * float(np.log(rows))
        return 2 * gain - price > MIN_EVIDENCE

    def products(self, k: int, assumptions: Assumptions) -> dict[str, CandidateProducts]:
        """Products of one trial in every output that it reaches."""
        return {
            output: CandidateProducts.of(
                self.projected[output, assumptions], index, self.amplitudes[k][output]
            )
            for output, index in self.index[k].items()
        }


# ---------------------------------------------------------------- which of them


def shortlist(candidates: Sequence[CauseCandidate]) -> list[CauseCandidate]:
    """The best trial of every form of a cause, few of one name.

    Parameters
    ----------
    candidates : sequence of CauseCandidate
        The strongest first.
    """
    chosen: list[CauseCandidate] = []
    for c in candidates:
        if c.evidence < MIN_EVIDENCE:
            break
        same = [x for x in chosen if x.effect.name == c.effect.name]
        if len(same) < MAX_OF_A_NAME and c.form not in [x.form for x in chosen]:
            chosen.append(c)
        if len(chosen) == MAX_FITTED:
            break
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


def _rank(candidate: CauseCandidate) -> int:
    """Place of its first parameter among those that the cause knows."""
    known = list(candidate.effect.known)
    return min((known.index(reference_of(n)[0]) for n in candidate.effect.searched()), default=0)
