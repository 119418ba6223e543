"""Unseen logs in which nothing is wrong, and what causes found elsewhere do there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.readings import hidden_noise
from thermaltool.diagnosis.simulation import SimulatedLogs
from thermaltool.diagnosis.state import WITHIN_CALIBRATION, DiagnosisTask, SearchState
from thermaltool.diagnosis.written import cannot_run
from thermaltool.record import Record

# Something is wrong with a log, or left over, where the power above noise is this many times that
# of the noise.
MIN_MISFIT = 1.0
# Causes change nothing of a log from which they take less than this share of a reading's noise.
SILENT = 0.1


def sound_logs(task: DiagnosisTask) -> list[int]:
    """Numbers of the unseen logs that the model as it came fits.

    Parameters
    ----------
    task : DiagnosisTask
    """
    known = corrected(task.model)
    return [
        k
        for k, log in enumerate(task.validate)
        if misfit(Hypothesis.of(known, (log,), known, WITHIN_CALIBRATION)) < MIN_MISFIT
    ]


def are_silent(search: SearchState, log: Record) -> bool:
    """Whether the causes that are not of one log alone are some, and change nothing of another.

    Parameters
    ----------
    search : SearchState
    log : Record
    """
    model, white = search.hypothesis.model, search.hypothesis.white
    lasting = {(c.effect.name, c.effect.channel) for c in search.causes if c.effect.log is None}
    if not lasting or cannot_run(model, log) is not None:
        return False
    # What the model came with acts there as it did.
    rest = tuple(each for each in model.effects if (each.name, each.channel) not in lasting)
    without, beside = (
        SimulatedLogs(replace(model, effects=effects), (log,), {}).outputs[0]
        for effects in (rest, model.effects)
    )
    return all(
        float(np.max(np.abs(beside[output] - without[output]))) < SILENT * white(output)
        for output in without
        if output in search.hypothesis.groups
    )


def misfit(hypothesis: Hypothesis) -> float:
    """Power of the worst output's residual over that of its noise, less one.

    Parameters
    ----------
    hypothesis : Hypothesis
    """
    return max(
        (
            (
                float(np.mean(np.square(groups.joined(hypothesis.unexplained(o)))))
                + hidden_noise(hypothesis.simulation, o) ** 2
            )
            / hypothesis.nuisance[o].white ** 2
            - 1
            for o, groups in hypothesis.groups.items()
        ),
        default=np.inf,
    )
