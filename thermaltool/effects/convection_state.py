"""Convection that changes with a state: coolant, speed, fan, heating against cooling down."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import product
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import is_plausible_rate, with_ends
from thermaltool.effects.effect import Effect, Float, Memory, Outputs, Parameter, needed
from thermaltool.effects.heat_loss import LOCAL, HeatLoss, places
from thermaltool.effects.scene import Scene
from thermaltool.record import Record
from thermaltool.units import parse_channel

# Levels of a table, at most, and what its numbers are called.
MAX_LEVELS, NUMBERED = 9, ("level", "rate")
# Lags of the heat that is lost at one place that are worth a trial.
LAG_TRIALS = 5
# A fan, a coolant or a door is none of these.
NO_STATES = ("temperature", "temperature difference", "length")


class ConvectionState(HeatLoss):
    """Heat is lost faster in proportion to a channel (over its largest value), by `rate`.

    The channel is a state of the log, or a drive: a speed that moves the air, or, where `idle` is
    1, one whose absence counts. Or the rate goes by levels of the channel (`level0`, `rate0`,
    `level1`, ...), along straight lines between them: with two of them x' = A x + B u − r x u. Or
    heat is lost at one place, `partner`, alone.
    """

    name: ClassVar[str] = "convection_state"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "the machine loses heat at another rate in some state: coolant on, spindle turning, fan, "
        "or the drive off (cooling down differs from warming up)"
    )
    signature: ClassVar[str] = (
        "all outputs decay at another rate while the state lasts, in proportion to their level or "
        "to that of one place"
    )
    source: ClassVar[str] = "Mize 1998 (coolant on or off); Zhu, Ni & Shih 2008 (cool-down)"
    known: ClassVar = {
        "rate": Parameter("1/s"),
        "level": Parameter("{channel}", fixed=True),
        "idle": Parameter("1", fixed=True),
        **LOCAL,
        **{f"level{k}": Parameter("{channel}", fixed=True) for k in range(MAX_LEVELS)},
        **{f"rate{k}": Parameter("1/s") for k in range(MAX_LEVELS)},
    }

    @property
    def action(self) -> str:  # type: ignore[override]
        """What a technician can do, with places for names."""
        changes = "the rate of heat loss changes by {rate}"
        if self.partner is not None:
            changes = "it cools {partner}; {output} moves by up to {moves}"
        return (
            "look at what changes the cooling with {channel} (coolant, fan, an open door, "
            f"standstill): {changes}; keep it the same in all runs, or leave the column in the log"
        )

    @property
    def table(self) -> tuple[list[float], list[float]] | None:
        """Levels, and the rate at each [1/s]; None where the rate is in proportion."""
        if "level0" not in self.parameters:
            return None
        numbers = [k for k in range(MAX_LEVELS) if f"level{k}" in self.parameters]
        levels, rates = ([self.parameters[f"{n}{k}"] for k in numbers] for n in NUMBERED)
        return levels, rates

    @cached_property
    def _line(self) -> tuple[Float, Float]:
        """The table with its ends; made once, for a stream asks at every sample."""
        assert self.table is not None
        return with_ends(*self.table)

    @property
    def known_range(self) -> tuple[float, float] | None:
        return None if self.table is None else (self.table[0][0], self.table[0][-1])

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.partner is not None:
            return None
        if self.table is not None:
            return np.interp(np.nan_to_num(needed(record, self.channel)), *self._line)
        return self.parameters["rate"] * self.state(record)

    def state(self, record: Record, memory: Memory = None) -> Float:
        share = np.abs(np.nan_to_num(needed(record, self.channel))) / self.parameters["level"]
        if self.parameters.get("idle"):
            share = (share < 0.02).astype(float)
        return np.minimum(share, 1.0)

    def plausible(self, scene: Scene) -> bool:
        if self.partner is not None:
            return super().plausible(scene)
        rates = (v for name, v in self.parameters.items() if name.startswith("rate"))
        return all(is_plausible_rate(rate, scene) for rate in rates)

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        # Both signs, and small against the slowest rate: the fit goes on from there.
        slowest = max(scene.slowest.values())
        for channel in (*scene.extra, *scene.drives):
            values = np.concatenate([log.columns[channel] for log in scene.logs])
            level = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
            if not level or np.ptp(values[np.isfinite(values)]) < 0.5 * level:
                continue
            idles = (1.0, 0.0) if channel in scene.drives else (0.0,)
            known = parse_channel(channel).dimension
            # Heat by itself moves no air.
            heats = channel in scene.drives and known == "power"
            if known not in NO_STATES and not heats:
                for idle, (place, air, own) in product(idles, list(places(scene, LAG_TRIALS))):
                    given = {**own, "level": level, "idle": idle}
                    yield cls(channel, given, partner=place, air=air)
            for idle in idles:
                for rate in (-0.3 / slowest, 0.3 / slowest, 1.0 / slowest):
                    yield cls(channel, {"rate": rate, "level": level, "idle": idle})
