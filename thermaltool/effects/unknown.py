"""Unknown: something that no cause of the catalogue explains."""

from __future__ import annotations

from typing import ClassVar

from thermaltool.effects.effect import Effect, Parameter, Side


class Unknown(Effect):
    """No physics, and no part of a model: where, when, and how large it is.

    It is what is left once every cause of the catalogue has been tried; see
    `thermaltool.diagnosis.verdict`.
    """

    name: ClassVar[str] = "unknown"
    side: ClassVar[Side] = "structure"
    explanation: ClassVar[str] = "no cause of the catalogue explains what is left"
    action: ClassVar[str] = (
        "look at the machine where {output} is off, from {start} to {stop} into the "
        "log{condition}: log whatever else changes then in a column of its own, and diagnose "
        "again"
    )
    signature: ClassVar[str] = "a residual that is larger than noise and calibration allow"
    source: ClassVar[str] = "Kennedy & O'Hagan 2001"
    causal: ClassVar[bool] = True
    known: ClassVar = {"rms": Parameter("{channel}", low=0.0, fixed=True)}
