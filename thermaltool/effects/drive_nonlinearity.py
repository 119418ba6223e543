"""Static nonlinearity of the drive: power law, dead band, or parabola."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature


class DriveNonlinearity(Effect):
    """What acts is sign(u)·|u|^exponent beyond a dead band, scaled to agree at the largest level.

    Or u·(1 + curvature·|u|/level). Heat by a voltage or a current goes with its square, friction
    with a power of the speed, the torque of a motor has a share of both.
    """

    name: ClassVar[str] = "drive_nonlinearity"
    side: ClassVar[Side] = "drive"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "heat is not proportional to what is logged: power goes with voltage squared, friction "
        "with a power of the speed, a regulator has a dead band"
    )
    action: ClassVar[str] = (
        "measure what really acts at three levels of {channel}: it is no straight line of it "
        "({fitted}); log what acts instead (power, not voltage or speed), or keep the cause in "
        "the model"
    )
    signature: ClassVar[str] = (
        "every output of the drive is too large at some levels of it and too small at others, "
        "with the same dynamics"
    )
    source: ClassVar[str] = "Mareš et al. (voltage regulator); DaISy heating system (lamp power)"
    memoryless: ClassVar[bool] = True
    known: ClassVar = {
        # Near 0 it matters only whether the drive is on.
        "exponent": Parameter("1", neutral=1.0, low=0.01, high=5.0, log=True),
        "dead_band": Parameter("{channel}", low=0.0),
        # Below, more of the drive would be less of what acts.
        "curvature": Parameter("1", low=-0.45, high=5.0, linear=True),
        "level": Parameter("{channel}", fixed=True),
    }

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        level = self.parameters["level"]
        if "curvature" in self.parameters:
            return u + self.parameters["curvature"] * u * np.abs(u) / level
        beyond = self.parameters.get("dead_band", 0.0)
        exponent = self.parameters.get("exponent", 1.0)
        size = np.maximum(np.abs(u) - beyond, 0.0) / max(level - beyond, 1e-12 * level)
        return np.sign(u) * level * size**exponent

    def undone(self, values: Float) -> Float:
        """Of a dead band, inside which nothing acts, the middle; of a parabola, its near side."""
        level = self.parameters["level"]
        curvature = self.parameters.get("curvature", 0.0)
        if curvature:
            root = np.sqrt(np.maximum(1 + 4 * curvature * np.abs(values) / level, 0.0))
            return 2 * values / (1 + root)
        beyond = self.parameters.get("dead_band", 0.0)
        size = (np.abs(values) / level) ** (1 / self.parameters.get("exponent", 1.0))
        return np.sign(values) * (beyond + (level - beyond) * size)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for drive, level in scene.levels().items():
            # A measured temperature knows no dead band and no power: it is no command.
            if not is_temperature(drive):
                for exponent in (0.5, 0.7, 0.9, 1.1, 1.5, 2.0, 3.0):
                    yield cls(drive, {"exponent": exponent, "level": level})
                for share in (0.02, 0.05, 0.1, 0.2, 0.4):
                    yield cls(drive, {"dead_band": share * level, "level": level})
            yield cls(drive, {"curvature": 0.1, "level": level})
