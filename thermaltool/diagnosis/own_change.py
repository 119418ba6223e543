"""What a model's own parameters have become since its calibration, and what that means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from thermaltool.effects.effect import Float
from thermaltool.model import Term
from thermaltool.units import is_absolute

# A response has changed where its drive moves an output by so many times the noise more or less.
MIN_MOVED = 3.0
# A change of the loss of heat is told from so much of its logarithm on, where gains and time
# constants of all outputs, two at least, agree with it within this part of that.
MIN_CHANGE_OF_LOSS, SAME_PROPORTION = 0.1, 0.35


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
        before, after = (float(term.response.step(end)[-1]) for term in (old, new))
        change = abs(after - before) * ended.simulation.level(old.drive)
        size = change / noise.get(old.output, np.inf)
        if before and size > moved.get(old.drive, (MIN_MOVED, ""))[0]:
            moved[old.drive] = size, f"{old.drive} moves {old.output} {after / before:.3g} times"
    if not moved:
        return search.noted(HAS_CHANGED)
    told = ", ".join(sentence for _, sentence in moved.values())
    why = loss_of_heat(task.model.terms, ended.model.terms, end)
    return search.noted(f"{HAS_CHANGED} ({told} as far as it did{why})")


def loss_of_heat(before: Sequence[Term], after: Sequence[Term], end: Float) -> str:
    """What it means that all outputs reach less and are there sooner, or more, and later.

    Of a body that loses heat at another rate gain and slowest time constant change alike.

    Parameters
    ----------
    before, after : sequence of Term
        The same ones of two models.
    end : ndarray, shape (2,)
        0 and the time after which a response is there [s].

    Returns
    -------
    str
        The end of a sentence; empty where they do not change alike.
    """
    gains, rates, outputs = [], [], set()
    for old, new in zip(before, after, strict=True):
        reached, slowest = float(old.response.step(end)[-1]), old.response.slowest()
        # A temperature of the surroundings is reached in the end, however fast.
        if reached and not is_absolute(old.drive):
            gains.append(float(new.response.step(end)[-1]) / reached)
            rates.append(slowest / new.response.slowest())
            outputs.add(old.output)
    if len(outputs) < 2 or min(gains) <= 0:
        return ""
    changes = np.log([*rates, *(1 / gain for gain in gains)])
    faster = float(np.exp(np.median(changes[: len(rates)])))
    off = float(np.max(np.abs(changes - np.log(faster))))
    if abs(np.log(faster)) < max(MIN_CHANGE_OF_LOSS, off / SAME_PROPORTION):
        return ""
    told = f"less, and sooner, as where heat is lost {faster:.2g} times as fast"
    if faster < 1:
        told = f"more, and later, as where heat is lost {1 / faster:.2g} times as slowly"
    return f"; all outputs reach {told}: look at fan, filter, covers and coolant"
