"""Sensors that read late, wrong, or not at all."""

from __future__ import annotations

import numpy as np
from machines.foreign.fault import Fault, Scene, on_reading
from machines.foreign.plant import Conditions, Table
from machines.foreign.solver import Array

_OUTLIERS = 0.015  # share of the rows
_FROZEN = 0.15, 0.4  # how long a reading stands still, over the log


def sensor_lag(scene: Scene) -> Fault:
    channel = scene.thermometer()

    def apply(strength: float, c: Conditions) -> None:
        def late(t: Array, y: Array) -> Array:
            found = y.copy()
            for k, step in enumerate(np.diff(t)):
                # Of a signal that runs straight between rows.
                x, keep = step / strength, np.exp(-step / strength)
                slope = y[k + 1] - y[k]
                found[k + 1] = keep * found[k] + (1 - keep) * y[k] + slope * (1 - (1 - keep) / x)
            return found

        if strength:
            on_reading(c, channel, late)

    return Fault(channel, apply, scene.plant.dt, 0.1 * scene.plant.dt * scene.plant.steps)


def sensor_gain(scene: Scene) -> Fault:
    channel, sign = scene.thermometer(), scene.sign()

    def apply(strength: float, c: Conditions) -> None:
        on_reading(c, channel, lambda t, y: (1.0 + sign * strength) * y)

    return Fault(channel, apply, 0.05, 0.7)


def sensor_offset_step(scene: Scene) -> Fault:
    channel, sign, begins = scene.thermometer(), scene.sign(), scene.moment()

    def apply(strength: float, c: Conditions) -> None:
        on_reading(c, channel, lambda t, y: y + sign * strength * (t >= begins))

    return Fault(channel, apply, 0.2, 1e3, begins, recurs=False)


def sensor_drift(scene: Scene) -> Fault:
    channel, sign = scene.thermometer(), scene.sign()

    def apply(strength: float, c: Conditions) -> None:
        on_reading(c, channel, lambda t, y: y + sign * strength * t / 3600)

    return Fault(channel, apply, 0.05, 1e3)


def sensor_conversion(scene: Scene) -> Fault:
    channel, sign = scene.thermometer(), scene.sign()
    reach = scene.reach(channel)

    def apply(strength: float, c: Conditions) -> None:
        on_reading(c, channel, lambda t, y: y + sign * strength * y * (y / reach - 0.3))

    return Fault(channel, apply, 0.1, 0.6)


def outliers(scene: Scene) -> Fault:
    channel, seed = scene.thermometer(), int(scene.generator.integers(2**31))

    def apply(strength: float, c: Conditions) -> None:
        draw = np.random.default_rng([seed, len(c.rows)])
        hit = draw.random(len(c.rows)) < _OUTLIERS
        size = hit * draw.normal(0.0, 1.0, len(c.rows))

        on_reading(c, channel, lambda t, y: y + strength * size)

    return Fault(channel, apply, 1.0, 1e4)


def sensor_frozen(scene: Scene) -> Fault:
    channel, begins = scene.thermometer(), scene.moment()
    ends = begins + scene.clean.rows[-1] * scene.generator.uniform(*_FROZEN)

    def apply(strength: float, c: Conditions) -> None:
        def frozen(table: Table) -> Table:
            t, y = table["time_s"], table[channel]
            first = int(np.searchsorted(t, begins))
            return table | {channel: np.where((t >= begins) & (t < ends), y[first], y)}

        if strength:
            c.readings.append(frozen)

    return Fault(channel, apply, 1.0, 1.0, begins, min(ends, scene.clean.rows[-1]), False)


def sensors_swapped(scene: Scene) -> Fault | None:
    if len(scene.plant.thermometers) < 2:
        return None
    one, other = scene.plant.thermometers[:2]

    def apply(strength: float, c: Conditions) -> None:
        if strength:
            c.readings.append(lambda table: table | {one: table[other], other: table[one]})

    return Fault(one, apply, 1.0, 1.0)
