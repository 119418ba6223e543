"""Heat capacity, or diffusivity: what the machine is made of is another material when it is hot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import is_temperature, kelvins

# No solid far from a transition changes by more of itself for each kelvin [1/K].
MAX_PER_KELVIN = 0.005
# The machine never stores less than this share of what it stores at rest.
LEAST = 0.1


class HeatCapacity(Effect):
    """Heat capacity over conductivity is larger by `rise` where the output is at `level`.

    In proportion between: 1 + rise·y/level, y from rest. With c·x' = A x + B u everything goes by
    that factor slower, and no steady state moves.
    """

    name: ClassVar[str] = "heat_capacity"
    side: ClassVar[Side] = "state"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "heat capacity or conductivity change with temperature: a hot machine answers slower (or "
        "faster) than a cold one"
    )
    action: ClassVar[str] = (
        "look up heat capacity and conductivity of the material at {channel} up to the "
        "temperatures of use: time constants change with temperature ({fitted}); calibrate over "
        "the whole range"
    )
    signature: ClassVar[str] = (
        "time constants at high levels differ from those at low ones, steady states are right"
    )
    source: ClassVar[str] = "Incropera & DeWitt, ch. 2 (temperature-dependent properties)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rise": Parameter("1", low=-0.6, high=2.0),
        "level": Parameter("{channel}", fixed=True),
    }

    def pace(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.channel not in outputs:
            raise ModelError(f"{self.name}: needs the output {self.channel}, which is not there")
        share = outputs[self.channel] / self.parameters["level"]
        return 1.0 / np.maximum(1.0 + self.parameters["rise"] * share, LEAST)

    def plausible(self, scene: Scene) -> bool:
        low, high = self.ends(self.parameters["level"] * kelvins(self.channel))
        return low <= self.parameters["rise"] <= high

    @classmethod
    def ends(cls, level: float) -> tuple[float, float]:
        """Least and largest plausible rise.

        Parameters
        ----------
        level : float [K]
        """
        most = MAX_PER_KELVIN * level
        return max(cls.known["rise"].low, -most), min(cls.known["rise"].high, most)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        temperatures = [o for o in scene.sensors() if is_temperature(o)]
        if not temperatures:
            return
        hottest = max(temperatures, key=scene.reach)
        if level := scene.reach(hottest):
            for rise in (-0.1, 0.1):
                yield cls(hottest, {"rise": rise, "level": level})
