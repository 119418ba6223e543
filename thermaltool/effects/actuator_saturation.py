"""Actuator saturation: more is commanded than the actuator can give."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature


class ActuatorSaturation(Effect):
    """The drive acts up to `limit`, both ways; `level` is the largest that was commanded."""

    name: ClassVar[str] = "actuator_saturation"
    side: ClassVar[Side] = "drive"
    bends: ClassVar[bool] = True
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "the actuator gives all it has: a heater at full power, an amplifier at its rail"
    )
    action: ClassVar[str] = (
        "see what really comes at {channel}: nothing more acts above {limit}; command no "
        "more than that, or fit a stronger actuator"
    )
    signature: ClassVar[str] = (
        "above one level of the drive nothing more follows; below it everything is right"
    )
    source: ClassVar[str] = "Fraser 1997 (heater control: a step of 1.5 saturates)"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {
        "limit": Parameter("{channel}", low=0.0, log=True),
        "level": Parameter("{channel}", fixed=True),
    }

    def parameter(self, name: str) -> Parameter:
        """What is known of a parameter, its unit and bounds.

        Parameters
        ----------
        name : str
        """
        known = super().parameter(name)
        if name != "limit":
            return known
        # At the largest level, a limit is none.
        return replace(known, neutral=self.parameters["level"], high=self.parameters["level"])

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        return np.clip(u, -self.parameters["limit"], self.parameters["limit"])

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for drive, level in scene.levels().items():
            if is_temperature(drive):
                continue  # measured, not commanded
            for share in (0.2, 0.35, 0.5, 0.6, 0.7, 0.8, 0.9, 0.96):
                yield cls(drive, {"limit": share * level, "level": level})
