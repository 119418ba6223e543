"""Heat from beside the drives: what the causes have in common whose source may be logged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import ClassVar

import numpy as np

from thermaltool.effects.channels import MAX_TEMPERATURE_GAIN
from thermaltool.effects.dynamics import MAX_LAG_RECORDS, time_constants, warmed
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Side, reference_of
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import is_temperature, source_rest

# Time constants of which pairs are tried; how many times the other, and a sample period, the slower
# of two is at least.
TWO_LAGS, MIN_LAG_RATIO, MIN_SLOW = 5, 2.0, 10.0
# A channel that moves by less than this share of its size stands still about its level.
HARDLY_MOVES = 0.1
# Readings whose median is the level at which a log begins.
FIRST_READINGS = 5


class HeatSource(Effect, ABC):
    """A channel beside the drives moves outputs by `gain` in the end, through a first-order lag.

    Or through two, as a machine with two modes moves: `slow_gain` of it through the slower.
    A source that nobody logged has no channel; what it does is the subclass's.
    """

    side: ClassVar[Side] = "source"
    causal: ClassVar[bool] = True

    def odds_alone(self, output: str | None) -> float:
        return 1.0 if self.channel else 0.0

    def needs(self) -> tuple[str, ...]:
        return (self.channel,) if self.channel else ()

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        if not self.channel:
            return outputs[name] + self.unlogged(name, record, memory)
        found = outputs[name]
        for gain, tau in self.paths(name):
            # Each lag keeps its own last sample.
            own = None if memory is None else memory.setdefault(f"after {tau} s", {})
            found = found + gain * warmed(record, self.channel, tau, own, self.rest)
        return found

    @property
    def rest(self) -> float | None:
        """Value of the channel at which nothing is added, where it is not the usual one."""
        return self.parameters.get("rest")

    def begins_at_rest(self, scene: Scene) -> bool:
        return self.rest is not None and _moved(scene, self.channel) > HARDLY_MOVES

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

    def paths(self, output: str) -> tuple[tuple[float, float], ...]:
        gain = self.parameters.get(f"gain[{output}]")
        if gain is None or not self.channel:
            return ()
        tau, slow = self.parameters["time_constant"], self.parameters.get("slow_time_constant")
        if slow is None:
            return ((gain, tau),)
        late = self.parameters[f"slow_gain[{output}]"]
        return (gain - late, tau), (late, slow)

    def reached(self, output: str | None, gain: float) -> float:
        """Size of what an output follows: in the end, or by the faster lag before that.

        Parameters
        ----------
        output : str
        gain : float
        """
        return max(abs(gain), abs(gain - self.parameters.get(f"slow_gain[{output}]", 0.0)))

    def plausible(self, scene: Scene) -> bool:
        if self.channel and is_temperature(self.channel):
            for name, value in self.parameters.items():
                base, output = reference_of(name)
                # Nothing warms more than what warms it; the logged sensor may be on its far side.
                warms = base == "gain" and output is not None and is_temperature(output)
                if warms and self.reached(output, value) > MAX_TEMPERATURE_GAIN:
                    return False
        if not self.channel:
            return super().plausible(scene)
        fast = self.parameters["time_constant"]
        slow = self.parameters.get("slow_time_constant", fast)
        # What is felt only long after the record would be a trend; of two lags that are nearly one,
        # or too fast to be read, the weights run away.
        late = slow > MAX_LAG_RECORDS * scene.duration
        least = max(MIN_LAG_RATIO * fast, MIN_SLOW * scene.period)
        one = "slow_time_constant" in self.parameters and slow < least
        return super().plausible(scene) and not late and not one

    @classmethod
    def logged(cls, scene: Scene, channels: Sequence[str]) -> Iterator[Effect]:
        """Every one of `channels` that moves, with every lag that is worth a trial.

        One that stands still is the state in which a log begins, at most.

        Parameters
        ----------
        scene : Scene
        channels : sequence of str
        """
        for channel in (c for c in channels if _moved(scene, c)):
            without = scene.unanswered.get(channel, scene.outputs)
            gains = {f"gain[{output}]": 1.0 for output in without}
            late = {f"slow_gain[{output}]": 1.0 for output in without}
            pairs = list(combinations(time_constants(scene.period, scene.duration, TWO_LAGS), 2))
            for rest in _rests(scene, channel):
                for tau in time_constants(scene.period, scene.duration):
                    yield cls(channel, {**gains, "time_constant": tau, **rest})
                for tau, slow in pairs:
                    two = {"time_constant": tau, "slow_time_constant": slow}
                    yield cls(channel, {**gains, **late, **two, **rest})


def _moved(scene: Scene, channel: str) -> float:
    """How far a channel moves within a log, over its largest value, at most."""
    found = 0.0
    for log in scene.logs:
        values = log.columns[channel][np.isfinite(log.columns[channel])]
        if len(values) and np.ptp(values):
            found = max(found, float(np.ptp(values) / np.max(np.abs(values))))
    return found


def _rests(scene: Scene, channel: str) -> list[dict[str, float]]:
    """Where a channel may rest: as usual, or at the level that it has as the logs begin.

    A machine through which coolant flows is at rest with the coolant. What hardly moves about its
    level would, from 0, be a start of every log.
    """
    if source_rest(channel) == "first":
        return [{}]
    own = (log.columns[channel][np.isfinite(log.columns[channel])] for log in scene.logs)
    begun = np.array([float(np.median(values[:FIRST_READINGS])) for values in own if len(values)])
    alike = len(begun) and np.ptp(begun) <= HARDLY_MOVES * np.min(np.abs(begun))
    if not alike or not begun[0]:
        return [{}]
    usual: list[dict[str, float]] = [{}] if _moved(scene, channel) > HARDLY_MOVES else []
    return [*usual, {"rest": float(begun[0])}]
