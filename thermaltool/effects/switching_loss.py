"""Switching loss: a fan or pump that nobody logs is switched by a temperature."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from thermaltool.effects.dynamics import is_plausible_rate
from thermaltool.effects.effect import (
    NOBODY_LOGGED,
    Effect,
    Float,
    Memory,
    Outputs,
    Parameter,
    Scene,
    Side,
    needed,
)
from thermaltool.record import Record

# Thresholds that are tried, and how far below them it is switched off, as shares of the range that
# the temperature goes through.
THRESHOLDS, BANDS = (0.3, 0.5, 0.7), (0.1, 0.3)


class SwitchingLoss(Effect):
    """Heat is lost faster by `rate` from where a temperature reaches `on` until it is below `off`.

    The temperature is the reading of the log: a thermostat has no other either.
    """

    name: ClassVar[str] = "switching_loss"
    side: ClassVar[Side] = "state"
    bends: ClassVar[bool] = True
    explanation: ClassVar[str] = (
        "a fan, a pump or a valve that is not logged is switched by a thermostat"
    )
    action: ClassVar[str] = (
        "look for a fan, pump or valve that switches on where {channel} passes {on} and off "
        "below {off}: log it, or keep it on or off"
    )
    signature: ClassVar[str] = (
        "all outputs decay faster from the moment in which a temperature passes one level upwards "
        "until it passes another one downwards"
    )
    source: ClassVar[str] = "Åström & Hägglund 1995, ch. 2 (relay with hysteresis)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "rate": Parameter("1/s", low=0.0),
        "on": Parameter("{channel}", place=True),
        "off": Parameter("{channel}", place=True),
    }

    @property
    def odds(self) -> float:
        return NOBODY_LOGGED

    def needs(self) -> tuple[str, ...]:
        return (self.channel,)

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        memory = {} if memory is None else memory
        reading = needed(record, self.channel)
        off = min(self.parameters["off"], self.parameters["on"])
        # Between the two levels, and where nothing is read, it stays as it was.
        says = np.select([reading >= self.parameters["on"], reading < off], [1.0, 0.0], np.nan)
        says = np.append(memory.get("state", 0.0), says)
        rows = np.maximum.accumulate(np.where(np.isfinite(says), np.arange(len(says)), 0))
        state = says[rows][1:]
        memory["state"] = float(state[-1])
        return self.parameters["rate"] * state

    def plausible(self, scene: Scene) -> bool:
        rises = self.parameters["off"] <= self.parameters["on"]
        return (
            super().plausible(scene) and rises and is_plausible_rate(self.parameters["rate"], scene)
        )

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        slowest = max(scene.slowest.values())
        for sensor in scene.sensors():
            logged = [log.columns[sensor] for log in scene.logs if sensor in log.columns]
            if len(logged) < len(scene.logs):
                continue
            low, high = np.nanquantile(np.concatenate(logged), (0.01, 0.99)).tolist()
            span = high - low
            for share, band in itertools.product(THRESHOLDS, BANDS) if span else ():
                on = low + share * span
                yield cls(sensor, {"rate": 0.5 / slowest, "on": on, "off": on - band * span})
