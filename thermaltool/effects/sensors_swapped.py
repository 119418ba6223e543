"""Swapped sensors: each of two readings stands in the other's column."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import ClassVar

from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.units import parse_channel


class SensorsSwapped(Effect):
    """`channel` and `partner` have changed places; both count from their own rest."""

    name: ClassVar[str] = "sensors_swapped"
    side: ClassVar[Side] = "wiring"
    explanation: ClassVar[str] = "two plugs or two columns have changed places"
    action: ClassVar[str] = (
        "look at plugs and columns of {channel} and {partner}: each reads what the other "
        "should; change them back"
    )
    signature: ClassVar[str] = "each of two outputs reads what the other one should"
    source: ClassVar[str] = "field practice (like plugs side by side)"
    causal: ClassVar[bool] = True
    known: ClassVar[Mapping[str, Parameter]] = {}

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        if name not in (self.channel, self.partner):
            return outputs[name]
        other = self.partner if name == self.channel else self.channel
        if other is None or other not in outputs:
            raise ModelError(f"{self.name}: {name} needs the other sensor, {other}")
        return outputs[other]

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        for log in scene.within_one():
            for a, b in combinations(scene.outputs, 2):
                if parse_channel(a).unit == parse_channel(b).unit:
                    yield cls(a, {}, log, partner=b)
