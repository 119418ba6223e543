"""How surely logs know the parameters of an accepted cause."""

from __future__ import annotations

import numpy as np

from thermaltool.diagnosis.hypothesis import TINY, Hypothesis
from thermaltool.signals.intervals import NORMAL_95


def intervals_of(hypothesis: Hypothesis, at: int) -> dict[str, tuple[float, float]]:
    """95 % intervals of the parameters of an effect, within what is plausible.

    Parameters
    ----------
    hypothesis : Hypothesis
    at : int
        Which of the model's effects.
    """
    effect, result = hypothesis.model.effects[at], {}
    for name, deviation in _deviations(hypothesis, at).items():
        known, value = effect.parameter(name), effect.parameters[name]
        low, high = value - NORMAL_95 * deviation, value + NORMAL_95 * deviation
        result[name] = (max(low, known.low), min(high, known.high))
    return result


def _deviations(hypothesis: Hypothesis, at: int) -> dict[str, float]:
    """Standard errors of the parameters of an effect that the model holds."""
    names = list(hypothesis.model.effects[at].parameters)
    precision = np.zeros((len(names), len(names)))
    for output, evidence in hypothesis.evidence.items():
        null, accepted = evidence.null(hypothesis.assumptions), hypothesis.nuisance[output].accepted
        own = [name for k, name in accepted if k == at]
        if not own:
            continue
        places = np.flatnonzero(np.array(evidence.names)[null.active] == "accepted")
        index = places[[k for k, (e, _) in enumerate(accepted) if e == at]]
        half = null.whitening[null.level][index]
        block = half @ half.T * null.white**2
        rows = [names.index(name) for name in own]
        size = np.sqrt(np.maximum(np.diag(block), TINY))
        inverse = np.linalg.pinv(block / np.outer(size, size), hermitian=True)
        precision[np.ix_(rows, rows)] += evidence.independence * inverse / np.outer(size, size)
    known = np.flatnonzero(np.diag(precision) > 0)
    size = np.sqrt(np.diag(precision)[known])
    scaled = precision[np.ix_(known, known)] / np.outer(size, size)
    variance = np.diag(np.linalg.pinv(scaled, hermitian=True)) / size**2
    return {names[k]: float(np.sqrt(v)) for k, v in zip(known, variance, strict=True)}
