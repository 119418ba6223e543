"""A second heat source: a channel of the log that the model does not know, or a latent one."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import ClassVar

import numpy as np

from thermaltool.effects.channels import source_channels
from thermaltool.effects.dynamics import time_constants
from thermaltool.effects.effect import Effect, Float, Memory, Parameter, reference_of
from thermaltool.effects.scene import Scene
from thermaltool.effects.source import HeatSource
from thermaltool.record import Record
from thermaltool.units import is_temperature, parse_channel

# A source that nobody logged is switched on after this share of a log at the earliest, and of its
# own time constant: before, it is the state in which the machine was found.
MIN_START, MIN_LATER = 0.01, 0.3
# How much rarer one is that reaches one sensor alone for sure.
ODDS_AT_ONE_PLACE = 1 / 150
# Below so many samples a rise is a step, which is another cause.
RISING_SAMPLES = 10
# Instants of a log between which one is tried that was on for a while, with lags by the model's
# slowest.
WINDOWS, WINDOW_LAGS = 8, (0.3, 1.0)


class SecondSource(HeatSource):
    """A channel beside the drives warms the machine through one first-order lag or two.

    A latent source has no channel: it is switched on at `start` in one log, and every output
    approaches `gain` (then in its own unit) with the time constant; at `stop`, where there is one,
    it is switched off again.
    """

    name: ClassVar[str] = "second_source"
    explanation: ClassVar[str] = (
        "heat enters from somewhere that the model does not know: bearing friction beside the "
        "motor, a bed, a hot end, a pump"
    )
    action: ClassVar[str] = (
        "look at what warms with {channel}: it adds {gain} to {output}; insulate it, or "
        "leave the column in every log so that the model follows it"
    )
    signature: ClassVar[str] = (
        "the residual follows another channel of the log through a lag, or starts to rise in "
        "several outputs at one instant and settles"
    )
    source: ClassVar[str] = "Zhu, Ni & Shih 2008 (bearing beside motor); Fraser 1997, ch. 7"
    known: ClassVar = {
        "gain": Parameter("{output}/{channel}", linear=True),
        "time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "slow_gain": Parameter("{output}/{channel}", linear=True),
        "slow_time_constant": Parameter("s", low=0.0, high=1e6, log=True),
        "rest": Parameter("{channel}", fixed=True),
        "start": Parameter("s", low=0.0),
        "stop": Parameter("s", low=0.0),
    }

    def odds_alone(self, output: str | None) -> float:
        # What moves one reading is a sensor's, unless it comes as heat does, and stays.
        stays = not self.channel and "stop" not in self.parameters
        if stays and output is not None and is_temperature(output):
            return ODDS_AT_ONE_PLACE
        return super().odds_alone(output)

    @property
    def action_unlogged(self) -> str:  # type: ignore[override]
        """What to look for where nobody logged it: what was switched, and when."""
        return (
            f"look for what was switched {self._switched} (pump, light, bearing, another machine): "
            "it moves {output} by up to {moves}; log it in a column of its own{alone}"
        )

    @property
    def _switched(self) -> str:
        """What happened to a source that nobody logged, and when."""
        if "stop" in self.parameters:
            return "on {start} into the log and off at {stop}"
        cools = sum(np.sign(self._temperature_gains)) < 0
        return "off {start} into the log" if cools else "on {start} into the log"

    @property
    def _temperature_gains(self) -> list[float]:
        """By how much it moves each temperature in the end."""
        named = ((reference_of(name)[1], gain) for name, gain in self.parameters.items())
        return [gain for output, gain in named if output is not None and is_temperature(output)]

    def unit(self, name: str) -> str:
        """Unit of a parameter; a source that nobody logged has none of its own.

        Parameters
        ----------
        name : str
        """
        base, output = reference_of(name)
        if base == "gain" and output and not self.channel:
            return parse_channel(output).unit
        return super().unit(name)

    def unlogged(self, name: str, record: Record, memory: Memory = None) -> Float | float:
        gain = self.parameters.get(f"gain[{name}]", 0.0)
        tau = self.parameters["time_constant"]

        def on_from(instant: float) -> Float:
            return np.asarray(-np.expm1(-np.maximum(record.time - instant, 0.0) / tau))

        found = on_from(self.parameters["start"])
        if "stop" in self.parameters:
            found = found - on_from(self.parameters["stop"])
        return gain * found

    def plausible(self, scene: Scene) -> bool:
        if self.channel:
            return super().plausible(scene)
        # Slower than what is seen of it, or larger than all that is known, it is a trend.
        reached = all(
            abs(gain) < scene.reach(output)
            for name, gain in self.parameters.items()
            if (output := reference_of(name)[1]) is not None
        )
        seen = max(log.time[-1] for log in scene.logs if log.digest == self.log)
        # What begins with the log is the state in which it was found.
        began = max(log.time[0] for log in scene.logs if log.digest == self.log)
        tau = self.parameters["time_constant"]
        later = self.parameters["start"] - began > max(MIN_START * (seen - began), MIN_LATER * tau)
        lasting = seen - self.parameters["start"]
        # What comes at once, and at one place, is a step of its reading.
        rises = len(self.linear()) > 1 or tau >= RISING_SAMPLES * scene.period
        return reached and later and rises and tau < lasting and self._stops_within(began, seen)

    def _stops_within(self, began: float, seen: float) -> bool:
        """Whether it is switched off, where it is, while the log shows both; what warms is hot."""
        stop = self.parameters.get("stop")
        if stop is None:
            return True
        least = MIN_START * (seen - began)
        warms = all(gain >= 0 for gain in self._temperature_gains)
        return warms and stop - self.parameters["start"] > least and seen - stop > least

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        yield from cls.logged(scene, source_channels(scene))
        gains = {f"gain[{output}]": 1.0 for output in scene.outputs}
        slowest = max(scene.slowest.values())
        for log in scene.logs:
            for tau in time_constants(RISING_SAMPLES * log.period, log.duration, 4):
                for start in scene.instants(log, 15):
                    yield cls("", {**gains, "time_constant": tau, "start": start}, log.digest)
            for tau in (share * slowest for share in WINDOW_LAGS):
                for start, stop in combinations(scene.instants(log, WINDOWS), 2):
                    window = {"time_constant": tau, "start": start, "stop": stop}
                    yield cls("", {**gains, **window}, log.digest)
