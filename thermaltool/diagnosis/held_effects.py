"""Effects that a model holds already: how their parameters may move an output.

Those of accepted causes are free beside every further cause; those that a calibration has found
move by the standard errors that it gives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.effects.effect import Effect
from thermaltool.model import Model

# Moves from which slopes are taken: of what is linear in an effect and what is not, both relative,
# and the smallest.
LINEAR_MOVE, SEARCHED_MOVE, MIN_MOVE = 1e-3, 1e-2, 1e-6


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
        if not _errors(calibrated, effect)
        # The instant of an accident is found by scanning: it has no slope.
        for name in (*effect.linear(), *(() if effect.event else effect.searched()))
        if (change := _sensitivity(simulation, at, name, output)) is not None
    }


def calibrated_effects(simulation: SimulatedLogs, calibrated: Model, output: str) -> list[Series]:
    """Change of an output by one standard error of each parameter that was calibrated.

    Parameters
    ----------
    simulation : SimulatedLogs
    calibrated : Model
    output : str
    """
    return [
        [error * each for each in change]
        for at, effect in enumerate(simulation.model.effects)
        for name, error in _errors(calibrated, effect).items()
        if (change := _sensitivity(simulation, at, name, output)) is not None
    ]


def _errors(calibrated: Model, effect: Effect) -> dict[str, float]:
    """Standard errors of an effect's parameters by the calibration; none where it has none."""
    for each in calibrated.effects:
        if each == effect and each.covariance is not None:
            errors = np.sqrt(np.diag(each.covariance)).tolist()
            return {n: e for n, e in zip(each.parameters, errors, strict=True) if e > 0}
    return {}


def _sensitivity(simulation: SimulatedLogs, at: int, name: str, output: str) -> Series | None:
    """Change of an output per unit of a parameter of an effect; None where there is none."""
    effects = list(simulation.model.effects)
    step = _step(effects[at], name)
    effects[at] = effects[at].changed({name: effects[at].parameters[name] + step})
    changed = simulation.with_effects(model=replace(simulation.model, effects=tuple(effects)))
    change = simulation.change(changed).get(output)
    return None if change is None else [c / step for c in change]


def _step(effect: Effect, name: str) -> float:
    """Move of an effect's parameter from which its slope is taken."""
    relative = LINEAR_MOVE if effect.parameter(name).linear else SEARCHED_MOVE
    return max(relative * abs(effect.parameters[name]), MIN_MOVE)
