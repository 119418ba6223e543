"""Which causes these logs can tell apart, and the experiment that would.

A cause at its fitted size changes the outputs by a vector; a rival can change them by anything in
the span of its amplitudes and of small moves of its other parameters. Under the noise of the logs,
with everything projected out that the model may say for itself, the angle between the two says
whether the logs can tell them apart: of the evidence for the cause, the part sin² of the angle
speaks against the rival. An input is predicted to help by the evidence that a synthetic log of it
adds, the two logs sharing the model's own parameters and those of the rival, and by the angle that
this is the sine of, of what the cause does there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.evidence import DECISIVE
from thermaltool.diagnosis.experiments import Experiment, library
from thermaltool.diagnosis.result import Alternative
from thermaltool.diagnosis.scan import Candidate
from thermaltool.diagnosis.sight import (
    Changes,
    Normal,
    Rehearsal,
    Sight,
    angle,
    displaced,
    eliminated,
    noise_after,
    reachable,
)
from thermaltool.diagnosis.visibility import (
    SHOWN,
    Detectable,
    detectable,
    invisible,
)
from thermaltool.diagnosis.workbench import Workbench
from thermaltool.effects.effect import Effect, Float

__all__ = ["Detectable", "alternatives", "detectable", "invisible", "suspected"]

# A rival that leaves more than half of a cause's power unexplained is no other name for it, but a
# second cause if it is named beside it [deg].
UNLIKE = 45.0
# No model of a structure is exact to 5 %: what differs by less is not told apart by any evidence
# [deg].
ALIKE = 3.0
# Names in a group, the accepted one included; one may stand for several channels.
MOST_NAMES = 3
# A shorter input is preferred to one that opens the angle by less than a quarter more.
ENOUGH = 0.8
# Another sensor is asked for where no input opens the angle to half of what that would.
HARDWARE = 0.5
_SENSOR = ("sensor", "wiring")
AGAIN = "log as much again with the same kind of input, and diagnose both logs together"


def alternatives(
    bench: Workbench,
    chosen: Candidate,
    rivals: Sequence[Candidate],
    named: Sequence[Effect] = (),
) -> list[Alternative]:
    """What else the accepted cause could be, and the input that would tell.

    A rival is told from it by decisive evidence, unless the two differ by less than models of
    structures are exact (`ALIKE`). One that is no decisive evidence behind is a cause of its own
    where it could not do half of what the accepted one does (`UNLIKE`) and is `named` beside it;
    where it is not, nothing was left for it to explain, and it is what else could have been.

    Parameters
    ----------
    bench : Workbench
        Before the cause was accepted.
    chosen : Candidate
    rivals : sequence of Candidate
        Refined on the same bench; the accepted one may be among them.
    named : sequence of Effect
        All that is accepted in the end.

    Returns
    -------
    list of Alternative
        One, of at most `MOST_NAMES` names, or none. `opened` is NaN where the advice is no input
        whose effect can be predicted.
    """
    caused = displaced(bench, chosen.effect)
    sight = Sight(bench, chosen.state, noise_after(bench, chosen.state, caused))
    close: list[tuple[float, float, Effect]] = []
    for rival in sorted(rivals, key=lambda c: -c.said):
        known = [chosen.effect, *(effect for _, _, effect in close)]
        if rival.said <= 0 or any(_same(rival.effect, effect) for effect in known):
            continue
        behind = chosen.said - rival.said
        signatures = [caused, *reachable(bench, rival.effect)]
        now = _angle(sight, [sight.present(signatures)], len(signatures))
        apart = now >= UNLIKE and any(_same(rival.effect, effect) for effect in named)
        if now < ALIKE or (behind < DECISIVE and not apart):
            close.append((behind, now, rival.effect))
    effects = _few_names([chosen.effect, *(effect for _, _, effect in close)])[1:]
    if not effects:
        return []
    sentence, opened = _separating(sight, chosen.effect, effects)
    return [
        Alternative(
            (chosen.effect.name, *(e.name for e in effects)),
            (chosen.effect.channel, *(e.channel for e in effects)),
            max(now for _, now, effect in close if effect in effects),
            sentence,
            opened,
        )
    ]


def suspected(bench: Workbench, candidates: Sequence[Candidate]) -> list[Alternative]:
    """What may be behind a misfit that is too small, or too little confirmed, to name its cause.

    Parameters
    ----------
    candidates : sequence of Candidate
        With evidence, the strongest first.

    Returns
    -------
    list of Alternative
        One, of at most `MOST_NAMES` names, or none.
    """
    chosen: list[Candidate] = []
    for c in candidates:
        if not any(_same(c.effect, other.effect) for other in chosen):
            chosen.append(c)
    if not chosen:
        return []
    first, *rest = _few_names([c.effect for c in chosen])
    now, sentence, opened = float("nan"), AGAIN, float("nan")
    if rest:
        caused = displaced(bench, first)
        sight = Sight(bench, chosen[0].state, noise_after(bench, chosen[0].state, caused))
        groups = [[caused, *reachable(bench, effect)] for effect in rest]
        now = max(_angle(sight, [sight.present(group)], len(group)) for group in groups)
        sentence, opened = _separating(sight, first, rest)
    effects = (first, *rest)
    names, channels = tuple(e.name for e in effects), tuple(e.channel for e in effects)
    return [Alternative(names, channels, now, sentence, opened, "suspected")]


def _few_names(effects: Sequence[Effect]) -> list[Effect]:
    """Those before a name too many."""
    names = list(dict.fromkeys(e.name for e in effects))[:MOST_NAMES]
    kept = [e.name in names for e in effects]
    return list(effects[: kept.index(False)] if False in kept else effects)


def _same(effect: Effect, other: Effect) -> bool:
    """Whether a user is told the same of both."""
    return (effect.name, effect.channel) == (other.name, other.channel)


def _angle(sight: Sight, logs: Sequence[Normal], count: int) -> float:
    """Between the first of `count` signatures and the others, all outputs together [deg]."""
    return angle(np.sum(list(sight.reduced(logs, count).values()), axis=0))


def _shortest(experiments: Sequence[Experiment], opened: Sequence[float]) -> int:
    """The shortest of the inputs that open nearly as far as the best one."""
    good = [k for k, value in enumerate(opened) if value >= ENOUGH * max(opened)]
    return min(good, key=lambda k: experiments[k].signals.duration)


# ---------------------------------------------------------------- the input that would tell


@dataclass(frozen=True)
class _Opening:
    """What something more to measure tells of two causes.

    Attributes
    ----------
    evidence : float
        By which it tells them apart beyond what the logs do.
    angle : float [deg]
        Between them there, the rival held to what the logs say of it.
    """

    evidence: float
    angle: float


def _opening(sight: Sight, present: Normal, more: Normal, count: int) -> _Opening:
    def products(*logs: Normal) -> Float:
        return np.asarray(np.sum(list(sight.reduced(logs, count).values()), axis=0))

    before, after = products(present), products(present, more)
    evidence = max(float(eliminated(after, 1)[0, 0] - eliminated(before, 1)[0, 0]), 0.0)
    size = float(after[0, 0] - before[0, 0])
    # What one cause does and the other does not is as different as can be.
    share = evidence / size if size > evidence else float(evidence > 0)
    return _Opening(evidence, float(np.degrees(np.arcsin(np.sqrt(share)))))


def _worst(openings: Sequence[_Opening]) -> _Opening:
    return _Opening(min(o.evidence for o in openings), min(o.angle for o in openings))


def _separating(sight: Sight, chosen: Effect, rivals: Sequence[Effect]) -> tuple[str, float]:
    """What would tell the cause from its rivals, and the smallest angle that it opens [deg]."""
    bench = sight.bench
    caused = displaced(bench, chosen)
    groups = [[caused, *reachable(bench, rival)] for rival in rivals]
    presents = [sight.present(group) for group in groups]
    opened: list[_Opening] = []
    experiments: Sequence[Experiment] = ()
    if any(_comes_back(effect) for effect in (chosen, *rivals)):
        reached = {o for group in groups for changes in group for o in changes}
        rehearsal = Rehearsal(sight, library(bench, [chosen, *rivals]), reached)
        experiments = rehearsal.experiments
        caused_then = _recurring(rehearsal.bench, chosen, [caused])
        normals = [
            rehearsal.normals([*caused_then, *_recurring(rehearsal.bench, rival, group[1:])])
            for rival, group in zip(rivals, groups, strict=True)
        ]
        opened = [
            _worst(
                [
                    _opening(sight, present, each[k], len(group))
                    for present, each, group in zip(presents, normals, groups, strict=True)
                ]
            )
            for k in range(len(experiments))
        ]
    deciding = [k for k, o in enumerate(opened) if o.evidence > DECISIVE and o.angle > SHOWN]
    best = max((opened[k].angle for k in deciding), default=0.0)
    channel, doubled = _second_sensor(sight, chosen, rivals, presents)
    if doubled.evidence > DECISIVE and best < HARDWARE * doubled.angle:
        return (
            f"put a second sensor beside {channel} and run the same again: what both read is in "
            "the machine, what one reads is in the sensor",
            doubled.angle,
        )
    if deciding:
        k = _shortest([experiments[k] for k in deciding], [opened[k].angle for k in deciding])
        return experiments[deciding[k]].sentence, opened[deciding[k]].angle
    return _words(chosen, rivals), float("nan")


def _comes_back(effect: Effect) -> bool:
    """Whether a cause acts again in another log."""
    return not effect.event and not (effect.log and not effect.channel)


def _recurring(bench: Workbench, effect: Effect, seen: Sequence[Changes]) -> list[Changes]:
    """Of the vectors that `seen` are of an effect, those in other logs."""
    if not _comes_back(effect):
        return [{} for _ in seen]
    again = replace(effect, log=None)
    return [displaced(bench, again)] if len(seen) == 1 else list(reachable(bench, again))


def _second_sensor(
    sight: Sight, chosen: Effect, rivals: Sequence[Effect], presents: Sequence[Normal]
) -> tuple[str, _Opening]:
    """Where one more sensor would tell, and what the same logs with it would open."""
    channel = next((e.channel for e in (chosen, *rivals) if e.side in _SENSOR), "")
    if channel not in sight.bench.observed:
        return "", _Opening(0.0, 0.0)
    openings = []
    for rival, present in zip(rivals, presents, strict=True):
        count = len(present[channel].whole)
        sides = [chosen.side, *[rival.side] * (count - 1)]
        second = present[channel].only(np.array([side not in _SENSOR for side in sides]))
        openings.append(_opening(sight, present, {channel: second}, count))
    return channel, _worst(openings)


def _words(chosen: Effect, rivals: Sequence[Effect]) -> str:
    """Advice where nothing that happened once can be asked to happen again."""
    names = {effect.name for effect in (chosen, *rivals)}
    if "ambient_drift" in names:
        return "log the temperature of the air beside the machine (a column T_ambient_degC)"
    if "second_source" in names:
        return "log what else switches near the machine (pumps, lights, spindle), a column each"
    return "no input of this model tells them apart: look at the machine"
