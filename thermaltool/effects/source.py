"""Heat from beside the drives: what the causes have in common whose source may be logged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar

from thermaltool.effects.channels import MAX_TEMPERATURE_GAIN
from thermaltool.effects.dynamics import MAX_LAG_RECORDS, time_constants, warmed
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Scene, Side, reference_of
from thermaltool.record import Record
from thermaltool.units import is_temperature


class HeatSource(Effect, ABC):
    """A channel beside the drives moves outputs by `gain` through a first-order lag.

    A source that nobody logged has no channel; what it does is the subclass's.
    """

    side: ClassVar[Side] = "source"
    causal: ClassVar[bool] = True

    @property
    def everywhere(self) -> bool:
        return not self.channel

    def needs(self) -> tuple[str, ...]:
        return (self.channel,) if self.channel else ()

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        if not self.channel:
            return outputs[name] + self.unlogged(name, record, memory)
        if (followed := self.path(name)) is None:
            return outputs[name]
        gain, tau = followed
        return outputs[name] + gain * warmed(record, self.channel, tau, memory)

    @abstractmethod
    def unlogged(self, name: str, record: Record, memory: Memory = None) -> Float | float:
        """What a source without a channel adds to an output.

        Parameters
        ----------
        name : str
        record : Record
        memory : dict, optional
            As in `drive`.
        """

    def path(self, output: str) -> tuple[float, float] | None:
        gain = self.parameters.get(f"gain[{output}]")
        if gain is None or not self.channel:
            return None
        return gain, self.parameters["time_constant"]

    def plausible(self, scene: Scene) -> bool:
        if self.channel and is_temperature(self.channel):
            for name, value in self.parameters.items():
                base, output = reference_of(name)
                # Nothing warms more than what warms it; the logged sensor may be on its far side.
                warms = base == "gain" and output is not None and is_temperature(output)
                if warms and abs(value) > MAX_TEMPERATURE_GAIN:
                    return False
        # What is felt only long after the record would be a trend.
        slow = self.channel and self.parameters["time_constant"] > MAX_LAG_RECORDS * scene.duration
        return super().plausible(scene) and not slow

    @classmethod
    def logged(cls, scene: Scene, channels: Sequence[str]) -> Iterator[Effect]:
        """Every one of `channels` with every lag that is worth a trial.

        Parameters
        ----------
        scene : Scene
        channels : sequence of str
        """
        for channel in channels:
            without = scene.unanswered.get(channel, scene.outputs)
            gains = {f"gain[{output}]": 1.0 for output in without}
            for tau in time_constants(scene.period, scene.duration):
                yield cls(channel, {**gains, "time_constant": tau})
