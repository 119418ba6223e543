"""Joint contact: a joint passes on more or less of a displacement, by its level and sign."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Scene, Side
from thermaltool.record import Record

# A displacement that goes less far the other way shows nothing of the other sign.
MIN_RELATIVE_REVERSE = 0.1


class JointContact(Effect):
    """A displacement y becomes y + curvature·y|y| + asymmetry·|y|.

    Curvature: contact closes or opens with load, so that large displacements are not in
    proportion. Asymmetry: slopes 1 + asymmetry above rest and 1 − asymmetry below it, since a
    joint carries pressure but no tension.
    """

    name: ClassVar[str] = "joint_contact"
    side: ClassVar[Side] = "structure"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a joint closes or opens as the parts expand, and passes on heat and displacement "
        "otherwise than at rest"
    )
    action: ClassVar[str] = (
        "look at the joints in the way of {channel} (bolts, bearings, wedges; {fitted}): "
        "clean, tighten or preload them so that they stay as they are when the parts warm"
    )
    signature: ClassVar[str] = (
        "a displacement departs from proportion to the drive by its level and sign, while the "
        "temperatures stay in proportion"
    )
    source: ClassVar[str] = "Fraser 1997, ch. 7 (joints of a nonlinear structure)"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {
        "curvature": Parameter("1/{channel}", linear=True),
        # At -1 or 1 one side would stand still.
        "asymmetry": Parameter("1", low=-0.95, high=0.95, linear=True),
    }

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        size = np.abs(y)
        curvature = self.parameters.get("curvature", 0.0)
        return y + curvature * y * size + self.parameters.get("asymmetry", 0.0) * size

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for output in scene.displacements():
            yield cls(output, {"curvature": 1.0})
            lowest = min(float(np.min(each[output])) for each in scene.simulated)
            highest = max(float(np.max(each[output])) for each in scene.simulated)
            # Of one sign alone, asymmetry would be another gain.
            if min(-lowest, highest) > MIN_RELATIVE_REVERSE * max(-lowest, highest):
                yield cls(output, {"asymmetry": 0.5})
                yield cls(output, {"curvature": 1.0, "asymmetry": 0.5})
