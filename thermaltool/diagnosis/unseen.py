"""What unseen logs say of a cause before it is held out: what lasts acts in them, too.

What every log shows is no accident. A jump or a step bends to many a misfit of the log in which it
is; in another log it is none, or another one, and what acts in both explains both at once. Of two
lasting causes that explain a log alike the one that foretells the others is it. What parts of one
log do not confirm all logs together may show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.fit import CauseCandidate, products_of, profile, score
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Model
from thermaltool.record import Record

# Evidence in all logs of what the diagnosed ones do not show decisively: what a model is off by on
# every other day has some, too.
MIN_IN_ALL = 40.0
# Evidence from which unseen logs should tell a lasting cause.
CLEAR = 2 * DECISIVE_EVIDENCE


def foretelling(
    hypothesis: Hypothesis,
    candidates: Sequence[CauseCandidate],
    unseen: Sequence[Record],
    calibrated: Model,
) -> list[CauseCandidate]:
    """Candidates of which the lasting ones are in the order of what they explain of all logs.

    Of the diagnosed logs their evidence, of the unseen ones what they gain there as they stand: no
    parameter is fitted to these, so that none is paid for. One that should be clear there, and is
    not, is left out. Accidents keep their places.

    Parameters
    ----------
    hypothesis, candidates, unseen, calibrated
        As in `borne_out`.
    """
    lasting = [c for c in candidates if c.effect.log is None]
    if not (lasting and unseen):
        return list(candidates)
    there = {
        a: [hypothesis.under(a, calibrated).with_logs([log]) for log in unseen]
        for a in {c.assumptions for c in lasting}
    }
    worth: list[tuple[float, CauseCandidate]] = []
    for c in lasting:
        found = [_foretold(each, c) for each in there[c.assumptions]]
        gained, expected = (sum(each) for each in zip(*found, strict=True))
        if gained > DECISIVE_EVIDENCE or expected < CLEAR:
            changed = DECISIVE_EVIDENCE * (c.assumptions != hypothesis.assumptions)
            worth.append((c.evidence - changed + gained, c))
    worth.sort(key=lambda each: -each[0])
    ordered = iter([c for _, c in worth])
    kept = [c for c in candidates if c.effect.log is not None or any(c is x for _, x in worth)]
    return [next(ordered) if c.effect.log is None else c for c in kept]


def overruled(
    of_logs: Sequence[CauseCandidate], of_all: Sequence[CauseCandidate], cause: Effect
) -> str | None:
    """A sentence on the cause that the diagnosed logs alone would name; None where it is the same.

    Parameters
    ----------
    of_logs, of_all : sequence of CauseCandidate
        Before `foretelling` and after it.
    cause : Effect
        That was found.
    """
    before, after = (
        next((c.effect.name for c in each if c.effect.log is None), cause.name)
        for each in (of_logs, of_all)
    )
    if cause.name != after or before == after:
        return None
    return (
        f"{before} explains the diagnosed logs no worse than {after} does, and the unseen ones less"
    )


def _foretold(unseen: Hypothesis, candidate: CauseCandidate) -> tuple[float, float]:
    """Twice the rise of the log likelihood of an unseen log by a cause as it stands.

    And what it would be of a cause that is true.
    """
    effect, assumptions = candidate.effect, candidate.assumptions
    try:
        displacement = {"": unseen.simulation.displacement(effect)}
    except ModelError:  # a column is not there
        return 0.0, 0.0
    products = products_of(unseen, displacement, assumptions)
    if not products:
        return 0.0, 0.0
    found, as_it_stands = profile(list(products.values()), 1, np.ones(1)), np.ones(1)
    gained = expected = 0.0
    for (output, own), gain, level in zip(
        products.items(), found.gains.tolist(), found.levels, strict=True
    ):
        independence = unseen.evidence[output].independence
        gained += 2 * independence * gain
        expected += independence * own.C[level, 0, 0] / own.variance(as_it_stands, level)
    return gained, expected


def borne_out(
    hypothesis: Hypothesis,
    candidates: Sequence[CauseCandidate],
    unseen: Sequence[Record],
    calibrated: Model,
) -> list[CauseCandidate]:
    """Candidates without the accidents that have less evidence in all logs than a lasting cause.

    An accident may have happened again, as large, or may last since then: it counts what it gains
    in every log, each time at an instant of its own.

    Parameters
    ----------
    hypothesis : Hypothesis
        Under which the candidates were fitted, or which they set free.
    candidates : sequence of CauseCandidate
        The strongest first.
    unseen : sequence of Record
        Logs that no fit has seen.
    calibrated : Model
        As the calibration left it.
    """
    accidents = [c for c in candidates if c.effect.log is not None]
    if not (accidents and unseen) or len(accidents) == len(candidates):
        return list(candidates)

    # Candidates of the same assumptions share what is weighed of the logs.
    under = {a: hypothesis.under(a, calibrated) for a in {c.assumptions for c in candidates}}
    every = {a: each.with_logs((*hypothesis.logs, *unseen)) for a, each in under.items()}
    others = {a: [each.with_logs([log]) for log in unseen] for a, each in under.items()}
    lasting = max(
        fit_candidate(every[c.assumptions], c).evidence for c in candidates if c.effect.log is None
    )
    denied = [
        c
        for c in accidents
        if c.evidence + sum(_again(one, c) for one in others[c.assumptions]) < lasting
    ]
    return [c for c in candidates if not any(c is each for each in denied)]


def seen_in_all(
    hypothesis: Hypothesis,
    suspects: Sequence[CauseCandidate],
    unseen: Sequence[Record],
    correction: float,
) -> list[CauseCandidate]:
    """Lasting candidates that all logs together show decisively, the strongest there first.

    Their evidence is that of all logs; they keep the parameters that the diagnosed logs give them,
    which unseen logs judge.

    Parameters
    ----------
    hypothesis, unseen
        As in `borne_out`.
    suspects : sequence of CauseCandidate
        That the diagnosed logs alone do not confirm.
    correction : float
        Evidence that the number of places tried takes away.
    """
    lasting = [
        each
        for each in suspects
        if each.effect.log is None and each.assumptions == hypothesis.assumptions
    ]
    if not (lasting and unseen):
        return []
    every = hypothesis.with_logs((*hypothesis.logs, *unseen))
    found = [
        replace(each, evidence=fit_candidate(every, each).evidence - correction) for each in lasting
    ]
    clear = [each for each in found if each.evidence > MIN_IN_ALL]
    return sorted(clear, key=lambda each: -each.evidence)


def _again(one: Hypothesis, candidate: CauseCandidate) -> float:
    """Evidence of the same accident, as large, at another instant of another log; none below 0."""
    effect = candidate.effect
    size = {name: effect.parameters[name] for name in effect.linear()}
    probes = [each for each in type(effect).probes(one.scene) if each.channel == effect.channel]
    same = [each.changed(size) for each in probes if size.keys() == {*each.linear()}]
    return max([_as_it_stands(one, each, candidate.assumptions) for each in same] + [0.0])


def _as_it_stands(hypothesis: Hypothesis, effect: Effect, assumptions: Assumptions) -> float:
    """Evidence of an effect of which no amplitude is fitted."""
    displacement = {"": hypothesis.simulation.displacement(effect)}
    products = products_of(hypothesis, displacement, assumptions)
    if not products:
        return 0.0
    return score(hypothesis, effect, [""], products, assumptions, fixed=True).evidence
