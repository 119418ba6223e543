"""Self-heating sensor: its own current warms it after it is switched on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import elapsed, time_constants
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# It has warmed up within this share of a log: slower, it is a drift.
MAX_SHARE_OF_LOG = 0.2


class SensorSelfHeating(Effect):
    """A reading approaches `rise` with a time constant from the first row on."""

    name: ClassVar[str] = "sensor_self_heating"
    side: ClassVar[Side] = "sensor"
    defect: ClassVar[bool] = True
    at_start: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "one sensor is warmed by its own current after it is switched on: a thermistor with a high "
        "current, an amplifier in the probe"
    )
    action: ClassVar[str] = (
        "switch the sensor of {channel} on earlier, or lower its current: it warms itself by "
        "{rise} after it is switched on"
    )
    signature: ClassVar[str] = (
        "one channel alone rises from the first row on and settles, whatever the machine does"
    )
    source: ClassVar[str] = "IEC 60751, 6.5 (self-heating of a resistance thermometer)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rise": Parameter("{channel}", linear=True),
        "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
    }

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        since = elapsed(record.time, memory) / self.parameters["time_constant"]
        return y - self.parameters["rise"] * np.expm1(-since)

    def plausible(self, scene: Scene) -> bool:
        return (
            super().plausible(scene)
            and self.parameters["rise"] > 0
            and self.parameters["time_constant"] < MAX_SHARE_OF_LOG * scene.duration
        )

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for sensor in scene.sensors():
            for tau in time_constants(2 * scene.period, MAX_SHARE_OF_LOG * scene.duration, 4):
                yield cls(sensor, {"rise": 1.0, "time_constant": tau})
