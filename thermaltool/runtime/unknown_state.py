"""How much of the machine's state the estimate may not know."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from thermaltool.estimation.settling_time import REMAINDER
from thermaltool.model import NOT_AT_REST, UNTOLD_REST, away_from_rest

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Report
    from thermaltool.runtime.sensing.sensors import SensorChannel


def contradicts_rest(
    sensors: Sequence[SensorChannel],
    readings: Sequence[float],
    expected: Sequence[float],
    report: Report,
) -> bool:
    """Whether the first readings contradict a machine at rest, or no sensor can tell; each is told.

    Parameters
    ----------
    sensors : sequence of SensorChannel
    readings : sequence of float
        Relative to the rest of each.
    expected : sequence of float
        What those that tell of the machine, the first ones, read at rest.
    report : callable
        Gets (channel, message).
    """
    found = False
    for k, (sensor, reading) in enumerate(zip(sensors, readings, strict=True)):
        if not sensor.at_rest or (expected and sensor.surrounds):
            continue
        above = reading - (expected[k] if k < len(expected) else 0.0)
        if away_from_rest(above, sensor.calibrated):
            why = UNTOLD_REST if sensor.surrounds else NOT_AT_REST
            report(sensor.channel, f"{sensor.value:g} at the start {why}")
            found = True
    return found


def where_it_begins(sensors: Sequence[SensorChannel], settled: bool) -> str:
    """Where the machine is taken to be at the first readings.

    Parameters
    ----------
    sensors : sequence of SensorChannel
    settled : bool
        As the first readings leave it.
    """
    if settled:
        return "from the first readings, as settled"
    known = [each for each in sensors if each.at_rest and math.isfinite(each.rest)]
    if not known:
        return "from rest"
    rests = ", ".join(f"{each.channel} {each.rest:g}" for each in known)
    air = ", ".join(each.channel for each in known if each.surrounds)
    return f"from rest ({rests})" + (f", in equilibrium with {air}" if air else "")


class UnknownState:
    """The share of the state that the estimate may not know, as of a first-order lag.

    It grows while nothing is read and falls while readings come.

    Parameters
    ----------
    settling_time : float [s]
        Until `REMAINDER` of a wrong start is left.

    Attributes
    ----------
    unknown : float
        0 (all is known) to 1 (nothing is).
    """

    def __init__(self, settling_time: float) -> None:
        self.settling_time = settling_time
        self.unknown = 0.0

    @property
    def lasts(self) -> bool:
        """Whether the estimate is still on its way."""
        return self.unknown > REMAINDER

    @property
    def left(self) -> float:
        """How long readings have to come until it is there [s]; inf where it never is."""
        if math.isinf(self.settling_time):
            return math.inf if self.lasts else 0.0
        return self.settling_time * max(1 - math.log(self.unknown) / math.log(REMAINDER), 0.0)

    def blind(self, seconds: float) -> None:
        """Nothing was read for so long [s]."""
        if math.isinf(self.settling_time):
            # What never decays stays, however short the time in which it came.
            self.unknown = 1.0 if seconds > 0 else self.unknown
            return
        self.unknown = 1 - (1 - self.unknown) * self._kept(seconds)

    def reads(self, seconds: float) -> None:
        """Readings have come for so long [s]."""
        if self.unknown:
            self.unknown *= self._kept(seconds)

    def _kept(self, seconds: float) -> float:
        if not seconds:
            return 1.0
        return math.exp(math.log(REMAINDER) * seconds / max(self.settling_time, 1e-9))
