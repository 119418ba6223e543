"""Hysteresis: what acts depends on where the drive came from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import play
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature

# The loop is made of plays of these parts of its width.
PLAY_PARTS = np.array([1 / 3, 2 / 3, 1.0])
# The widest loop, over the largest value of the drive.
MAX_RELATIVE_WIDTH = 1.5


class Hysteresis(Effect):
    """The drive goes through a Prandtl-Ishlinskii loop of `width`, the mean of three plays.

    With `share`, that part of it does and the rest acts as it is.
    """

    name: ClassVar[str] = "hysteresis"
    side: ClassVar[Side] = "drive"
    bends: ClassVar[bool] = True
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "an actuator follows a rising command otherwise than a falling one: a piezo, a magnetic "
        "valve, a mechanical regulator"
    )
    action: ClassVar[str] = (
        "look at the actuator of {channel}: rising and falling commands give different "
        "results over {width}; come to each level from the same side, or close a loop around "
        "it"
    )
    signature: ClassVar[str] = (
        "every output of the drive is too small on the way up and too large on the way down, "
        "with rounded corners, at any speed"
    )
    source: ClassVar[str] = "Brokate & Sprekels 1996 (play operators); Gao 2000 (piezo actuator)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "width": Parameter("{channel}", low=0.0),
        "share": Parameter("1", linear=True),
    }

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        loop = play(u, self.parameters["width"] * PLAY_PARTS, memory).mean(axis=0)
        return u + self.parameters.get("share", 1.0) * (loop - u)

    def plausible(self, scene: Scene) -> bool:
        # A loop lags; one wider than all that the drive goes through never closes.
        share, width = self.parameters.get("share", 1.0), self.parameters["width"]
        return share > 0 and width <= MAX_RELATIVE_WIDTH * scene.level(self.channel)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for drive, level in scene.levels().items():
            if is_temperature(drive):
                continue  # measured, not commanded
            for part in (0.05, 0.1, 0.2, 0.4, 0.7, 1.0, MAX_RELATIVE_WIDTH):
                yield cls(drive, {"width": part * level, "share": 1.0})
