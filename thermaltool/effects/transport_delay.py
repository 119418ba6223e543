"""Transport delay: the drive acts later than it is logged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Parameter, Scene, Side
from thermaltool.record import Record


class TransportDelay(Effect):
    """u(t − delay) acts in place of u(t)."""

    name: ClassVar[str] = "transport_delay"
    side: ClassVar[Side] = "drive"
    explanation: ClassVar[str] = (
        "the drive acts later than it is logged: a pipe, a belt, a controller's cycle, two clocks"
    )
    signature: ClassVar[str] = "the residual follows minus the slope of every output of the drive"
    source: ClassVar[str] = "Ljung 1999, 7.2 (dead time)"
    known: ClassVar = {"delay": Parameter("s", low=0.0)}

    def drive(self, signals: Record, u: Float) -> Float:
        # Of a held drive, the straight line between samples is the exact mean over a sample.
        return np.interp(signals.time - self.parameters["delay"], signals.time, u, left=0.0)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        longest = max(2 * scene.period, scene.duration / 20)
        for drive in scene.drives:
            for delay in np.geomspace(scene.period / 2, longest, 8).tolist():
                yield cls(drive, {"delay": delay})
