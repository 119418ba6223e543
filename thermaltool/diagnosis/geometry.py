"""Which causes these logs can tell apart, what they cannot show, and the experiment that would.

A cause at its fitted size changes the outputs by a vector; a rival can change them by anything in
the span of its amplitudes and of small moves of its other parameters. Under the noise of the logs,
with everything projected out that the model may say for itself, the angle between the two says
whether the logs can tell them apart: of the evidence for the cause, the part sin² of the angle
speaks against the rival. An input is predicted to help by the same angle in the logs and a
synthetic log of that input together: they share the model's own parameters and those of the rival.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.evidence import FLAT, Level, State, profile
from thermaltool.diagnosis.experiments import Experiment, away_from_rest, library
from thermaltool.diagnosis.result import Alternative
from thermaltool.diagnosis.scan import Candidate
from thermaltool.diagnosis.workbench import Series, Workbench
from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect, Float, Signals, is_displacement, reference_of
from thermaltool.model import respond
from thermaltool.signals.likelihood import ColouredNoise

# Evidence that decides between two causes: odds of 150.
DECISIVE = 10.0
# A rival that leaves more than half of a cause's power unexplained is no other name for it, but
# perhaps a second cause [deg].
UNLIKE = 45.0
# No model of a structure is exact to 5 %: what differs by less is not told apart by any evidence.
ALIKE = 3.0
# Names in a group, the accepted one included.
MOST_NAMES = 3
# A simpler input is preferred to one that opens the angle by less than a quarter more.
ENOUGH = 0.8
# Another sensor is asked for where no input opens the angle to half of what that would.
HARDWARE = 0.5
# A signature of which the model's own parameters leave less than this share of the power is theirs.
DEGENERATE = 1e-4
# An input shows what it opens to this angle [deg].
SHOWN = 5.0

SENSOR_SIDES = ("sensor", "wiring")
# What is no vector of a cause at a place: these are found otherwise, or are whatever is slow.
_SHAPELESS = ("ambient_drift", "periodic", "outliers", "record_too_short")

Changes = Mapping[str, Series]


@dataclass(frozen=True)
class Noise:
    """Of one output: slow over white variance, time constant [s], white variance."""

    level: Level
    variance: float


@dataclass(frozen=True)
class Detectable:
    """What a log would show of a cause.

    Attributes
    ----------
    change : float [unit of `output`]
        RMS change of the output by which the cause would have decisive evidence.
    output : str
        The output that tells it first.
    left : float
        Norm of the signature there that the model's own parameters leave, relative to the whole.
    """

    change: float
    output: str
    left: float


def alternatives(
    bench: Workbench, chosen: Candidate, rivals: Sequence[Candidate]
) -> list[Alternative]:
    """What else the accepted cause could be, and the input that would tell.

    A rival is told from it by decisive evidence, unless the two differ by less than models of
    structures are exact (`ALIKE`); one that is no decisive evidence behind is still another cause
    where it could not do half of what the accepted one does (`UNLIKE`).

    Parameters
    ----------
    bench : Workbench
        Before the cause was accepted.
    chosen : Candidate
    rivals : sequence of Candidate
        Refined on the same bench; the accepted one may be among them.

    Returns
    -------
    list of Alternative
        One, of at most `MOST_NAMES` names, or none.
    """
    state, noise = chosen.state, _noise(bench, chosen)
    caused = _displaced(bench, chosen.effect)
    close: list[tuple[float, Effect, Float]] = []
    for rival in rivals:
        behind = chosen.evidence - rival.evidence
        if _same(rival.effect, chosen.effect) or not rival.evidence > 0:
            continue
        if any(_same(rival.effect, effect) for _, effect, _ in close):
            continue
        signatures = [caused, *_reachable(bench, rival.effect)]
        now = {o: _present(bench, o, state, n, signatures) for o, n in noise.items()}
        angle = _angle(_together([now], len(signatures), bench))
        if angle < ALIKE or (behind < DECISIVE and angle < UNLIKE):
            close.append((behind, rival.effect, np.array(angle)))
    if not close:
        return []
    close = sorted(close, key=lambda each: each[0])[: MOST_NAMES - 1]
    effects = [effect for _, effect, _ in close]
    sentence, opened = _separating(bench, state, noise, chosen.effect, effects)
    return [
        Alternative(
            (chosen.effect.name, *(e.name for e in effects)),
            (chosen.effect.channel, *(e.channel for e in effects)),
            max(float(angle) for _, _, angle in close),
            sentence,
            opened,
        )
    ]
