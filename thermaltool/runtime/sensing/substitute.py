"""Measured drives that say much the same: the others stand in for one that is lost."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.model.redundancy import Redundancy
from thermaltool.runtime.stepper import Stepper, Steps

# Half a 95 % interval in standard deviations.
INTERVAL = 2.0


class Substituting(Steps):
    """A stepper whose lost drives are what the others say.

    Parameters
    ----------
    stepper : Stepper
    columns : sequence of str
        Of the readings, in the order of the stepper.
    redundancy : Redundancy
    gains : mapping of output to mapping of drive to float
        Steady state of an output per unit of a drive.
    """

    def __init__(
        self,
        stepper: Stepper,
        columns: Sequence[str],
        redundancy: Redundancy,
        gains: Mapping[str, Mapping[str, float]],
    ) -> None:
        super().__init__()
        self._stepper, self._columns = stepper, tuple(columns)
        self._redundancy, self._gains = redundancy, gains
        self.settling_time = stepper.settling_time
        self._place = [redundancy.channels.index(c) if c in redundancy.channels else None
                       for c in columns]  # fmt: skip
        # Drives without a first reading: nothing says what they read at rest.
        self._absent: set[int] = set()
        self._weights: dict[frozenset[int], Any] = {}

    def can_do_without(self, lost: Collection[int]) -> bool:
        """Whether the others stand in for these drives."""
        out = {*lost, *self._absent}
        known = all(self._place[k] is not None for k in out)
        return known and len(out) <= self._redundancy.most_lost

    def cost(self, lost: Collection[int]) -> str:
        """How much less sure each output is without these drives."""
        out = sorted({*lost, *self._absent})
        places = [k for each in out if (k := self._place[each]) is not None]
        deviation = self._redundancy.expectation(places)[1]
        parts = []
        for output, gains in self._gains.items():
            each = [gains.get(self._columns[k], 0.0) for k in out]
            wider = INTERVAL * float(np.sum(np.abs(each) * deviation))
            parts.append(f"{output} by {wider:.3g}")
        without = ", ".join(self._columns[k] for k in out)
        return f"without {without}, which the others stand for, the band widens: {', '.join(parts)}"

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        return self._stepper.rest()

    def can_start(self, readings: list[float]) -> bool:
        """Whether the first readings suffice."""
        missing = [k for k, reading in enumerate(readings) if not math.isfinite(reading)]
        return self.can_do_without(missing)

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings, some of which may be NaN; see `Stepper.start`."""
        self._absent = {k for k, reading in enumerate(readings) if not math.isfinite(reading)}
        self.left_out = min(self._absent, default=None)
        return self._stepper.start(self._filled(readings), settled)

    def at_rest(self, readings: list[float]) -> list[float]:
        """None: every reading is of a drive."""
        return []

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Estimates after a sample; see `Stepper.step`."""
        return self._stepper.step(ticks, self._filled(readings))

    def _filled(self, readings: list[float]) -> list[float]:
        """Readings with those that are lost as the others have them."""
        out = frozenset({*self.out, *self._absent})
        if not out or not self.can_do_without(out):
            return readings
        if out not in self._weights:
            places = [self._place[k] for k in sorted(out)]
            self._weights = {out: self._redundancy.expectation(places)[0]}  # type: ignore[arg-type]
        given = np.zeros(len(self._redundancy.channels))
        for k, place in enumerate(self._place):
            if place is not None and k not in out:
                given[place] = readings[k]
        filled = list(readings)
        for k, value in zip(sorted(out), self._weights[out] @ given, strict=True):
            filled[k] = float(value)
        return filled

    def state(self) -> list[Any]:
        """For `resume`: the stepper's, and which drives had no first reading."""
        return [self._stepper.state(), sorted(self._absent)]

    def resume(self, values: list[Any]) -> None:
        """Raises ValueError where `values` are no state of these."""
        kept, absent = values
        if not all(k in range(len(self._columns)) for k in absent):
            raise ValueError("not a state of these drives")
        self._stepper.resume(kept)
        self._absent = set(absent)
        self.left_out = min(self._absent, default=None)
