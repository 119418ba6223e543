"""Thermal transients as the sum of exponentials that they are, in numpy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Foster:
    """Cells R ‖ C in a row, by their time constants [s] and resistances [K/W]."""

    taus: np.ndarray
    resistances: np.ndarray

    def rise(self, time: np.ndarray, steps: dict[float, float], before: float = 0.0) -> np.ndarray:
        """Temperature above ambient [K] for a power that steps to levels [W] at times [s].

        All had settled at `before`. Superposition, step by step.
        """
        found, level = np.full(len(time), before * self.resistances.sum()), before
        for at, power in steps.items():
            since = np.maximum(time - at, 0.0)[:, None]
            found += (power - level) * (-np.expm1(-since / self.taus) @ self.resistances)
            level = power
        return found

    def up_to(self, tau: float) -> float:
        """Resistance of all time constants up to one [K/W]."""
        return float(self.resistances[self.taus <= tau].sum())


def power_of(time: np.ndarray, steps: dict[float, float], before: float = 0.0) -> np.ndarray:
    """The held power on a clock [W]."""
    levels = np.array([before, *steps.values()])
    return levels[np.searchsorted(np.array(list(steps)), time, side="right")]


# Eight cells over eight decades, and six over three: neighbours by a factor of 12, and of 4.
EIGHT_DECADES = Foster(
    np.geomspace(1e-4, 3e3, 8), np.array([0.08, 0.12, 0.2, 0.1, 0.25, 0.3, 0.15, 0.4])
)
THREE_DECADES = Foster(np.geomspace(1e-2, 10.0, 6), np.array([0.1, 0.2, 0.15, 0.3, 0.25, 0.4]))


def logarithmic_clock(plant: Foster, per_decade: int) -> np.ndarray:
    """Rows before a step at zero, the step, and rows on a logarithmic clock behind it [s]."""
    short, long = plant.taus[0] / 10, plant.taus[-1] * 4
    count = int(per_decade * np.log10(long / short))
    behind = np.geomspace(short, long, count)
    return np.concatenate([np.linspace(-long / 10, 0.0, 12), behind])


def noisy(rng: np.random.Generator, curve: np.ndarray, part: float = 1e-3) -> np.ndarray:
    """A curve with white noise, a part of its range."""
    return curve + part * np.ptp(curve) * rng.standard_normal(len(curve))
