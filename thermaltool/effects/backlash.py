"""Backlash: a reversal has to take up play before anything follows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import play
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class Backlash(Effect):
    """The drive acts through a play of `width`, from flank to flank."""

    name: ClassVar[str] = "backlash"
    side: ClassVar[Side] = "drive"
    bends: ClassVar[bool] = True
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "play between command and actuator: a gear, a spindle nut, a valve stem"
    )
    action: ClassVar[str] = (
        "look for play between {channel} and what it moves (gear, nut, valve stem), {width} "
        "of it: take it up, or always come from the same side"
    )
    signature: ClassVar[str] = (
        "after every reversal of the drive the outputs stand still until the play is taken up"
    )
    source: ClassVar[str] = "Tao & Kokotović 1996, ch. 2 (backlash)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"width": Parameter("{channel}", low=0.0)}

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        return play(u, np.array([self.parameters["width"]]), memory)[0]

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for drive, level in scene.levels().items():
            for share in (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8):
                yield cls(drive, {"width": share * level})
