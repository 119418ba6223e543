"""What unseen logs say of a cause before it is held out: what lasts acts in them, too.

What every log shows is no accident. A jump or a step bends to many a misfit of the log in which it
is; in another log it is none, or another one, and what acts in both explains both at once. Of two
lasting causes that explain a log alike the one comes first that explains the others better. What
parts of one log do not confirm all logs together may show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CandidateProducts, CauseCandidate, products_of, score
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.residual import MIN_ROWS
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.shortlist import plain_forms_first
from thermaltool.diagnosis.written import cannot_run
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Model
from thermaltool.record import Record

# Evidence in all logs of what the diagnosed ones do not show decisively: what a model is off by on
# every other day has some, too.
MIN_IN_ALL = 40.0
# An unseen log should show a lasting cause that would gain so much in it, were it true.
MIN_EXPECTED = 2 * DECISIVE_EVIDENCE
# Evidence of an accident beside a lasting cause that does not explain it, no places counted.
MIN_BESIDE = 2 * DECISIVE_EVIDENCE


@dataclass(frozen=True)
class UnseenLogs:
    """Logs that no fit has seen, and what is fitted to the diagnosed ones.

    Attributes
    ----------
    hypothesis : Hypothesis
        Under which candidates were fitted, or which they set free.
    logs : sequence of Record
    calibrated : Model
        As the calibration left it.
    """

    hypothesis: Hypothesis
    logs: Sequence[Record]
    calibrated: Model

    def borne_out(self, candidates: Sequence[CauseCandidate]) -> list[CauseCandidate]:
        """Candidates without the accidents that a lasting one explains.

        Beside it they have no evidence, and in all logs it has more than they. An accident may have
        happened again, as large, or may last since then: it counts what it gains in every log, each
        time at an instant of its own.

        Parameters
        ----------
        candidates : sequence of CauseCandidate
            The strongest first.
        """
        accidents = [c for c in candidates if c.effect.log is not None]
        if not (accidents and self.logs) or len(accidents) == len(candidates):
            return list(candidates)
        seen = {a: self._under(a) for a in {c.assumptions for c in candidates}}
        every = {a: each.with_logs((*each.logs, *self.logs)) for a, each in seen.items()}
        worth = [
            c.evidence + sum(_again(self._in(log, c.assumptions), c) for log in self.logs)
            for c in accidents
        ]
        left = list(zip(accidents, worth, strict=True))
        for c in candidates:
            if c.effect.log is not None or not left:
                continue
            lasting = fit_candidate(every[c.assumptions], c)
            beside = _with(seen[c.assumptions], lasting.effect)
            left = [
                (accident, own)
                for accident, own in left
                if own >= lasting.evidence
                or fit_candidate(beside, replace(accident, assumptions=c.assumptions)).evidence
                > MIN_BESIDE
            ]
        kept = [accident for accident, _ in left]
        return [c for c in candidates if c.effect.log is None or any(c is each for each in kept)]

    def ranked(self, candidates: Sequence[CauseCandidate]) -> list[CauseCandidate]:
        """Candidates of which the lasting ones are in the order of what they explain of all logs.

        Of the diagnosed logs their evidence, of the unseen ones what they gain there as they stand:
        no parameter of theirs is fitted to these, so that none is paid for. One that every unseen
        log that should show it clearly does not show is left out. Of forms that all logs hardly
        tell apart the catalogue's first one comes first. Accidents keep their places, and so does
        what was fitted under other assumptions than the strongest.

        Parameters
        ----------
        candidates : sequence of CauseCandidate
            The strongest first.
        """
        lasting = [c for c in candidates if c.effect.log is None]
        logs = [log for log in self.logs if _can_judge(self.hypothesis, log)]
        if not (lasting and logs):
            return plain_forms_first(candidates)
        gains = {
            id(c): [_unseen_gain(self._in(log, c.assumptions), c) for log in logs] for c in lasting
        }

        def refused(c: CauseCandidate) -> bool:
            clear = [g.gained for g in gains.get(id(c), ()) if g and g.expected > MIN_EXPECTED]
            return bool(clear) and max(clear) <= DECISIVE_EVIDENCE

        left = [c for c in candidates if not refused(c)]
        # Beside a model that is free, or another start, a gain is none of the cause alone.
        alike = [c for c in left if id(c) in gains and c.assumptions == lasting[0].assumptions]
        # Of what only some can be run over nothing is compared.
        common = [k for k in range(len(logs)) if all(gains[id(c)][k] is not None for c in alike)]
        worth = [
            replace(
                c, evidence=c.evidence + sum(g.gained for k in common if (g := gains[id(c)][k]))
            )
            for c in alike
        ]
        worth.sort(key=lambda c: -c.evidence)
        own = {id(c.effect): c for c in alike}
        ordered = iter([own[id(c.effect)] for c in plain_forms_first(worth)])
        return [next(ordered) if any(c is each for each in alike) else c for c in left]

    def shown_by_all(
        self, suspects: Sequence[CauseCandidate], correction: float
    ) -> list[CauseCandidate]:
        """Lasting candidates that all logs together show decisively, the strongest there first.

        Their evidence is that of all logs; they keep the parameters that the diagnosed logs give
        them, which unseen logs judge.

        Parameters
        ----------
        suspects : sequence of CauseCandidate
            That the diagnosed logs alone do not confirm.
        correction : float
            Evidence that the number of places tried takes away.
        """
        own = self.hypothesis
        lasting = [c for c in suspects if c.effect.log is None and c.assumptions == own.assumptions]
        if not (lasting and self.logs):
            return []
        every = own.with_logs((*own.logs, *self.logs))
        found = [
            replace(c, evidence=fit_candidate(every, c).evidence - correction) for c in lasting
        ]
        clear = [c for c in found if c.evidence > MIN_IN_ALL]
        return plain_forms_first(sorted(clear, key=lambda c: -c.evidence))

    def _under(self, assumptions: Assumptions) -> Hypothesis:
        """The hypothesis under some assumptions; what is weighed of it is kept."""
        if assumptions not in self._assumed:
            self._assumed[assumptions] = self.hypothesis.under(assumptions, self.calibrated)
        return self._assumed[assumptions]

    def _in(self, log: Record, assumptions: Assumptions) -> Hypothesis:
        """The same on one unseen log."""
        key = id(log), assumptions
        if key not in self._alone:
            self._alone[key] = self._under(assumptions).with_logs([log])
        return self._alone[key]

    @cached_property
    def _assumed(self) -> dict[Assumptions, Hypothesis]:
        return {}

    @cached_property
    def _alone(self) -> dict[tuple[int, Assumptions], Hypothesis]:
        return {}


def preferred_by_diagnosed(ranked: Sequence[CauseCandidate], found: Effect) -> str | None:
    """A sentence on the cause that the diagnosed logs alone would name; None where it is the same.

    Parameters
    ----------
    ranked : sequence of CauseCandidate
        By `UnseenLogs.ranked`.
    found : Effect
        The cause that was found.
    """
    lasting = [c for c in ranked if c.effect.log is None]
    if not lasting:
        return None
    first = lasting[0]
    alike = (c for c in lasting if c.assumptions == first.assumptions)
    strongest = max(alike, key=lambda c: c.evidence)
    if first.place != (found.name, found.channel, found.log) or strongest.place == first.place:
        return None
    other, own = (
        f"{c.effect.name} of {c.effect.channel or 'a source'}" for c in (strongest, first)
    )
    return (
        f"{other} explains the diagnosed logs as well (evidence {strongest.evidence:.0f}, of "
        f"{own} {first.evidence:.0f}), and the unseen ones less"
    )


@dataclass(frozen=True)
class UnseenGain:
    """What a cause is worth in an unseen log, as it stands.

    Attributes
    ----------
    gained, expected : float
        Twice the rise of the log likelihood, and what it would be of a cause that is true.
    """

    gained: float
    expected: float


def _unseen_gain(unseen: Hypothesis, candidate: CauseCandidate) -> UnseenGain | None:
    """What a cause is worth in an unseen log; None where it cannot be run over it."""
    products = _standing(unseen, candidate.effect, candidate.assumptions)
    if products is None:
        return None
    gained = expected = 0.0
    for output, own in products.items():
        independence, caused = unseen.evidence[output].independence, own.C[:, 0, 0]
        left = own.null.square - 2 * own.b[:, 0] + caused
        beside, without = (
            float(np.min(own.null.negative_log(square))) for square in (left, left + caused)
        )
        gained += 2 * independence * (own.null.best - beside)
        expected += 2 * independence * (without - beside)
    return UnseenGain(gained, expected)


def _standing(
    hypothesis: Hypothesis, effect: Effect, assumptions: Assumptions
) -> dict[str, CandidateProducts] | None:
    """Products of what an effect does as it stands; None where it cannot be run."""
    try:
        displacement = {"": hypothesis.simulation.displacement(effect)}
    except ModelError:
        return None
    return products_of(hypothesis, displacement, assumptions)


def _can_judge(hypothesis: Hypothesis, log: Record) -> bool:
    """Whether a log has readings enough of every output of which it has any."""
    readings = [
        int(np.isfinite(log.columns[output]).sum())
        for output in hypothesis.groups
        if output in log.columns
    ]
    enough = all(not count or count >= MIN_ROWS for count in readings)
    return any(readings) and enough and cannot_run(hypothesis.model, log) is None


def _with(hypothesis: Hypothesis, effect: Effect) -> Hypothesis:
    """The hypothesis with an effect more in its model."""
    model = hypothesis.model
    return hypothesis.with_model(replace(model, effects=(*model.effects, effect)))


def _again(one: Hypothesis, candidate: CauseCandidate) -> float:
    """Evidence of the same accident, as large, at another instant of another log; none below 0."""
    effect = candidate.effect
    size = {name: effect.parameters[name] for name in effect.linear()}
    probes = [each for each in type(effect).probes(one.scene) if each.channel == effect.channel]
    same = [each.changed(size) for each in probes if size.keys() == {*each.linear()}]
    return max([_as_it_stands(one, each, candidate.assumptions) for each in same] + [0.0])


def _as_it_stands(hypothesis: Hypothesis, effect: Effect, assumptions: Assumptions) -> float:
    """Evidence of an effect of which no amplitude is fitted."""
    products = _standing(hypothesis, effect, assumptions)
    if not products:
        return 0.0
    return score(hypothesis, effect, [""], products, assumptions, fixed=True).evidence
