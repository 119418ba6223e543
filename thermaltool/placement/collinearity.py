"""Which sensors say the same: condition number, variance inflation, groups of near equal ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.fitting.components.reduction import (
    NEARLY_SAME_CORRELATION,
    correlation,
    same_inputs,
)
from thermaltool.fitting.data import Array, TrainingData


@dataclass(frozen=True)
class Collinearity:
    """How near sensors are to combinations of each other.

    Attributes
    ----------
    sensors : tuple of str
    condition : float
        Largest over smallest singular value of the readings, each about its mean at unit variance
        (Belsley, Kuh, Welsch 1980: above 30 weights are badly known).
    inflation : tuple of float
        Variance of each weight over what it is where the others say nothing of the sensor.
    groups : tuple of tuple of str
        Sensors that are nearly equal but for zero and scale.
    """

    sensors: tuple[str, ...]
    condition: float
    inflation: tuple[float, ...]
    groups: tuple[tuple[str, ...], ...]


def collinearity(data: TrainingData) -> Collinearity:
    """Of the inputs of some data, all of which move.

    Parameters
    ----------
    data : TrainingData
    """
    unit: Array = correlation(data)
    values = np.linalg.eigvalsh(unit)
    smallest = max(float(values[0]), np.finfo(float).eps)
    inflation = np.diag(np.linalg.pinv(unit, hermitian=True))
    return Collinearity(
        data.inputs,
        float(np.sqrt(values[-1] / smallest)),
        tuple(np.maximum(inflation, 1.0).tolist()),
        same_inputs(data, NEARLY_SAME_CORRELATION),
    )
