"""Transport delay: the drive acts later than it is logged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.units import hold_of


class TransportDelay(Effect):
    """u(t − delay) acts in place of u(t), switching between samples where the delay says so.

    Below zero, by a sample at most: a mean that is stamped at the end of its sample, or a command
    that was switched before the row in which it is first seen.
    """

    name: ClassVar[str] = "transport_delay"
    side: ClassVar[Side] = "drive"
    explanation: ClassVar[str] = (
        "the drive acts later than it is logged: a pipe, a belt, a controller's cycle, two clocks"
    )
    action: ClassVar[str] = (
        "look at clocks and at the way from {channel} to the machine (pipe, belt, "
        "controller): it acts {delay} later than at the calibration; mend that, or log "
        "what arrives"
    )
    signature: ClassVar[str] = "the residual follows minus the slope of every output of the drive"
    source: ClassVar[str] = "Ljung 1999, 7.2 (dead time)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"delay": Parameter("s")}

    @property
    def dead_time(self) -> float:
        return self.parameters["delay"]

    def plausible(self, scene: Scene) -> bool:
        # Nothing acts before it is commanded, but a held command may be logged a sample late.
        held = hold_of(self.channel) == "zero"
        return self.parameters["delay"] >= (-scene.period if held else 0.0)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        longest = max(2 * scene.period, scene.duration / 20)
        for drive in scene.drives:
            for delay in np.geomspace(scene.period / 2, longest, 8).tolist():
                yield cls(drive, {"delay": delay})
            if hold_of(drive) == "zero":
                yield cls(drive, {"delay": -scene.period})
