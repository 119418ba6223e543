"""Sensor drift: a reading creeps away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.dynamics import HOUR, elapsed
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Scene, Side
from thermaltool.record import Record


class SensorDrift(Effect):
    """`rate` times the hours since the first row is added to one reading."""

    name: ClassVar[str] = "sensor_drift"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "one sensor's zero creeps: an ageing probe, a warming amplifier, a mount that yields"
    )
    action: ClassVar[str] = (
        "compare {channel} with a reference before and after a run: its zero creeps by "
        "{rate}; let the amplifier warm up first, look at the mount, or change the probe"
    )
    signature: ClassVar[str] = "a straight line in time in one channel, whatever the machine does"
    source: ClassVar[str] = "JCGM 200 (VIM), 4.21 (instrumental drift)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"rate": Parameter("{channel}/h", linear=True)}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return y + self.parameters["rate"] * elapsed(record.time, memory) / HOUR

    def plausible(self, scene: Scene) -> bool:
        # Beyond a fifth of what is measured it is no drift of a sensor in use.
        hours = scene.duration / HOUR
        return abs(self.parameters["rate"]) * hours < 0.2 * scene.reach(self.channel)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for output in scene.outputs:
                yield cls(output, {"rate": 1.0}, log)
