"""Sensor drift: a reading creeps away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import HOUR, elapsed
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# Instants of a log that are tried; share of it that is seen before and after one.
INSTANTS, MIN_SEEN = 10, 0.1


class SensorDrift(Effect):
    """`rate` times the hours since the first row, or since `start`, is added to one reading."""

    name: ClassVar[str] = "sensor_drift"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "one sensor's zero creeps: an ageing probe, a warming amplifier, a mount that yields"
    )
    signature: ClassVar[str] = (
        "a straight line in time in one channel, from the first row or an instant on, whatever the "
        "machine does"
    )
    source: ClassVar[str] = "JCGM 200 (VIM), 4.21 (instrumental drift)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rate": Parameter("{channel}/h", linear=True),
        "start": Parameter("s"),
    }

    @property
    def action(self) -> str:  # type: ignore[override]
        """What a technician can do, with places for names."""
        begins = ", from {start} into the log on" if "start" in self.parameters else ""
        return (
            "compare {channel} with a reference before and after a run: its zero creeps by "
            f"{{rate}}{begins}; let the amplifier warm up first, look at the mount, or change the "
            "probe"
        )

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        since = elapsed(record.time, memory)
        if "start" in self.parameters:
            since = np.maximum(record.time - self.parameters["start"], 0.0)
        return y + self.parameters["rate"] * since / HOUR

    def plausible(self, scene: Scene) -> bool:
        hours = scene.duration / HOUR
        if "start" in self.parameters:
            times = next((log.time for log in scene.logs if log.digest == self.log), None)
            if times is None:
                return False
            start, margin = self.parameters["start"], MIN_SEEN * (times[-1] - times[0])
            if not times[0] + margin < start < times[-1] - margin:
                return False
            hours = (times[-1] - start) / HOUR
        # Beyond a fifth of what is measured it is no drift of a sensor in use.
        return abs(self.parameters["rate"]) * hours < 0.2 * scene.reach(self.channel)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for output in scene.outputs:
                yield cls(output, {"rate": 1.0}, log)
        for each in scene.logs:
            for start in scene.instants(each, INSTANTS):
                for output in scene.outputs:
                    yield cls(output, {"rate": 1.0, "start": start}, each.digest)
