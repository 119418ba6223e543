"""Accepted causes fitted beside one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.select import fit_candidate

# Turns between causes at most; they agree where a turn moves no output by more than this share of
# the noise of a reading (RMS).
MAX_TURNS, AGREED = 4, 0.1


def fitted_together(hypothesis: Hypothesis) -> Hypothesis:
    """The model's own parameters and all causes that it was given, in turns until they agree.

    A cause that was fitted before another one was known stands for a part of that, too.

    Parameters
    ----------
    hypothesis : Hypothesis
        With effects that its calibrated model has not.
    """
    calibrated = hypothesis.calibrated.effects
    places = [k for k, each in enumerate(hypothesis.model.effects) if each not in calibrated]
    hypothesis = hypothesis.fitted()
    for _ in range(MAX_TURNS if places else 0):
        before = hypothesis
        for k in places:
            hypothesis = _with_fitted(hypothesis, k)
        if _agree(before, hypothesis):
            return hypothesis
    return hypothesis.fitted()


def _with_fitted(hypothesis: Hypothesis, at: int) -> Hypothesis:
    """One effect fitted beside all others, where that can be."""
    effects = hypothesis.model.effects
    effect = effects[at]
    if all(effect.parameter(name).fixed for name in effect.parameters):
        return hypothesis
    rest = replace(hypothesis.model, effects=(*effects[:at], *effects[at + 1 :]))
    bare = hypothesis.with_model(rest)
    found = fit_candidate(bare, CauseCandidate.unfitted(effect, bare.assumptions))
    if not np.isfinite(found.gain):
        return hypothesis
    return hypothesis.with_model(
        replace(hypothesis.model, effects=(*effects[:at], found.effect, *effects[at + 1 :]))
    )


def _agree(before: Hypothesis, after: Hypothesis) -> bool:
    """Whether the outputs of two models differ by next to nothing."""
    moved = before.simulation.change(after.simulation.outputs)
    return all(
        float(np.sqrt(np.mean(before.groups[o].joined(series) ** 2))) < AGREED * before.white(o)
        for o, series in moved.items()
    )
