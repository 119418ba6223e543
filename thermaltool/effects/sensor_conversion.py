"""Sensor conversion: the curve from signal to reading is that of another sensor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class SensorConversion(Effect):
    """The reading, relative to rest, is gain·y + curvature·y².

    That is the difference of two smooth conversion curves that agree at rest, to second order. A
    curve that was matched in slope too needs no gain.
    """

    name: ClassVar[str] = "sensor_conversion"
    side: ClassVar[Side] = "sensor"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a signal is converted by the wrong curve: another thermistor's constants, another type "
        "of thermocouple, a straight line for a bent characteristic; or the material conducts "
        "heat otherwise when it is hot"
    )
    action: ClassVar[str] = (
        "check how {channel} is converted (constants of the thermistor, type of "
        "thermocouple, characteristic): compare it with a reference at three values over its "
        "range; where it is right, the material there conducts heat otherwise when it is hot"
    )
    signature: ClassVar[str] = (
        "the residual of one output is a bent function of the output itself, alike at every time "
        "and rate"
    )
    source: ClassVar[str] = "Steinhart & Hart 1968 (thermistors); IEC 60584-1 (thermocouples)"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {
        "gain": Parameter("1", neutral=1.0, linear=True),
        "curvature": Parameter("1/{channel}", linear=True),
    }

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return y * self.parameters.get("gain", 1.0) + self.parameters["curvature"] * y**2

    def undone(self, values: Float) -> Float:
        """On the branch through rest; beyond its turning point no truth gives the reading."""
        gain, curvature = self.parameters.get("gain", 1.0), self.parameters["curvature"]
        inside = gain**2 + 4 * curvature * values
        root = np.sqrt(np.where(inside >= 0, inside, np.nan))
        below = gain + np.copysign(root, gain)
        return 2 * values / np.where(below == 0, np.nan, below)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for output in scene.sensors():
                yield cls(output, {"curvature": 1.0}, log)
                yield cls(output, {"gain": 2.0, "curvature": 1.0}, log)
