"""Transport delay: the drive acts later than it is logged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Scene, Side
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
    causal: ClassVar[bool] = True
    known: ClassVar = {"delay": Parameter("s", low=0.0)}

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        # Of a held drive, the straight line between samples is the exact mean over a sample.
        time, delay = record.time, self.parameters["delay"]
        if memory is None:
            return np.interp(time - delay, time, u, left=0.0)
        known = np.append(memory.get("time", []), time)
        acted = np.append(memory.get("drive", []), u)
        first = max(int(np.searchsorted(known, known[-1] - delay, side="right")) - 1, 0)
        memory.update(time=known[first:], drive=acted[first:])
        return np.interp(time - delay, known, acted, left=0.0)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        longest = max(2 * scene.period, scene.duration / 20)
        for drive in scene.drives:
            for delay in np.geomspace(scene.period / 2, longest, 8).tolist():
                yield cls(drive, {"delay": delay})
