"""A spindle whose channels are sums of exponentials with shared time constants, in numpy alone.

Time constants as Zhu, Ni, Shih 2008 report them of a measured spindle: 363.6, 61.7 and 27.0 min.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SPINDLE_TAUS = 60.0 * np.array([363.6, 61.7, 27.0])
# Steady state of each mode at full speed [K]: weights of both signs, as mode shapes have them.
SPINDLE_GAINS = {
    "T_front_degC": np.array([9.0, 5.0, 3.0]),
    "T_middle_degC": np.array([8.0, 2.5, -1.5]),
    "T_rear_degC": np.array([7.0, -2.0, 1.0]),
}


@dataclass(frozen=True)
class SharedModes:
    """Channels T = T0 + Σ g_j x_j with τ_j x_j' + x_j = u, u held from switch to switch."""

    taus: np.ndarray
    gains: dict[str, np.ndarray]

    def readings(
        self, time: np.ndarray, duty: list[tuple[float, float]], noise: float,
        rng: np.random.Generator,
    ) -> dict[str, np.ndarray]:  # fmt: skip
        """Rows on a clock [s] for a drive that is (duration [s], level) by (duration, level)."""
        drive, modes = np.zeros(len(time)), np.zeros((len(self.taus), len(time)))
        begin, state = 0.0, np.zeros(len(self.taus))
        for duration, level in duty:
            here = (time >= begin) & (time < begin + duration)
            decay = np.exp(-(time[here] - begin) / self.taus[:, None])
            modes[:, here] = level + (state - level)[:, None] * decay
            drive[here] = level
            state = level + (state - level) * np.exp(-duration / self.taus)
            begin += duration
        return {
            name: 20.0 + gains @ modes + noise * rng.standard_normal(len(time))
            for name, gains in self.gains.items()
        } | {"duty_spindle_1": drive}
