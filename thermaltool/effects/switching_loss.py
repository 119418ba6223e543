"""Switching loss: a fan or pump that nobody logs is switched by a temperature."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache
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
    needed,
)
from thermaltool.effects.heat_loss import LOCAL, HeatLoss, places
from thermaltool.effects.scene import Scene
from thermaltool.record import Record

# Thresholds that are tried, and how far below them it is switched off, as shares of the range that
# the temperature goes through.
THRESHOLDS, BANDS = (0.3, 0.5, 0.7), (0.1, 0.3)
# A machine is warm from this share of the range on; what is on for more of that time is no switch.
WARM, MAX_ON = 0.1, 0.9
# At the place of the thermostat itself many more are looked at, the likeliest ones closely, and so
# many tried in full, with so many lags each.
NEAR_THRESHOLDS, NEAR_BANDS = np.linspace(0.1, 0.98, 31).tolist(), (0.02, 0.06, 0.12, 0.2, 0.32)
CLOSE_STEPS, CLOSE_LOOKS, MAX_PROBES, LAG_TRIALS = (0.015, 0.007, 0.003), 3, 2, 3


class SwitchingLoss(HeatLoss):
    """Heat is lost faster by `rate` from where a temperature reaches `on` until it is below `off`.

    The temperature is the reading of the log: a thermostat has no other either. Or heat is lost at
    one place, `partner`, alone.
    """

    name: ClassVar[str] = "switching_loss"
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
    known: ClassVar = {
        "rate": Parameter("1/s", low=0.0),
        "on": Parameter("{channel}", place=True),
        "off": Parameter("{channel}", place=True),
        **LOCAL,
    }

    @property
    def odds(self) -> float:
        return NOBODY_LOGGED

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        if self.partner is not None:
            return None
        return self.parameters["rate"] * self.state(record, memory)

    def state(self, record: Record, memory: Memory = None) -> Float:
        memory = {} if memory is None else memory
        reading = needed(record, self.channel)
        off = min(self.parameters["off"], self.parameters["on"])
        # Between the two levels, and where nothing is read, it stays as it was.
        says = np.select([reading >= self.parameters["on"], reading < off], [1.0, 0.0], np.nan)
        says = np.append(memory.get("state", 0.0), says)
        rows = np.maximum.accumulate(np.where(np.isfinite(says), np.arange(len(says)), 0))
        state = says[rows][1:]
        memory["state"] = float(state[-1])
        return state

    def plausible(self, scene: Scene) -> bool:
        rises = self.parameters["off"] <= self.parameters["on"]
        if not (rises and super().plausible(scene)):
            return False
        if not self._switches(scene):
            return False
        if self.partner is not None:
            return self.total(self.partner) < 0
        return is_plausible_rate(self.parameters["rate"], scene)

    def _switches(self, scene: Scene) -> bool:
        """Whether it is off for a part of the time in which the machine is warm.

        What is on whenever heat could be lost is another loss, and no thermostat.
        """
        states, readings = [], []
        for log in scene.logs:
            if self.channel in log.columns:
                states.append(self.state(log))
                readings.append(log.columns[self.channel])
        state, reading = (np.concatenate(each) for each in (states, readings))
        low, high = np.nanquantile(reading, (0.01, 0.99)).tolist()
        warm = state[reading > low + WARM * (high - low)]
        return not len(warm) or float(np.mean(warm)) < MAX_ON

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
            if span:
                yield from cls._where_it_is_read(scene, sensor, low, span)

    @classmethod
    def _where_it_is_read(
        cls, scene: Scene, sensor: str, low: float, span: float
    ) -> Iterator[Effect]:
        """A fan that cools the place of its thermostat, by what explains most of that output."""
        lags = [each for each in places(scene, LAG_TRIALS) if each[0] == sensor]

        def at(point: tuple[float, float], k: int) -> SwitchingLoss:
            _, air, own = lags[k]
            on = low + point[0] * span
            limits = {"on": on, "off": on - point[1] * span}
            return cls(sensor, {**own, **limits}, partner=sensor, air=air)

        @cache
        def explained(point: tuple[float, float]) -> float:
            return at(point, len(lags) // 2).explained(scene)

        grid = list(itertools.product(NEAR_THRESHOLDS, NEAR_BANDS)) if lags else []
        found = sorted(grid, key=explained, reverse=True)[:CLOSE_LOOKS]
        for step in CLOSE_STEPS:
            moves = list(itertools.product((-step, 0.0, step), repeat=2))
            found = [
                max(((a + x, max(b + y, 0.0)) for x, y in moves), key=explained) for a, b in found
            ]
        likeliest = sorted(dict.fromkeys(found), key=explained, reverse=True)[:MAX_PROBES]
        for point in likeliest:
            if explained(point):
                yield from (at(point, k) for k in range(len(lags)))
