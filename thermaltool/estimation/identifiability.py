"""Whether the sensors of a model can tell its drives apart."""

from __future__ import annotations

import math

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.static_gains import RANK_TOLERANCE, static_gains
from thermaltool.responses.modes import Float

# A combination of drives at their calibrated levels that moves the sensors by fewer standard
# deviations of their noise than this is hardly seen.
VISIBLE = 3.0


def identifiability_note(problem: DesignModel) -> str | None:
    """What the sensors hardly see of the drives, as a sentence; None where they see all.

    A heat that stays is known by the sensors' steady states alone: the matrix of the static gains
    has to have the rank of the number of drives.

    Parameters
    ----------
    problem : DesignModel

    Raises
    ------
    ModelError
        A combination of drives leaves every sensor where it is, however long it lasts.
    """
    if not problem.drives:
        return None
    gains, sigma = static_gains(problem), noise_sizes(problem)
    # Of the levels in standard deviations of the sensors.
    _, sizes, directions = np.linalg.svd(gains * np.array(problem.level) / sigma[:, None])
    seen = np.zeros(len(problem.drives))
    seen[: len(sizes)] = sizes
    if seen[-1] > VISIBLE:
        return None
    names, sensors = ", ".join(problem.drives), ", ".join(problem.sensors)
    if seen[-1] <= RANK_TOLERANCE * seen[0]:
        count = len(problem.drives)
        cure = f"measure one (--measured {problem.drives[-1]}) or add a sensor"
        if count == 1:
            raise ModelError(f"{names} leaves {sensors} where it is in steady state: {cure}")
        raise ModelError(
            f"{count} drives ({names}) cannot be told apart by {sensors}: "
            f"{_combination(problem, directions[-1])} leaves {_every(problem.sensors)} where it "
            f"is; {cure}"
        )
    return (
        f"{_combination(problem, directions[-1])} moves the sensors by only {seen[-1]:.2g} "
        "standard deviations of their noise: hardly identifiable"
    )


def noise_sizes(problem: DesignModel) -> Float:
    """Standard deviation of each sensor's noise, drift included; 1 where there is none."""
    return np.array([math.hypot(each.white, each.drift) or 1.0 for each in problem.noise])


def _combination(problem: DesignModel, direction: Float) -> str:
    """A change of several drives at once, relative to the largest one."""
    changes = direction * np.array(problem.level)
    changes = changes / changes[np.argmax(np.abs(changes))]
    parts = [
        f"{change:+.3g} {name}"
        for change, name in zip(changes, problem.drives, strict=True)
        if abs(change) > RANK_TOLERANCE
    ]
    return " and ".join(parts)


def _every(sensors: tuple[str, ...]) -> str:
    return "the sensor" if len(sensors) == 1 else "every sensor"
