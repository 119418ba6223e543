"""Experiments that nobody has run yet: what they would tell of causes that look alike.

An input is predicted to help by the evidence that a synthetic log of it adds, the two logs sharing
the model's own parameters and those of the rival, and by the angle that this is the sine of, of
what the cause does there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.information import (
    InformationMatrix,
    LogInformation,
    eliminated,
    normal_matrix,
)
from thermaltool.diagnosis.inputs import Experiment, library
from thermaltool.diagnosis.limits import ExperimentLimits
from thermaltool.diagnosis.simulation import Changes, Series, SimulatedLogs
from thermaltool.diagnosis.starts import begins_away, level_responses
from thermaltool.effects.effect import Effect
from thermaltool.effects.instant import INSTANTS
from thermaltool.signals.likelihood import ColouredNoise

# An input shows what it opens to this angle [deg].
MIN_ANGLE_SHOWN = 5.0
# A shorter input is preferred to one that opens the angle by less than a quarter more.
NEARLY_BEST = 0.8
# Another sensor is asked for where no input opens the angle to half of what that would.
SENSOR_ADVANTAGE = 0.5
# Sides of an effect that a second sensor beside the first would not read.
SENSOR_SIDES = ("sensor", "wiring")


class SimulatedExperiments:
    """Information of experiments that nobody has run yet, all of them simulated at once.

    Parameters
    ----------
    information : InformationMatrix
        Of the logs that there are.
    experiments : sequence of Experiment
    outputs : iterable of str
        Outputs that the causes in question reach.
    """

    def __init__(
        self,
        information: InformationMatrix,
        experiments: Sequence[Experiment],
        outputs: Iterable[str],
    ) -> None:
        self.noise, self.experiments = information.noise, experiments
        logged = information.hypothesis
        self.hypothesis = logged.with_masked({}).with_logs([e.record for e in experiments])
        away = begins_away(logged.simulation)
        starts = level_responses(self.hypothesis.simulation) if away else []
        self._shared: dict[str, Series] = {}
        self._private: dict[str, Series] = {}
        for output in outputs:
            nuisance, known = self.hypothesis.nuisance[output], logged.nuisance[output]
            released = information.group == "released"
            root = (known.free_prior if released else known.calibrated_prior).root
            free = [*nuisance.offsets, *nuisance.accepted.values()]
            free += [start[output] for start in starts]
            self._shared[output] = [
                each.means(nuisance.moves[k]) @ root for k, each in enumerate(experiments)
            ]
            self._private[output] = [
                each.means(np.column_stack([c[k] for c in free]))
                for k, each in enumerate(experiments)
            ]
        self._factors = []
        for each in experiments:
            white = 1 / (each.readings * each.counts)
            noise = ColouredNoise(each.means(each.record.time), np.array([0]), white)
            self._factors.append(
                {o: noise.factor(n.level.ratio, n.level.tau) for o, n in self.noise.items()}
            )

    def of_logs(self, signatures: Sequence[Changes]) -> list[LogInformation]:
        """What each experiment would show of signatures.

        Parameters
        ----------
        signatures : sequence of mapping of output to list of ndarray
            In the experiments.
        """
        result = []
        for k, each in enumerate(self.experiments):
            blank = np.zeros(len(each.counts))
            normal = {}
            for output in self._shared:
                columns = [each.means(s[output][k]) if output in s else blank for s in signatures]
                private = self._private[output][k]
                private = private[:, np.any(private, axis=0)]
                normal[output] = normal_matrix(
                    columns,
                    self._shared[output][k],
                    private,
                    np.zeros(private.shape[1]),
                    self._factors[k][output],
                    self.noise[output].variance,
                )
            result.append(normal)
        return result


@dataclass(frozen=True)
class Discrimination:
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

    @staticmethod
    def by(
        information: InformationMatrix, logs: LogInformation, more: LogInformation, count: int
    ) -> Discrimination:
        """What `more` tells of the first of `count` signatures and the others beyond `logs`."""
        before, after = information.joint([logs], count), information.joint([logs, more], count)
        evidence = max(float(eliminated(after, 1)[0, 0] - eliminated(before, 1)[0, 0]), 0.0)
        size = float(after[0, 0] - before[0, 0])
        # What one cause does and the other does not is as different as can be.
        share = evidence / size if size > evidence else float(evidence > 0)
        return Discrimination(evidence, float(np.degrees(np.arcsin(np.sqrt(share)))))

    @staticmethod
    def least(several: Sequence[Discrimination]) -> Discrimination:
        """The smallest evidence, and the smallest angle, of several."""
        return Discrimination(min(s.evidence for s in several), min(s.angle for s in several))


def separating_experiment(
    information: InformationMatrix,
    chosen: Effect,
    rivals: Sequence[Effect],
    limits: ExperimentLimits,
) -> tuple[str, float]:
    """Experiment that would tell a cause from its rivals.

    Parameters
    ----------
    information : InformationMatrix
        Under the noise that the cause leaves.
    chosen : Effect
    rivals : sequence of Effect
    limits : ExperimentLimits
        What can be done at the machine.

    Returns
    -------
    sentence : str
    opened : float [deg]
        The smallest angle that it opens; NaN where advice is in words alone.
    """
    simulation = information.hypothesis.simulation
    caused = simulation.displacement(chosen)
    spans = [simulation.span(rival) for rival in rivals]
    groups = [[caused, *span.values()] for span in spans]
    logged = [information.of_logs(group) for group in groups]
    separations: list[Discrimination] = []
    experiments: Sequence[Experiment] = ()
    if any(_recurs(effect) for effect in (chosen, *rivals)):
        reached = {o for group in groups for changes in group for o in changes}
        experiments = library(information.hypothesis, [chosen, *rivals], limits)
    if experiments:
        simulated = SimulatedExperiments(information, experiments, reached)
        then = simulated.hypothesis.simulation
        caused_then = then.displacement(replace(chosen, log=None)) if _recurs(chosen) else {}
        shown = [
            simulated.of_logs([caused_then, *_again(then, rival, span)])
            for rival, span in zip(rivals, spans, strict=True)
        ]
        separations = [
            Discrimination.least(
                [
                    Discrimination.by(information, log, each[k], len(group))
                    for log, each, group in zip(logged, shown, groups, strict=True)
                ]
            )
            for k in range(len(experiments))
        ]
    deciding = [
        (experiment, s.angle)
        for experiment, s in zip(experiments, separations, strict=True)
        if s.evidence > DECISIVE_EVIDENCE and s.angle > MIN_ANGLE_SHOWN
    ]
    best = max((opened for _, opened in deciding), default=0.0)
    channel, doubled = _second_sensor(information, chosen, rivals, logged)
    if doubled.evidence > DECISIVE_EVIDENCE and best < SENSOR_ADVANTAGE * doubled.angle:
        return (
            f"put a second sensor beside {channel} and run the same again: what both read is in "
            "the machine, what one reads is in the sensor",
            doubled.angle,
        )
    if deciding:
        good = [each for each in deciding if each[1] >= NEARLY_BEST * best]
        experiment, opened = min(good, key=lambda each: each[0].record.duration)
        return experiment.sentence, opened
    return _words(information, chosen, rivals, limits), float("nan")


def _recurs(effect: Effect) -> bool:
    """Whether a cause acts again in another log."""
    began = any(name in INSTANTS for name in effect.parameters)
    return not effect.event and not (effect.log and (began or not effect.channel))


def _again(simulation: SimulatedLogs, effect: Effect, seen: Iterable[str]) -> list[Changes]:
    """The span of an effect in other logs, amplitude by amplitude; nothing where it is not seen."""
    found = simulation.span(replace(effect, log=None)) if _recurs(effect) else {}
    return [found.get(name, {}) for name in seen]


def _second_sensor(
    information: InformationMatrix,
    chosen: Effect,
    rivals: Sequence[Effect],
    logged: Sequence[LogInformation],
) -> tuple[str, Discrimination]:
    """Where one more sensor would tell, and what the same logs with it would open."""
    channel = next((e.channel for e in (chosen, *rivals) if e.side in SENSOR_SIDES), "")
    if channel not in information.hypothesis.groups:
        return "", Discrimination(0.0, 0.0)
    separations = []
    for rival, log in zip(rivals, logged, strict=True):
        count = len(log[channel].whole)
        sides = [chosen.side, *[rival.side] * (count - 1)]
        second = log[channel].only(np.array([side not in SENSOR_SIDES for side in sides]))
        separations.append(Discrimination.by(information, log, {channel: second}, count))
    return channel, Discrimination.least(separations)


def _words(
    information: InformationMatrix,
    chosen: Effect,
    rivals: Sequence[Effect],
    limits: ExperimentLimits,
) -> str:
    """Advice where nothing that happened once can be asked to happen again."""
    names = {effect.name for effect in (chosen, *rivals)}
    if "ambient_drift" in names:
        return "log the temperature of the air beside the machine (a column T_ambient_degC)"
    if "second_source" in names:
        return "log what else switches near the machine (pumps, lights, spindle), a column each"
    if not any(limits.can_set(d.channel) for d in information.hypothesis.model.drives):
        return (
            "log a run that warms the machine otherwise (longer, shorter, harder), and diagnose "
            "both logs together"
        )
    return "look at the machine, for no input of this model would tell them apart"
