"""Which sensor the others contradict for long: one that comes off slowly, or is bent by a fault."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

# What the others predict of a sensor may be off by this part of the range that the calibration
# has seen, and by so many standard deviations of its white noise.
CONTRADICTION, NOISE_MARGIN = 0.1, 6.0
# A contradiction of twice that counts after so long [s] and so many sample periods, one of three
# times after half of it.
PATIENCE, PATIENCE_PERIODS = 60.0, 30
# The sensor that is wrong bends what it helps to predict; it stands out by this factor.
STANDS_OUT = 1.5


@dataclass
class Vote:
    """A cumulated sum for each sensor of how far it is contradicted.

    Attributes
    ----------
    allowed : sequence of float [unit of the sensor]
        What residuals may be.
    patience : float [s]
    against : int or None
        The sensor that is voted out.
    """

    allowed: Sequence[float]
    patience: float = PATIENCE
    against: int | None = field(default=None, init=False)
    _sums: list[float] = field(default_factory=list, init=False)
    _fits: list[float] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self._sums = [0.0] * len(self.allowed)
        self._fits = [0.0] * len(self.allowed)

    def take(self, seconds: float, residuals: Sequence[float]) -> None:
        """Residuals after a sample of so many `seconds`; NaN where nothing is predicted."""
        sizes = [
            abs(r) / a if r == r else 0.0 for r, a in zip(residuals, self.allowed, strict=True)
        ]
        for k, size in enumerate(sizes):
            added = seconds * (min(size, 3.0) - 1.0)
            self._sums[k] = min(max(self._sums[k] + added, 0.0), 2 * self.patience)
        if self.against is not None:
            if self._sums[self.against] == 0.0:
                self.against = None
            return
        worst = max(range(len(sizes)), key=sizes.__getitem__)
        others = max((size for k, size in enumerate(sizes) if k != worst), default=math.inf)
        if self._sums[worst] >= self.patience and sizes[worst] >= STANDS_OUT * others:
            self.against = worst

    def clears(self, k: int, seconds: float, residual: float) -> bool:
        """Whether a sensor that is out reads for long what the others predict.

        Parameters
        ----------
        k : int
        seconds : float [s]
            Since the last sample.
        residual : float [unit of the sensor]
            Of what it reads now, used or not.
        """
        fits = abs(residual) <= self.allowed[k]
        self._fits[k] = self._fits[k] + seconds if fits else 0.0
        return self._fits[k] > self.patience

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self._sums, self.against]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state; raises TypeError or ValueError where it is none."""
        sums, against = values
        if len(sums) != len(self._sums) or against not in (None, *range(len(sums))):
            raise ValueError("not a state of this vote")
        self._sums, self.against = [float(each) for each in sums], against

    def forget(self) -> None:
        """Nothing is known."""
        self.__post_init__()
        self.against = None
