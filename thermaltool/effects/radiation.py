"""Radiation: heat is lost faster than in proportion when the machine is hot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from thermaltool.effects.channels import ROOM_DEGC, is_air, is_part, rest_of
from thermaltool.effects.dynamics import from_rest, is_plausible_rate
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import ABSOLUTE_ZERO, is_absolute, is_temperature, kelvins, parse_channel

# 0 degC [K].
KELVIN = -ABSOLUTE_ZERO


class Radiation(Effect):
    """The radiative part of the loss rises from `rate` at rest with the temperature T.

    Between T and surroundings at the temperature of rest T0, the heat radiated is
    h·(T − T0) with h ∝ (T² + T0²)(T + T0). The model's own loss holds h at rest; what is added is
    rate·[(T² + T0²)(T + T0)/(4 T0³) − 1] in kelvin.

    T is an output (from `rest`) or, without `rest`, a channel of the log.

    Or the drive heats the place that radiates, `partner`, read at T: what acts is the drive less
    ``loss``·[(T⁴ − T0⁴)/(4 T0³) − (T − T0)], and all else stays as it is.
    """

    name: ClassVar[str] = "radiation"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a hot machine radiates: it loses heat faster than in proportion to its temperature"
    )
    signature: ClassVar[str] = (
        "every output falls short at the highest level and decays fast from there, and is right "
        "at low ones"
    )
    source: ClassVar[str] = "Incropera & DeWitt, ch. 1 (radiation heat transfer coefficient)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rate": Parameter("1/s", low=0.0),
        "loss": Parameter("{channel}/K", low=0.0, linear=True),
        "rest": Parameter("degC", low=ABSOLUTE_ZERO, fixed=True),
    }

    @property
    def side(self) -> Side:  # type: ignore[override]
        """Heat that leaves where a drive heats is as much less of the drive."""
        return "state" if self.partner is None else "drive"

    @property
    def action(self) -> str:  # type: ignore[override]
        """What a technician can do, with places for names."""
        place = "{channel}" if self.partner is None else "{partner}, where {channel} heats"
        return (
            f"look at the hot surfaces at {place}: the hotter they are, the more heat they "
            "radiate; shield them, and calibrate up to the temperatures of use"
        )

    def needs(self) -> tuple[str, ...]:
        if self.partner is not None:
            return (self.partner,)
        return () if "rest" in self.parameters else (self.channel,)

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        if self.partner is None:
            return u
        cold, rise = _read(record, self.partner, {} if memory is None else memory)
        hot = np.maximum(cold + rise, 0.0)
        return u - self.parameters["loss"] * ((hot**4 - cold**4) / (4 * cold**3) - rise)

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.partner is not None:
            return None
        cold, rise = self._temperature(record, outputs, {} if memory is None else memory)
        return self.parameters["rate"] * radiative_excess(cold - KELVIN, rise)

    def plausible(self, scene: Scene) -> bool:
        if not super().plausible(scene):
            return False
        return self.partner is not None or is_plausible_rate(self.parameters["rate"], scene)

    def _temperature(
        self, record: Record, outputs: Outputs, memory: dict[str, Any]
    ) -> tuple[float, Float]:
        """Temperature at rest [K], and the rise above it."""
        rest = self.parameters.get("rest")
        if rest is None:
            return _read(record, self.channel, memory)
        if self.channel not in outputs:
            raise ModelError(f"{self.name}: needs the output {self.channel}, which is not there")
        return rest + KELVIN, outputs[self.channel] * kelvins(self.channel)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        slowest = max(scene.slowest.values())
        if place := _hottest(scene):
            channel, fixed = place
            for share in (0.1, 0.3, 1.0):
                yield cls(channel, {"rate": share / slowest, **fixed})
        for drive in scene.drives:
            for hot in scene.sensors() if not is_temperature(drive) else ():
                if is_absolute(hot) and all(hot in log.columns for log in scene.logs):
                    yield cls(drive, {"loss": 1.0}, partner=hot)


def radiative_excess(rest: float, rise: Float) -> Float:
    """By how much more is radiated for each kelvin than at rest, shape of `rise` [1].

    Parameters
    ----------
    rest : float [degC]
        Of the surface and of what is around it.
    rise : ndarray, any shape [K]
    """
    cold = rest + KELVIN
    hot = np.maximum(cold + rise, 0.0)
    return np.asarray((hot**2 + cold**2) * (hot + cold) / (4 * cold**3) - 1)


def _read(record: Record, channel: str, memory: dict[str, Any]) -> tuple[float, Float]:
    """First reading of a temperature [K], and the rise above it."""
    rise = from_rest(record, channel, memory)
    first, _ = memory.get("reading", (ROOM_DEGC, ROOM_DEGC))
    return first + KELVIN, rise


def _hottest(scene: Scene) -> tuple[str, dict[str, float]] | None:
    """The temperature that says how hot the machine is, and its rest where that is known."""

    def of(channels: tuple[str, ...], dimension: str) -> list[str]:
        return [c for c in channels if parse_channel(c).dimension == dimension]

    if absolute := of(scene.outputs, "temperature"):
        channel = max(absolute, key=scene.reach)
        return channel, {"rest": rest_of(scene, channel)}
    logged = of(scene.extra, "temperature")
    if machine := [c for c in logged if not is_air(c) and not is_part(c)]:
        return max(machine, key=lambda c: _span(scene, c)), {}
    if pairs := of(scene.outputs, "temperature difference"):
        return max(pairs, key=scene.reach), {"rest": ROOM_DEGC}
    return None


def _span(scene: Scene, channel: str) -> float:
    return max(float(np.nanmax(v) - np.nanmin(v)) for v in (g.columns[channel] for g in scene.logs))
