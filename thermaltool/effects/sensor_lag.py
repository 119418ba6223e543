"""Sensor lag: the reading follows the truth late."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.dynamics import lagged, time_constants
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# On clean logs of simulated machines the error of a response's shape had up to this much evidence
# as a lag (development seeds; no other cause had any): odds of e^-12.
ODDS_BESIDE_SHAPE_ERROR = 6e-6
# A heavy probe in still air takes a quarter of an hour; what is slower is the machine [s].
SLOWEST_SENSOR = 900.0


class SensorLag(Effect):
    """The reading approaches the truth with a time constant; both agree at the first row."""

    name: ClassVar[str] = "sensor_lag"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "one sensor answers late: a poorly seated thermometer, a heavy housing, a filter in the "
        "amplifier"
    )
    action: ClassVar[str] = (
        "look at how {channel} is seated: it follows with a time constant of "
        "{time_constant}; better contact, a lighter housing or a shorter filter"
    )
    signature: ClassVar[str] = "the residual of one output is minus its own slope, smoothed"
    source: ClassVar[str] = "Doebelin, Measurement Systems, ch. 3 (first-order instrument)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"time_constant": Parameter("s", low=0.0, high=SLOWEST_SENSOR, log=True)}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        tau = self.parameters["time_constant"]
        return lagged(record.time, y, tau, "first", float(y[0]), memory) if tau > 0 else y

    def plausible(self, scene: Scene) -> bool:
        # A sensor slower than what it measures is a part of the machine.
        slowest = scene.slowest.get(self.channel, SLOWEST_SENSOR)
        return super().plausible(scene) and self.parameters["time_constant"] < slowest

    @property
    def odds(self) -> float:
        """What a kind of response leaves out of its shape looks like a lag of its sensor."""
        return ODDS_BESIDE_SHAPE_ERROR * super().odds

    @property
    def lag(self) -> float:
        return self.parameters["time_constant"]

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for output in scene.outputs:
            for tau in time_constants(scene.period / 2, min(scene.duration, SLOWEST_SENSOR), 8):
                yield cls(output, {"time_constant": tau})
