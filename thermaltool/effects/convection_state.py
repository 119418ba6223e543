"""Convection that changes with a state: coolant, speed, fan, heating against cooling down."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import (
    Effect,
    Float,
    Memory,
    Outputs,
    Parameter,
    Scene,
    Side,
    needed,
)
from thermaltool.record import Record


class ConvectionState(Effect):
    """Heat is lost faster by `rate` in proportion to a channel (over its largest value).

    A uniform rise of the film coefficient raises the rate of every thermal mode alike. The
    channel is a state of the log, or a drive: then it is the drive's absence that counts.
    """

    name: ClassVar[str] = "convection_state"
    side: ClassVar[Side] = "state"
    explanation: ClassVar[str] = (
        "the machine loses heat at another rate in some state: coolant on, spindle turning, fan, "
        "or the drive off (cooling down differs from warming up)"
    )
    action: ClassVar[str] = (
        "look at what changes the cooling with {channel} (coolant, fan, an open door, "
        "standstill): the rate of heat loss changes by {rate}; keep it the same in all runs, "
        "or leave the column in the log"
    )
    signature: ClassVar[str] = (
        "all outputs decay at another rate while the state lasts, in proportion to their level"
    )
    source: ClassVar[str] = "Mize 1998 (coolant on or off); Zhu, Ni & Shih 2008 (cool-down)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rate": Parameter("1/s", low=-0.1, high=0.1),
        "level": Parameter("{channel}", fixed=True),
        "idle": Parameter("1", fixed=True),
    }

    def needs(self) -> tuple[str, ...]:
        return (self.channel,)

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        share = np.abs(np.nan_to_num(needed(record, self.channel))) / self.parameters["level"]
        if self.parameters["idle"]:
            share = (share < 0.02).astype(float)
        return self.parameters["rate"] * np.minimum(share, 1.0)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        # Both signs, and small against the slowest rate: the fit goes on from there.
        slowest = max(scene.slowest.values())
        for channel in (*scene.extra, *scene.drives):
            values = np.concatenate([log.columns[channel] for log in scene.logs])
            level = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
            if not level or np.ptp(values[np.isfinite(values)]) < 0.5 * level:
                continue
            fixed = {"level": level, "idle": float(channel in scene.drives)}
            for rate in (-0.3 / slowest, 0.3 / slowest, 1.0 / slowest):
                yield cls(channel, {"rate": rate, **fixed})
