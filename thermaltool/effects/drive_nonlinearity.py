"""Static nonlinearity of the drive: power law, dead band, or parabola."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature

# A law agrees with the straight line of a calibration at no more than so many times the largest
# level, and, but for a parabola, at no less than this part of it.
MOST_BEYOND, LEAST_LEVEL = 3.0, 0.1
TINY = 1e-12


class DriveNonlinearity(Effect):
    """What acts is sign(u)·|u|^exponent beyond a dead band, scaled to agree at the largest level.

    Or u·(1 + curvature·|u|/level), which agrees near zero. With `agrees_at` they agree there, the
    parabola as u·(1 + curvature·(|u| − agrees_at)/level): the straight line of a calibration may
    meet the law anywhere. Heat by a voltage or a current goes with its square, friction with a
    power of the speed, the torque of a motor has a share of both.
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
        "agrees_at": Parameter("{channel}", low=TINY, log=True, place=True),
    }

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        at = self.parameters.get("agrees_at")
        if "curvature" in self.parameters:
            bend = self.parameters["curvature"] / self.parameters["level"]
            return u + bend * u * (np.abs(u) - (at or 0.0))
        law = self._law(u)
        return law if at is None else law * at / max(self._law_at(at), TINY)

    def undone(self, values: Float) -> Float:
        """Of a dead band, inside which nothing acts, the middle; of a parabola, its near side."""
        level, at = self.parameters["level"], self.parameters.get("agrees_at")
        if "curvature" in self.parameters:
            bend = self.parameters["curvature"] / level
            first = 1 - bend * (at or 0.0)
            rise = first + np.sqrt(np.maximum(first**2 + 4 * bend * np.abs(values), 0.0))
            return np.divide(2 * values, rise, out=np.zeros_like(values, float), where=rise > 0)
        if at is not None:
            values = values * self._law_at(at) / at
        beyond = self.parameters.get("dead_band", 0.0)
        size = (np.abs(values) / level) ** (1 / self.parameters.get("exponent", 1.0))
        return np.sign(values) * (beyond + (level - beyond) * size)

    def finer(self) -> Self | None:
        """The law scaled to agree with the straight line at another level, which is searched."""
        if "agrees_at" in self.parameters:
            return None
        # Near where the plain form does.
        share = LEAST_LEVEL if "curvature" in self.parameters else 1.0
        agrees = {"agrees_at": share * self.parameters["level"]}
        return replace(self, parameters={**self.parameters, **agrees}, covariance=None)

    def plausible(self, scene: Scene) -> bool:
        at, level = self.parameters.get("agrees_at"), self.parameters["level"]
        if at is None:
            return super().plausible(scene)
        if at > MOST_BEYOND * level:
            return False
        if "curvature" in self.parameters:
            # Less of what acts for more of the drive is none of these laws; scaled to agree above
            # zero a curvature may be below the least of one that agrees there.
            bend = self.parameters["curvature"] / level
            return min(1 - bend * at, 1 + bend * (2 * level - at)) > 0
        return at > LEAST_LEVEL * level and self._law_at(at) > 0 and super().plausible(scene)

    def _law_at(self, level: float) -> float:
        """What the unscaled law makes of a level."""
        return float(self._law(np.array([level]))[0])

    def _law(self, u: Float) -> Float:
        level = self.parameters["level"]
        beyond = self.parameters.get("dead_band", 0.0)
        exponent = self.parameters.get("exponent", 1.0)
        size = np.maximum(np.abs(u) - beyond, 0.0) / max(level - beyond, TINY * level)
        return np.sign(u) * level * size**exponent

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for drive, level in scene.levels().items():
            # The middle one of all is a typical law: it stands for the others where none is seen.
            yield cls(drive, {"curvature": 0.1, "level": level})
            yield cls(drive, {"curvature": 0.1, "level": level, "agrees_at": level})
            # A measured temperature knows no dead band and no power: it is no command.
            if not is_temperature(drive):
                for exponent in (0.5, 0.7, 0.9, 1.1, 1.5, 2.0, 3.0):
                    yield cls(drive, {"exponent": exponent, "level": level})
                for share in (0.02, 0.05, 0.1, 0.2, 0.4):
                    yield cls(drive, {"dead_band": share * level, "level": level})
