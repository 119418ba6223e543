"""Effects that a model holds already: how their parameters may move an output.

Those of accepted causes are free beside every further cause; those that a calibration has found
move by the standard errors that it gives.
"""

from __future__ import annotations

import numpy as np

from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Effect
from thermaltool.model import Model
from thermaltool.signals.symmetric import eigh

# Variance of a scaled direction below which it does not move.
MIN_VARIANCE = 1e-9


def accepted_effects(
    simulation: SimulatedLogs, calibrated: Model, output: str
) -> dict[tuple[int, str], Series]:
    """Change of an output per unit of each parameter whose error no calibration gives.

    Parameters
    ----------
    simulation : SimulatedLogs
    calibrated : Model
    output : str

    Returns
    -------
    dict of (number of the effect, parameter) to list of ndarray
    """
    return {
        (at, name): change
        for at, effect in enumerate(simulation.model.effects)
        if not _roots(calibrated, effect)
        # The instant of an accident is found by scanning: it has no slope.
        for name in (*effect.linear(), *(() if effect.event else effect.searched()))
        if (change := simulation.slopes.of_effect(at, name).get(output)) is not None
    }


def calibrated_effects(simulation: SimulatedLogs, calibrated: Model, output: str) -> list[Series]:
    """Change of an output by one deviation of what was calibrated of each effect.

    Parameters
    ----------
    simulation : SimulatedLogs
    calibrated : Model
    output : str
    """
    found: list[Series] = []
    for at, effect in enumerate(simulation.model.effects):
        for root in _roots(calibrated, effect):
            moves = [
                [move * each for each in change]
                for name, move in root.items()
                if (change := simulation.slopes.of_effect(at, name).get(output)) is not None
            ]
            if moves:
                found.append([np.sum(each, axis=0) for each in zip(*moves, strict=True)])
    return found


def _roots(calibrated: Model, effect: Effect) -> list[dict[str, float]]:
    """Moves of an effect's parameters by the calibration, each of deviation one; none, if unknown.

    Columns of a root of the covariance: parameters that only move together do so here.
    """
    for each in calibrated.effects:
        if each == effect and each.covariance is not None:
            errors = np.sqrt(np.diag(each.covariance))
            scale = np.where(errors > 0, errors, 1.0)
            values, vectors = eigh(each.covariance / np.outer(scale, scale))
            kept = values > MIN_VARIANCE
            columns = (errors[:, None] * vectors[:, kept] * np.sqrt(values[kept])).T.tolist()
            return [
                {n: m for n, m in zip(each.parameters, column, strict=True) if m}
                for column in columns
            ]
    return []
