"""Simulated machines that write test logs. They share no code with the models they judge."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from thermaltool.plants.heated import HeatedPlant

# Name to module; the module's `build()` returns the plant. Imported on use.
PLANTS = {"frame": "thermaltool.plants.frame"}
# With two heaters; `build_heated`.
HEATED = {"quill": "thermaltool.plants.quill", "c-frame": "thermaltool.plants.c_frame"}


class Plant(Protocol):
    """What every simulated machine can do."""

    def simulate(
        self, heat: NDArray[np.float64], ambient: NDArray[np.float64], dt: float
    ) -> Mapping[str, NDArray[np.float64]]:
        """Output channels without noise for heat Q [1] and ambient [degC] held per sample."""
        ...


def build(name: str) -> Plant:
    """Assemble the plant called `name`, a key of `PLANTS`."""
    plant: Plant = importlib.import_module(PLANTS[name]).build()
    return plant


def build_heated(name: str) -> HeatedPlant:
    """Assemble the plant called `name`, a key of `HEATED`."""
    plant: HeatedPlant = importlib.import_module(HEATED[name]).build()
    return plant
