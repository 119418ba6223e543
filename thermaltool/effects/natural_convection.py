"""Natural convection: still air takes more heat for each kelvin the hotter the machine is."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, Side
from thermaltool.errors import ModelError
from thermaltool.record import Record

# Of laminar flow along a surface (Nu proportional to Ra to this power), by a film coefficient.
EXPONENT = 0.25


class NaturalConvection(Effect):
    """The part of the loss that is by still air goes with the fourth root of the output.

    It is `rate` where the output is `level` from rest, which the model's own loss holds. What is
    added is rate·[(|y|/level)^(1/4) − 1], never above zero below the level.
    """

    name: ClassVar[str] = "natural_convection"
    side: ClassVar[Side] = "state"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "still air rises along a hot machine: near rest it takes less heat for each kelvin"
    )
    source: ClassVar[str] = "Incropera & DeWitt, ch. 9 (free convection, laminar)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rate": Parameter("1/s", low=0.0),
        "level": Parameter("{channel}", fixed=True),
    }

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.channel not in outputs:
            raise ModelError(f"{self.name}: needs the output {self.channel}, which is not there")
        share = np.abs(outputs[self.channel]) / self.parameters["level"]
        return self.parameters["rate"] * (share**EXPONENT - 1)
