"""What a model's own parameters have become since its calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.residual_budget import (
    ADEQUATE_SHARE,
    OutputInLog,
    ResidualBudget,
    weigh_residuals,
)
from thermaltool.diagnosis.search import HAS_CHANGED
from thermaltool.diagnosis.state import DiagnosisTask, SearchState
from thermaltool.diagnosis.verdict import MIN_SHARE_LEFT
from thermaltool.units import is_absolute

# A response has changed where its drive moves an output by so many times the noise more or less.
MIN_MOVED = 3.0


def with_own_change(
    task: DiagnosisTask,
    search: SearchState,
    budgets: Mapping[OutputInLog, ResidualBudget],
    noise: Mapping[str, float],
) -> SearchState:
    """What the model's own parameters have become, where that is what is wrong; else no word of it.

    A trouble of another kind bends them as well, and stays.

    Parameters
    ----------
    task : DiagnosisTask
    search : SearchState
        Finished.
    budgets : mapping of (output, log number) to ResidualBudget
        Without any cause.
    noise : mapping of output to float
        Of a reading.
    """
    ended = search.ended
    if ended.model.effects != task.model.effects:
        # Causes that were dropped since do not speak for the parameters.
        ended = search.open().fitted()
    _, left = weigh_residuals(ended, ended, noise)
    search = replace(search, notes=tuple(note for note in search.notes if note != HAS_CHANGED))
    if any(
        each.allowed < ADEQUATE_SHARE
        and each.unexplained > MIN_SHARE_LEFT * budgets[at].unexplained
        for at, each in left.items()
    ):
        return search.noted(
            "other parameters of the model's own do not explain it: to calibrate again is no help"
        )
    end = np.array([0.0, max(log.duration for log in task.logs)])
    moved: dict[str, tuple[float, str]] = {}
    for old, new in zip(task.model.terms, ended.model.terms, strict=True):
        if is_absolute(old.drive):  # a room is reached in the end
            continue
        before, after = (float(term.response.step(end)[-1]) for term in (old, new))
        change = abs(after - before) * ended.simulation.level(old.drive)
        size = change / noise.get(old.output, np.inf)
        if before and size > moved.get(old.drive, (MIN_MOVED, ""))[0]:
            moved[old.drive] = size, f"{old.drive} moves {old.output} {after / before:.3g} times"
    if not moved:
        return search.noted(HAS_CHANGED)
    told = ", ".join(sentence for _, sentence in moved.values())
    return search.noted(f"{HAS_CHANGED} ({told} as far as it did)")
