"""Sensor gain: a scale factor is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class SensorGain(Effect):
    """The reading, relative to rest, is `gain` times the truth."""

    name: ClassVar[str] = "sensor_gain"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "a scale factor is wrong: amplifier range, step size, calibration sheet of another probe"
    )
    action: ClassVar[str] = (
        "compare {channel} with a reference at two values: it reads {gain} times what it "
        "should; look at amplifier range, step size and calibration sheet"
    )
    signature: ClassVar[str] = "the residual is the simulated output itself, in one channel alone"
    source: ClassVar[str] = "JCGM 106; the step size in a header of the gantry logs"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {"gain": Parameter("1", neutral=1.0, linear=True)}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return y * self.parameters["gain"]

    def undone(self, values: Float) -> Float:
        gain = self.parameters["gain"]
        return values / gain if gain else values * np.nan

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for output in scene.outputs:
                yield cls(output, {"gain": 2.0}, log)
