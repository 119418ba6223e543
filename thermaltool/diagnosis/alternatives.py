"""What a diagnosis leaves open: causes that these logs cannot tell apart, or cannot show at all.

A cause at its fitted size changes the outputs by a vector; a rival can change them by anything in
the span of its amplitudes and of small moves of its other parameters. Under the noise of the logs,
with everything projected out that the model may say for itself, the angle between the two says
whether the logs can tell them apart: of the evidence for the cause, the part sin² of the angle
speaks against the rival.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.experiments import (
    MIN_ANGLE_SHOWN,
    SimulatedExperiments,
    separating_experiment,
)
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.information import InformationMatrix, detectable, noise_after
from thermaltool.diagnosis.inputs import library
from thermaltool.diagnosis.limits import UNLIMITED, USUAL_LIMITS, ExperimentLimits
from thermaltool.diagnosis.result import Alternative, Tried
from thermaltool.diagnosis.select import Ranking, trials
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError

# A rival that leaves more than half of a cause's power unexplained is no other name for it, but a
# second cause if it is named beside it [deg].
MIN_ANGLE_OF_ANOTHER = 45.0
# No model of a structure is exact to 5 %: what differs by less is not told apart by any evidence
# [deg].
MAX_ANGLE_ALIKE = 3.0
# Names in a group, the accepted one included; one may stand for several channels.
MAX_NAMES = 3
# Of the inputs that show what has not been seen, the first that opens this share of the best angle
# is asked for.
SIMPLEST_SHARE = 0.5
# Causes found otherwise, or free to be whatever is slow: no vector at a place of the model.
WITHOUT_SIGNATURE = ("ambient_drift", "periodic", "outliers", "record_too_short")
LOG_AGAIN = "log as much again with the same kind of input, and diagnose both logs together"


def indistinguishable(
    hypothesis: Hypothesis,
    chosen: CauseCandidate,
    rivals: Sequence[CauseCandidate],
    named: Sequence[Effect] = (),
    limits: ExperimentLimits = USUAL_LIMITS,
) -> list[Alternative]:
    """What else an accepted cause could be, and the input that would tell.

    A rival is told from it by decisive evidence, unless the two differ by less than models of
    structures are exact (`MAX_ANGLE_ALIKE`). One that is no decisive evidence behind is a cause of
    its own where it could not do half of what the accepted one does (`MIN_ANGLE_OF_ANOTHER`) and is
    `named` beside it; where it is not, nothing was left for it to explain, and it is what else
    could have been.

    Parameters
    ----------
    hypothesis : Hypothesis
        Before the cause was accepted.
    chosen : CauseCandidate
    rivals : sequence of CauseCandidate
        Fitted under the same hypothesis; the accepted one may be among them. One that has the
        model's own parameters free where the accepted one does not is none.
    named : sequence of Effect
        All that is accepted in the end.
    limits : ExperimentLimits
        What can be done at the machine.

    Returns
    -------
    list of Alternative
        One, of at most `MAX_NAMES` names, or none. `opened` is NaN where the advice is no input
        whose effect can be predicted.
    """
    simulation = hypothesis.simulation
    caused = simulation.displacement(chosen.effect)
    noise = noise_after(hypothesis, chosen.assumptions, caused)
    information = InformationMatrix(hypothesis, chosen.assumptions, noise)
    close: list[tuple[float, Effect]] = []
    for rival in sorted(rivals, key=lambda c: -c.evidence_of_logs):
        known = [chosen.effect, *(effect for _, effect in close)]
        if rival.evidence_of_logs <= 0 or any(_same(rival.effect, effect) for effect in known):
            continue
        # Beside a model that is free to change anything looks strong.
        if "released" in rival.assumptions - chosen.assumptions:
            continue
        behind = chosen.evidence_of_logs - rival.evidence_of_logs
        signatures = [caused, *simulation.span(rival.effect).values()]
        now = information.angle([information.of_logs(signatures)], len(signatures))
        beside = any(_same(rival.effect, effect) for effect in named)
        apart = now >= MIN_ANGLE_OF_ANOTHER and beside
        # One that weighs each output for itself comes near any.
        alike = now < MAX_ANGLE_ALIKE and not rival.effect.stands
        if alike or (behind < DECISIVE_EVIDENCE and not apart):
            close.append((now, rival.effect))
    effects = _few_names([chosen.effect, *(effect for _, effect in close)])
    if len(effects) < 2:
        return []
    sentence, opened = separating_experiment(information, chosen.effect, effects[1:], limits)
    largest = max(now for now, effect in close if effect in effects[1:])
    return [_alternative(effects, largest, sentence, opened, "indistinguishable")]


def suspected(
    hypothesis: Hypothesis,
    candidates: Sequence[CauseCandidate],
    limits: ExperimentLimits = USUAL_LIMITS,
) -> list[Alternative]:
    """What may be behind a misfit that is too small, or too little confirmed, to name its cause.

    Parameters
    ----------
    hypothesis : Hypothesis
    candidates : sequence of CauseCandidate
        With evidence, the strongest first.
    limits : ExperimentLimits
        What can be done at the machine.

    Returns
    -------
    list of Alternative
        One, of at most `MAX_NAMES` names, or none.
    """
    chosen: list[CauseCandidate] = []
    for c in candidates:
        if not any(_same(c.effect, other.effect) for other in chosen):
            chosen.append(c)
    if not chosen:
        return []
    effects = _few_names([c.effect for c in chosen])
    first, *rest = effects
    now, sentence, opened = float("nan"), LOG_AGAIN, float("nan")
    if rest:
        simulation = hypothesis.simulation
        caused = simulation.displacement(first)
        noise = noise_after(hypothesis, chosen[0].assumptions, caused)
        information = InformationMatrix(hypothesis, chosen[0].assumptions, noise)
        groups = [[caused, *simulation.span(effect).values()] for effect in rest]
        now = max(information.angle([information.of_logs(g)], len(g)) for g in groups)
        sentence, opened = separating_experiment(information, first, rest, limits)
    return [_alternative(effects, now, sentence, opened, "suspected")]


def invisible(hypothesis: Hypothesis, limits: ExperimentLimits = USUAL_LIMITS) -> list[Alternative]:
    """Causes whose place is there but which these logs cannot show, and the input that would.

    Which they are does not depend on what can be done at the machine.

    Parameters
    ----------
    hypothesis : Hypothesis
    limits : ExperimentLimits
        What can be done at the machine.

    Returns
    -------
    list of Alternative
        One for each channel, with the simplest input within the limits that would show all of its
        causes; no sentence where none does. `angle` and `opened` are between a signature and what
        the model may say for itself, the smallest of several.
    """
    information = InformationMatrix(hypothesis, hypothesis.assumptions)
    unseen = list(_unseen(information))
    if not unseen:
        return []
    anything = library(hypothesis, unseen, UNLIMITED)
    possible = {e.sentence: e for e in library(hypothesis, unseen, limits)}
    count, others = len(anything), {e.sentence for e in anything}
    experiments = [*anything, *(e for s, e in possible.items() if s not in others)]
    feasible = np.array([e.sentence in possible for e in experiments])
    simulated = SimulatedExperiments(information, experiments, hypothesis.groups)
    places: dict[str, list[tuple[Effect, float, list[float]]]] = {}
    for effect in unseen:
        now = information.of_logs([hypothesis.simulation.displacement(effect)])
        then = simulated.of_logs([simulated.hypothesis.simulation.displacement(effect)])
        opened = [information.angle_to_model(now, each) for each in then]
        if max(opened[:count]) >= MIN_ANGLE_SHOWN:
            place = places.setdefault(effect.channel, [])
            place.append((effect, information.angle_to_model(now), opened))
    found = []
    for group in places.values():
        least = np.where(feasible, np.min([opened for _, _, opened in group], axis=0), 0.0)
        effects = [effect for effect, _, _ in group]
        smallest = min(now for _, now, _ in group)
        sentence, shown = "", float("nan")
        if least.max() >= MIN_ANGLE_SHOWN:
            k = int(np.argmax(least >= SIMPLEST_SHARE * least.max()))
            sentence, shown = experiments[k].sentence, float(least[k])
        found.append(_alternative(effects, smallest, sentence, shown, "invisible"))
    return found


def tried_causes(hypothesis: Hypothesis, ranking: Ranking) -> tuple[Tried, ...]:
    """Every cause at its best, and the size from which these logs would show it.

    Parameters
    ----------
    hypothesis : Hypothesis
    ranking : Ranking
        Of the causes under it.
    """
    best: dict[tuple[str, str], CauseCandidate] = {}
    for c in ranking.scanned:
        place = c.effect.name, c.effect.channel
        best.setdefault(place, replace(c, evidence=c.evidence - ranking.correction))
    for c in reversed(ranking.fitted):
        best[c.effect.name, c.effect.channel] = c
    information = InformationMatrix(hypothesis, hypothesis.assumptions)
    result = []
    for c in sorted(best.values(), key=lambda c: -ranking.beyond(c)):
        seen = detectable(information, c.effect, ranking.correction)
        evidence = ranking.beyond(c)
        verdict = "evidence" if evidence > DECISIVE_EVIDENCE else "no evidence"
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


def _unseen(information: InformationMatrix) -> Iterator[Effect]:
    """A trial of every cause and channel of which these logs show no trial at all."""
    hypothesis = information.hypothesis
    names = [n for n in CATALOGUE if n not in WITHOUT_SIGNATURE and not effect_class(n).event]
    places: dict[tuple[str, str], list[Effect]] = {}
    for trial in trials(hypothesis, names):
        if trial.log is None and trial.channel:
            places.setdefault((trial.name, trial.channel), []).append(trial)
    for several in places.values():
        # The middle one of what an effect lists is a typical one.
        middle = len(several) // 2
        ordered = [several[middle], *several[:middle], *several[middle + 1 :]]
        if not any(_shows(information, trial) for trial in ordered):
            yield ordered[0]


def _shows(information: InformationMatrix, trial: Effect) -> bool:
    """Whether these logs show a trial; what runs away in them does not hide."""
    try:
        caused = information.hypothesis.simulation.displacement(trial)
    except ModelError:
        return True
    return information.shows(caused)


def _alternative(
    effects: Sequence[Effect], angle: float, sentence: str, opened: float, kind: str
) -> Alternative:
    names, channels = tuple(e.name for e in effects), tuple(e.channel for e in effects)
    return Alternative(names, channels, angle, sentence, opened, kind)


def _few_names(effects: Sequence[Effect]) -> list[Effect]:
    """Those before a name too many."""
    names = list(dict.fromkeys(e.name for e in effects))[:MAX_NAMES]
    kept = [e.name in names for e in effects]
    return list(effects[: kept.index(False)] if False in kept else effects)


def _same(effect: Effect, other: Effect) -> bool:
    """Whether a user is told the same of both."""
    return (effect.name, effect.channel) == (other.name, other.channel)
