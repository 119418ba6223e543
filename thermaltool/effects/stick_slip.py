"""Stick-slip: a slide follows the expansion only when its play or friction is overcome."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import play
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class StickSlip(Effect):
    """A displacement follows through a play of `width`, from flank to flank.

    An elastic slide with dry friction does the same as a nut with play: what it lags behind is at
    most half the width, on either side.
    """

    name: ClassVar[str] = "stick_slip"
    side: ClassVar[Side] = "structure"
    bends: ClassVar[bool] = True
    defect: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a slide, a nut or a clamp sticks, and follows the expansion only beyond its play"
    )
    action: ClassVar[str] = (
        "look for play or friction of the slide, nut or clamp behind {channel}, {width} of it: "
        "clean, grease or take up the play, or always come from the same side"
    )
    signature: ClassVar[str] = (
        "one displacement stands still after every reversal of its motion, and is then late by the "
        "same amount, while the temperatures are right"
    )
    source: ClassVar[str] = "Armstrong-Hélouvry 1991, ch. 2 (stiction); Tao & Kokotović 1996, ch. 2"
    causal: ClassVar[bool] = True
    known: ClassVar = {"width": Parameter("{channel}", low=0.0)}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        return play(y, np.array([self.parameters["width"]]), memory)[0]

    def plausible(self, scene: Scene) -> bool:
        # A play wider than all the motion is never taken up.
        return super().plausible(scene) and self.parameters["width"] < scene.reach(self.channel)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for output in scene.displacements():
            if reach := scene.reach(output):
                for share in (0.03, 0.1, 0.3):
                    yield cls(output, {"width": share * reach})
