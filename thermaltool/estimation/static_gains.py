"""Steady states of sensors per unit of the drives, and which of them contradict a heat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses.modes import Float, Modes

# Below this share of the largest singular value of the static gains there is none.
RANK_TOLERANCE = 1e-6


class DrivenSensors(Protocol):
    """Drives and sensors, with the responses between them."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns that are read."""

    @property
    def drives(self) -> tuple[str, ...]:
        """What is estimated of them."""

    @property
    def sensed(self) -> Sequence[tuple[int, int, Modes]]:
        """(sensor, drive, response) for every term that ends in a sensor."""


def static_gains(machine: DrivenSensors) -> Float:
    """Steady state of each sensor per unit of each drive, shape (n_sensors, n_drives).

    Parameters
    ----------
    machine : DrivenSensors
    """
    gains = np.zeros((len(machine.sensors), len(machine.drives)))
    for sensor, drive, modes in machine.sensed:
        gains[sensor, drive] += modes.dc_gain()
    return gains


def checked_sensors(machine: DrivenSensors) -> NDArray[np.bool_]:
    """Sensors that others contradict where the model is wrong of them, shape (n_sensors,).

    The least-squares heat takes up all of a sensor whose leverage is one: it is the only one that
    shows some combination of the drives. One that no drive moves has nothing to contradict.

    Parameters
    ----------
    machine : DrivenSensors
    """
    gains = static_gains(machine)
    size = np.max(np.abs(gains), axis=1, initial=0.0)
    moved = size > 0
    left, values, _ = np.linalg.svd(gains / np.where(moved, size, 1.0)[:, None])
    kept = left[:, : len(values)][:, values > RANK_TOLERANCE * np.max(values, initial=0.0)]
    return np.asarray(moved & (np.sum(kept**2, axis=1) < 1 - RANK_TOLERANCE))
