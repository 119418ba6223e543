"""Step of the drive's gain: from one instant on the drive acts by another factor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.instant import Instant
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# Instants of a log that are tried; the search goes on from the best of them.
INSTANTS = 12


class DriveGainStep(Instant):
    """What acts is `gain` times the drive from `time` on, and the drive before."""

    name: ClassVar[str] = "drive_gain_step"
    side: ClassVar[Side] = "drive"
    explanation: ClassVar[str] = (
        "the drive lost or gained strength at an instant: a heating element burnt out, a fuse, a "
        "belt, a range that was switched"
    )
    action: ClassVar[str] = (
        "look at heating elements, fuses and settings of {channel}: from {time} into the log "
        "it acts {gain} times as much as before"
    )
    action_measured: ClassVar[str] = (
        "look at the sensor of {channel} and its seat: from {time} into the log the machine "
        "follows it {gain} times as much as before"
    )
    signature: ClassVar[str] = (
        "from one instant on every output of the drive goes to another level by one factor, with "
        "the same dynamics"
    )
    source: ClassVar[str] = "Isermann 2006, ch. 18 (faults of actuators: abrupt)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "gain": Parameter("1", neutral=1.0, low=0.0, high=10.0, linear=True),
        "time": Parameter("s"),
    }

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        return u * np.where(record.time >= self.parameters["time"], self.parameters["gain"], 1.0)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log, drives in zip(scene.logs, scene.acting_drives, strict=True):
            for drive in scene.levels():
                for instant in scene.instants(log, INSTANTS):
                    if np.any(drives[drive][log.time >= instant]):
                        yield cls(drive, {"gain": 2.0, "time": instant}, log.digest)
