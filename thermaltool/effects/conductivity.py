"""Conductivity: what the machine is made of conducts heat otherwise when it is hot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side, reference_of
from thermaltool.effects.heat_capacity import MAX_PER_KELVIN
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature, kelvins


class Conductivity(Effect):
    """Every output y, from rest, is y + curvature·y², each with a curvature of its own.

    Where k = k0 (1 + βT), θ = T + βT²/2 obeys the linear equation of conduction (Kirchhoff), and
    T is θ − βθ²/2 to second order. The surfaces lose heat by T, not by θ, so that the share of β
    that shows differs from place to place, even in sign.
    """

    name: ClassVar[str] = "conductivity"
    side: ClassVar[Side] = "structure"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "the material conducts heat otherwise when it is hot, so that temperatures are no longer "
        "in proportion to the heat, each by as much as it is warm"
    )
    action: ClassVar[str] = (
        "look up the conductivity of the material at {channel} up to the temperatures of use "
        "({fitted}); calibrate over the whole range"
    )
    signature: ClassVar[str] = (
        "several outputs depart from proportion, each as a bent function of itself, alike at "
        "every time and rate"
    )
    source: ClassVar[str] = "Carslaw & Jaeger 1959, §1.6 (Kirchhoff's transformation)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"curvature": Parameter("1/{output}", linear=True)}

    def odds_alone(self, output: str | None) -> float:
        return 0.0

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        y = outputs[name]
        curvature = self.parameters.get(f"curvature[{name}]", 0.0)
        return y + curvature * y**2 if curvature else y

    def plausible(self, scene: Scene) -> bool:
        # Kirchhoff's curvature is half of what k changes by.
        most = MAX_PER_KELVIN / 2 * scene.reach(self.channel) * kelvins(self.channel)
        named = ((reference_of(name)[1], value) for name, value in self.parameters.items())
        return all(abs(value) * scene.reach(o) <= most for o, value in named if o is not None)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        temperatures = [o for o in scene.sensors() if is_temperature(o)]
        if len(scene.outputs) < 2 or not temperatures:
            return
        hottest = max(temperatures, key=scene.reach)
        yield cls(hottest, {f"curvature[{o}]": 1e-4 for o in scene.outputs})
