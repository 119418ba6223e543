"""Part temperature: the workpiece grows and nobody allowed for it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from thermaltool.effects.channels import is_part
from thermaltool.effects.dynamics import from_rest
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.effects.scene import Scene
from thermaltool.record import Record


class PartTemperature(Effect):
    """Displacements rise by `coefficient` per kelvin of the workpiece, at once."""

    name: ClassVar[str] = "part_temperature"
    side: ClassVar[Side] = "source"
    explanation: ClassVar[str] = (
        "the workpiece is warmer or colder than the model takes it to be and expands by itself"
    )
    action: ClassVar[str] = (
        "measure the workpiece before it is clamped: {channel} moves {output} by "
        "{coefficient}; let it come to the machine's temperature, or leave the column in the "
        "log"
    )
    signature: ClassVar[str] = (
        "displacements follow the part's temperature without a lag; the machine's own "
        "temperatures do not"
    )
    source: ClassVar[str] = "Mize 1998 (part between 23 and 27 °C, not compensated)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"coefficient": Parameter("{output}/K", linear=True)}

    def needs(self) -> tuple[str, ...]:
        return (self.channel,)

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        coefficient = self.parameters.get(f"coefficient[{name}]")
        if coefficient is None:
            return outputs[name]
        return outputs[name] + coefficient * from_rest(record, self.channel, memory)

    def paths(self, output: str) -> tuple[tuple[float, float], ...]:
        coefficient = self.parameters.get(f"coefficient[{output}]")
        return () if coefficient is None else ((coefficient, 0.0),)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        coefficients = {f"coefficient[{output}]": 1.0 for output in scene.displacements()}
        if coefficients:
            for channel in filter(is_part, scene.extra):
                yield cls(channel, coefficients)
