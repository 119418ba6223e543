"""Ambient drift: the air around the machine changes and the structure follows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.channels import air_is_logged, is_air, unknown_channels
from thermaltool.effects.dynamics import elapsed
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, reference_of
from thermaltool.effects.scene import Scene
from thermaltool.effects.source import HeatSource
from thermaltool.record import Record
from thermaltool.units import is_temperature

# Temperature of the structure for one of the air at most, with what a sensor may be off by; a
# displacement for one, over what it is for one of the hottest sensor as the drives can warm it; and
# a swing over what a log shows of it.
MAX_AIR_GAIN, MAX_AIR_GROWTH, MAX_SWING = 1.2, 10.0, 1.5


class AmbientDrift(HeatSource):
    """Outputs follow the air through one lag or two; one slow swing where nobody logged it.

    The swing has one course for all outputs, since there is one air, and a size for each. It is
    zero at the first row, as a machine at rest is.
    """

    name: ClassVar[str] = "ambient_drift"
    explanation: ClassVar[str] = (
        "the air around the machine warms or cools, and frame, column and sensors follow it"
    )
    action: ClassVar[str] = (
        "look at the air at {channel}: it moves {output} by {gain}; keep draughts and sun "
        "off the machine, or leave the column in every log so that the model follows it"
    )
    action_unlogged: ClassVar[str] = (
        "log the temperature of the air beside the machine (a column T_ambient_degC): "
        "something like it moves {output} by up to {moves}; keep draughts and sun off the "
        "machine"
    )
    signature: ClassVar[str] = (
        "absolute temperatures and deflections follow the air through a lag, or swing slowly "
        "together where it is not logged; differences of temperature hardly move"
    )
    source: ClassVar[str] = "ISO 230-3 (environmental temperature variation); Bryan 1990"
    known: ClassVar = {
        "gain": Parameter("{output}/{channel}", linear=True),
        "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "slow_gain": Parameter("{output}/{channel}", linear=True),
        "slow_time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "swing": Parameter("{output}", linear=True),
        "period": Parameter("s", low=0.0, high=1e6, log=True),
        "phase": Parameter("rad"),
    }

    def unlogged(self, name: str, record: Record, memory: Memory = None) -> Float | float:
        swing = self.parameters.get(f"swing[{name}]")
        if swing is None:
            return 0.0
        phase = self.parameters["phase"]
        since = elapsed(record.time, memory) / self.parameters["period"]
        return swing * (np.sin(2 * np.pi * since + phase) - np.sin(phase))

    def plausible(self, scene: Scene) -> bool:
        for name, value in self.parameters.items():
            base, output = reference_of(name)
            if not output:
                continue
            if base == "gain" and self.reached(output, value) > self._largest(output, scene):
                return False
            if base == "swing" and not self._seen(value, output, scene):
                return False
        return super().plausible(scene)

    def _largest(self, output: str, scene: Scene) -> float:
        """Largest gain of an output to the air."""
        if is_temperature(output):
            # Nothing warms more than the air that warms it.
            return MAX_AIR_GAIN
        hottest = max((scene.spans[o] for o in scene.spans if is_temperature(o)), default=0.0)
        return MAX_AIR_GROWTH * scene.spans[output] / hottest if hottest > 0 else np.inf

    def _seen(self, swing: float, output: str, scene: Scene) -> bool:
        """Whether a log shows a swing, not the beginning of it, and no more than the machine."""
        change = max(
            float(np.ptp(np.asarray(self.unlogged(output, log))))
            for log in scene.logs
            if self.log in (None, log.digest)
        )
        return abs(swing) < MAX_SWING * change and change < 2 * scene.reach(output)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        yield from cls.logged(scene, [c for c in unknown_channels(scene) if is_air(c)])
        # One slow swing in a single output would be a sensor's.
        if air_is_logged(scene) or len(scene.outputs) < 2:
            return
        swings = {f"swing[{output}]": 1.0 for output in scene.outputs}
        for log in scene.logs:
            for periods in (1.0, 2.0, 4.0):
                for phase in (np.pi / 6 * np.arange(6)).tolist():
                    shape = {"period": periods * log.duration, "phase": phase}
                    yield cls("", {**swings, **shape}, log.digest)
