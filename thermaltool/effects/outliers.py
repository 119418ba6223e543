"""Outliers: single readings that have nothing to do with the machine."""

from __future__ import annotations

from typing import ClassVar

from thermaltool.effects.effect import Effect, Parameter, Side


class Outliers(Effect):
    """No physics: a `share` of the readings is off by about `amplitude`.

    They are found one by one against their neighbours and left out, not simulated.
    """

    name: ClassVar[str] = "outliers"
    side: ClassVar[Side] = "sensor"
    event: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "single readings are wrong: a spark, a lost bit, a loose contact, a chip on the probe"
    )
    action: ClassVar[str] = (
        "look at plug, cable, shield and probe of {channel}: {share_percent} of its readings "
        "are off by about {amplitude}"
    )
    signature: ClassVar[str] = "isolated readings far from those before and after, in one channel"
    source: ClassVar[str] = "Rousseeuw & Leroy 1987, ch. 1"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "share": Parameter("1", low=0.0, high=1.0, fixed=True),
        "amplitude": Parameter("{channel}", low=0.0, fixed=True),
    }
