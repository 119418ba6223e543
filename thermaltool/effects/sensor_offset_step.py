"""Sensor offset step: a reading jumps and stays."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.dynamics import jump_times
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.instant import Instant
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_displacement


class SensorOffsetStep(Instant):
    """`step` is added to one reading from `time` on."""

    name: ClassVar[str] = "sensor_offset_step"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "one sensor's zero jumped: a connector, a slipped probe, a range switch"
    )
    action: ClassVar[str] = (
        "look at plug and mount of {channel}: its zero jumped by {step}, {time} into the "
        "log; set the zero again"
    )
    signature: ClassVar[str] = "one channel jumps between two samples and stays; no other does"
    source: ClassVar[str] = "Basseville & Nikiforov 1993, ch. 2 (additive change)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"step": Parameter("{channel}", linear=True), "time": Parameter("s")}

    @property
    def odds(self) -> float:
        # A displacement that jumps is more often the machine's doing than its probe's.
        return super().odds * (0.5 if is_displacement(self.channel) else 1.0)

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return y + self.parameters["step"] * (record.time >= self.parameters["time"])

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for k, log in enumerate(scene.logs):
            for output in scene.outputs:
                for instant in jump_times(scene, k, [output]):
                    yield cls(output, {"step": 1.0, "time": instant}, log.digest)
