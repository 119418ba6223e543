"""What can go wrong with the sensors of the lumped machine.

Errors of a sensor act on the rise above rest, also for an absolute temperature.
"""

from __future__ import annotations

import numpy as np
from machines.network import KELVIN, OUTPUTS, REST
from machines.scenario import (
    SENSORS,
    Array,
    Fault,
    Generator,
    Parameters,
    Run,
    Table,
    either_sign,
    moment,
)
from scipy.signal import lfilter


def sensor_lag(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel = str(generator.choice(SENSORS))

    def apply(strength: float, run: Run) -> Parameters:
        def lag(y: Array) -> Array:
            # Exact for a truth that is straight between samples.
            decay = np.exp(-run.dt / strength)
            late = strength / run.dt * (1.0 - decay)
            lagged: Array = lfilter([1.0 - late, late - decay], [1.0, -decay], y)
            return lagged

        if strength > 0.0:
            run.sensors.append((channel, lag))
        return {"time_constant_s": strength}

    return Fault(channel, apply, run.time[-1])


def sensor_gain(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, sign = str(generator.choice(SENSORS)), either_sign(generator)

    def apply(strength: float, run: Run) -> Parameters:
        gain = 1.0 + sign * strength
        run.sensors.append((channel, lambda y: gain * y))
        return {"gain": gain}

    return Fault(channel, apply, 0.9)


def sensor_offset_step(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, sign = str(generator.choice(SENSORS)), either_sign(generator)
    when = moment(run, generator)

    def apply(strength: float, run: Run) -> Parameters:
        step = sign * strength
        run.sensors.append((channel, lambda y: y + step * (run.time >= when)))
        return {"step": step, "time_s": when}

    return Fault(channel, apply)


def sensor_drift(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, sign = str(generator.choice(SENSORS)), either_sign(generator)

    def apply(strength: float, run: Run) -> Parameters:
        rate = sign * strength
        run.sensors.append((channel, lambda y: y + rate * run.time / 3600.0))
        return {"rate_per_h": rate}

    return Fault(channel, apply)


def sensor_conversion(run: Run, generator: Generator, variant: str | None) -> Fault:
    """A quadratic error of the rise above rest; ``thermistor``: a wrong constant B.

    With B' in place of B, 1/T' - 1/T0 = (B/B') (1/T - 1/T0) about T0 at rest, in kelvin; gain and
    curvature are the first terms of the reading's rise by the true one.
    """
    sign = either_sign(generator)
    channel = "T_column_degC" if variant == "thermistor" else str(generator.choice(SENSORS))

    def quadratic(strength: float, run: Run) -> Parameters:
        curvature = sign * strength
        run.sensors.append((channel, lambda y: y + curvature * y * y))
        return {"curvature": curvature}

    def thermistor(strength: float, run: Run) -> Parameters:
        ratio, rest = 1.0 + sign * strength, REST + KELVIN

        def read(y: Array) -> Array:
            wrong: Array = 1.0 / (1.0 / rest + ratio * (1.0 / (rest + y) - 1.0 / rest)) - rest
            return wrong

        run.sensors.append((channel, read))
        return {"B_ratio": ratio, "gain": ratio, "curvature": ratio * (ratio - 1.0) / rest}

    return Fault(channel, *((thermistor, 0.5) if variant == "thermistor" else (quadratic, 0.1)))


def sensor_frozen(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, when = str(generator.choice(SENSORS)), moment(run, generator)

    def apply(strength: float, run: Run) -> Parameters:
        first = int(np.searchsorted(run.time, when))

        def freeze(table: Table) -> Table:
            y = table[channel].copy()
            y[first:] = y[first]
            return table | {channel: y}

        run.readings.append(freeze)
        return {"start_s": when}

    return Fault(channel, apply, None)


def sensors_swapped(run: Run, generator: Generator, variant: str | None) -> Fault:
    one, other = "dT_near_K", "dT_far_K"

    def apply(strength: float, run: Run) -> Parameters:
        run.readings.append(lambda table: table | {one: table[other], other: table[one]})
        return {}

    return Fault(one, apply, None)


def outliers(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, share = str(generator.choice(OUTPUTS)), generator.uniform(0.005, 0.02)
    hit = generator.random(len(run.time)) < share
    hit[int(generator.uniform(0.2, 0.8) * len(hit))] = True
    size = generator.choice([-1.0, 1.0], len(hit)) * generator.uniform(0.5, 1.5, len(hit)) * hit

    def apply(strength: float, run: Run) -> Parameters:
        run.sensors.append((channel, lambda y: y + strength * size))
        return {"share": float(np.mean(hit)), "amplitude": strength}

    return Fault(channel, apply)
