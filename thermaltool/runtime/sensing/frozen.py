"""Readings that stand still although they should be noisy: a sensor that is frozen."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

# Chance that a good sensor repeats itself so often.
FALSE_ALARM = 1e-12
# So few repeated readings are never taken for a frozen sensor.
MIN_REPEATS = 30
# Readings from which it is known how often this sensor repeats itself.
MIN_READINGS = 100


@dataclass
class FrozenCheck:
    """Counts readings that are identical, against the noise and the steps of the sensor.

    Steps of q and white noise of σ repeat themselves with a probability of about q/(2 σ √π); what
    the stream itself has shown counts where it is more. A sensor whose steps hide its noise is
    never called frozen: nothing tells it from one that rests.

    Attributes
    ----------
    white : float [unit of the sensor]
        Standard deviation of its white noise; 0 where it is not known.
    """

    white: float = 0.0
    _step: float = field(default=math.inf, init=False)
    _pairs: int = field(default=0, init=False)
    _repeats: int = field(default=0, init=False)
    _run: int = field(default=0, init=False)

    def repeats(self) -> bool:
        """A reading as the one before; whether the sensor is frozen."""
        self._run += 1
        return self._run >= self._longest

    def moves(self, step: float) -> None:
        """A reading that differs from the one before by `step`."""
        self._pairs += 1 + self._run
        self._repeats += self._run
        self._run = 0
        self._step = min(self._step, abs(step))

    def state(self) -> list[float | None]:
        """For `resume`, as JSON."""
        step = self._step if math.isfinite(self._step) else None
        return [step, self._pairs, self._repeats, self._run]

    def resume(self, values: list[float | None]) -> None:
        """Go on from a state; raises TypeError or ValueError where it is none."""
        step, *counts = values
        self._step = math.inf if step is None else float(step)
        self._pairs, self._repeats, self._run = (int(count or 0) for count in counts)

    def forget(self) -> None:
        """What comes is another sensor's."""
        self._step, self._pairs, self._repeats, self._run = math.inf, 0, 0, 0

    @property
    def _longest(self) -> float:
        """Repeated readings that are too many."""
        if not self.white or self._pairs < MIN_READINGS:
            return math.inf
        by_noise = self._step / (2 * self.white * math.sqrt(math.pi))
        chance = max(by_noise, (self._repeats + 1) / (self._pairs + 2))
        if chance >= 0.5:
            return math.inf
        return max(MIN_REPEATS, math.log(FALSE_ALARM) / math.log(chance))
