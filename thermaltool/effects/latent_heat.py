"""Latent heat: something melts, boils or gives up its water at one temperature."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.channels import rest_of
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import ABSOLUTE_ZERO, is_absolute

# Temperatures that are tried, and latent heat and width, as shares of the range that is gone
# through.
PLACES, HEAT, WIDTH = (0.2, 0.4, 0.6, 0.8), 0.2, 0.05


class LatentHeat(Effect):
    """Around the temperature `at` the machine stores as much as `heat` degrees more do elsewhere.

    The apparent heat capacity there is 1 + heat/(2 width)·sech²((T − at)/width) times as large, on
    the way up and on the way down. T is an output, from `rest`.
    """

    name: ClassVar[str] = "latent_heat"
    side: ClassVar[Side] = "state"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "something melts, freezes or dries at one temperature, which stays there until it is done"
    )
    action: ClassVar[str] = (
        "look for what melts or dries in the machine near {at} at {channel} (wax, solder, "
        "grease, moisture in the insulation): it holds as much heat as {heat} of warming up"
    )
    signature: ClassVar[str] = (
        "all outputs rest for a while whenever one temperature is passed, upwards and downwards"
    )
    source: ClassVar[str] = "Bonacina et al. 1973 (apparent heat capacity)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "heat": Parameter("K", low=0.0),
        "at": Parameter("degC", low=-100.0, high=2000.0, place=True),
        "width": Parameter("K", neutral=1.0, low=0.05, high=50.0, log=True, place=True),
        "rest": Parameter("degC", low=ABSOLUTE_ZERO, fixed=True),
    }

    def pace(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.channel not in outputs:
            raise ModelError(f"{self.name}: needs the output {self.channel}, which is not there")
        heat, at, width = (self.parameters[name] for name in ("heat", "at", "width"))
        away = (self.parameters["rest"] + outputs[self.channel] - at) / width
        more = heat / (2 * width) / np.cosh(np.minimum(np.abs(away), 300.0)) ** 2
        return 1.0 / (1.0 + more)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        absolute = [o for o in scene.sensors() if is_absolute(o)]
        if not absolute:
            return
        hottest = max(absolute, key=scene.reach)
        ends = [f(each[hottest]) for each in scene.simulated for f in (np.min, np.max)]
        low, span, rest = float(min(ends)), float(np.ptp(ends)), rest_of(scene, hottest)
        for share in PLACES if span else ():
            yield cls(
                hottest,
                {"heat": HEAT * span, "at": rest + low + share * span, "width": WIDTH * span,
                 "rest": rest},
            )  # fmt: skip
