"""Drive gain: all that is commanded acts by another factor than at the calibration."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class DriveGain(Effect):
    """What acts is `gain` times the drive."""

    name: ClassVar[str] = "drive_gain"
    side: ClassVar[Side] = "drive"
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "the drive has another scale than at the calibration: one phase of a heater is dead, the "
        "supply sags, a setting or a unit was changed"
    )
    action: ClassVar[str] = (
        "measure what {channel} really gives (current, power, speed): it acts {gain} times as "
        "much as at the calibration; mend or reset it, or calibrate again"
    )
    action_measured: ClassVar[str] = (
        "look at the sensor of {channel}, its seat and its scale: the machine follows it {gain} "
        "times as much as at the calibration; mend it, or calibrate again"
    )
    signature: ClassVar[str] = (
        "every output of the drive is too large or too small by one and the same factor"
    )
    source: ClassVar[str] = "Isermann 2006, ch. 18 (faults of actuators: multiplicative)"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {"gain": Parameter("1", neutral=1.0, low=0.0, high=10.0, linear=True)}

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        return u * self.parameters["gain"]

    def undone(self, values: Float) -> Float:
        gain = self.parameters["gain"]
        return values / gain if gain else values * np.nan

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for drive in scene.levels():
                yield cls(drive, {"gain": 2.0}, log)
