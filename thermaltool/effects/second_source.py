"""A second heat source: a channel of the log that the model does not know, or a latent one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from thermaltool.effects.channels import source_channels
from thermaltool.effects.dynamics import SLOWEST, time_constants, warmed
from thermaltool.effects.effect import (
    Effect,
    Float,
    Parameter,
    Scene,
    Side,
    Signals,
    reference_of,
)
from thermaltool.units import parse_channel


class SecondSource(Effect):
    """A channel beside the drives warms the machine through a first-order lag.

    A latent source has no channel: it is switched on at `start` in one log, and every output
    approaches `gain` (then in its own unit) with the time constant.
    """

    name: ClassVar[str] = "second_source"
    side: ClassVar[Side] = "source"
    explanation: ClassVar[str] = (
        "heat enters from somewhere that the model does not know: bearing friction beside the "
        "motor, a bed, a hot end, a pump"
    )
    signature: ClassVar[str] = (
        "the residual follows another channel of the log through a lag, or starts to rise in "
        "several outputs at one instant and settles"
    )
    source: ClassVar[str] = "Zhu, Ni & Shih 2008 (bearing beside motor); Fraser 1997, ch. 7"
    known: ClassVar = {
        "gain": Parameter("{output}/{channel}", linear=True),
        "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "start": Parameter("s", low=0.0),
    }

    @property
    def everywhere(self) -> bool:
        return not self.channel

    def needs(self) -> tuple[str, ...]:
        return (self.channel,) if self.channel else ()

    def unit(self, name: str) -> str:
        base, output = reference_of(name)
        if base == "gain" and output and not self.channel:
            return parse_channel(output).unit
        return super().unit(name)

    def output(self, name: str, outputs: Mapping[str, Float], signals: Signals) -> Float:
        gain = self.parameters.get(f"gain[{name}]")
        if gain is None:
            return outputs[name]
        tau = self.parameters["time_constant"]
        if self.channel:
            return outputs[name] + gain * warmed(signals, self.channel, tau)
        since = np.maximum(signals.time - self.parameters["start"], 0.0)
        return outputs[name] - gain * np.expm1(-since / tau)

    def path(self, output: str) -> tuple[float, float] | None:
        gain = self.parameters.get(f"gain[{output}]")
        if gain is None or not self.channel:
            return None
        return gain, self.parameters["time_constant"]

    def plausible(self, scene: Scene) -> bool:
        if self.channel:
            slow = self.parameters["time_constant"] > SLOWEST * scene.duration
            return super().plausible(scene) and not slow
        # Slower than what is seen of it, or larger than all that is known, it is a trend.
        reached = all(
            abs(gain) < scene.reach(output)
            for name, gain in self.parameters.items()
            if (output := reference_of(name)[1]) is not None
        )
        seen = max(log.time[-1] for log in scene.logs if log.log == self.log)
        return reached and self.parameters["time_constant"] < seen - self.parameters["start"]

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        gains = {f"gain[{output}]": 1.0 for output in scene.outputs}
        for channel in source_channels(scene):
            for tau in time_constants(scene.period, scene.duration):
                yield cls(channel, {**gains, "time_constant": tau})
        for log in scene.logs:
            # Below some ten samples a rise is a step, which is another cause.
            for tau in time_constants(10 * log.period, log.duration, 4):
                for start in scene.instants(log, 15):
                    yield cls("", {**gains, "time_constant": tau, "start": start}, log.log)
