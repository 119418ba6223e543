"""What can go wrong with the lumped machine, each at the place where physics puts it.

A fault of some strength changes a `Run` and says what it did: parameters in the units of the
channels. Those of the sensors are in `machines.sensor_faults`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from machines import sensor_faults
from machines.network import BEARING, KELVIN, OUTPUTS, REST, STEFAN_BOLTZMANN, WALL
from machines.scenario import (
    AIR,
    BEARING_HEAT,
    COOLANT,
    DEFLECTIONS,
    DRIVE,
    PART,
    SPEED,
    Array,
    Fault,
    Generator,
    Parameters,
    Run,
    either_sign,
    hall,
    moment,
)


def _gains(run: Run, heat: Array) -> Parameters:
    """What every output ends at, in its unit, under a steady `heat` (n,) [W]."""
    ends = run.network.rows @ run.network.steady(heat)
    return {f"gain_{name}": float(y) for name, y in zip(OUTPUTS, ends, strict=True)}


# ---------------------------------------------------------------------------- drive


def _drive_nonlinearity(run: Run, generator: Generator, variant: str | None) -> Fault:
    sign = either_sign(generator)

    def power(strength: float, run: Run) -> Parameters:
        exponent = float(np.exp(sign * strength))
        run.drive.append(lambda u: np.sign(u) * np.abs(u) ** exponent)
        return {"exponent": exponent}

    def dead_band(strength: float, run: Run) -> Parameters:
        run.drive.append(lambda u: np.sign(u) * np.maximum(np.abs(u) - strength, 0.0))
        return {"dead_band": strength}

    def quadratic(strength: float, run: Run) -> Parameters:
        run.drive.append(lambda u: u + sign * strength * u**2)
        return {"quadratic": sign * strength}

    if variant == "dead_band":
        return Fault(DRIVE, dead_band, 0.9)
    if variant == "quadratic":
        return Fault(DRIVE, quadratic, 0.45)
    return Fault(DRIVE, power, 1.5)


def _transport_delay(run: Run, generator: Generator, variant: str | None) -> Fault:
    def apply(strength: float, run: Run) -> Parameters:
        # A held command that comes late changes within a sample: its mean over the sample.
        whole, part = divmod(strength / run.dt, 1.0)

        def late(u: Array) -> Array:
            padded = np.concatenate([np.zeros(int(whole) + 1), u])
            return (1.0 - part) * padded[1 : len(u) + 1] + part * padded[: len(u)]

        run.drive.append(late)
        return {"delay_s": strength}

    return Fault(DRIVE, apply, run.time[-1] / 2)


def _hysteresis(run: Run, generator: Generator, variant: str | None) -> Fault:
    """The Bouc-Wen law without its exponent: heat u - share z, dz/du = 1 - sign(du) z/(width/2)."""
    width = generator.uniform(0.3, 0.9)

    def apply(strength: float, run: Run) -> Parameters:
        def bouc_wen(u: Array) -> Array:
            reach, z = width / 2, 0.0
            lag = np.zeros_like(u)
            for k, change in enumerate(np.diff(u, prepend=0.0)):
                if change:
                    full = np.copysign(reach, change)
                    z = full + (z - full) * np.exp(-abs(change) / reach)
                lag[k] = z
            return u - strength * lag

        run.drive.append(bouc_wen)
        return {"width": width, "share": strength}

    return Fault(DRIVE, apply, 1.0)


def _backlash(run: Run, generator: Generator, variant: str | None) -> Fault:
    def apply(strength: float, run: Run) -> Parameters:
        def play(u: Array) -> Array:
            follows = np.zeros_like(u)
            here = 0.0
            for k, command in enumerate(u):
                here = min(max(here, command - strength / 2), command + strength / 2)
                follows[k] = here
            return follows

        run.drive.append(play)
        return {"width": strength}

    return Fault(DRIVE, apply, 1.0)


def _actuator_saturation(run: Run, generator: Generator, variant: str | None) -> Fault:
    level = float(np.max(np.abs(run.columns[DRIVE])))

    def apply(strength: float, run: Run) -> Parameters:
        limit = level * (1.0 - strength)
        run.drive.append(lambda u: np.clip(u, -limit, limit))
        return {"limit": limit}

    return Fault(DRIVE, apply, 0.9)


# ---------------------------------------------------------------------------- heat balance


def _ambient_drift(run: Run, generator: Generator, variant: str | None) -> Fault:
    swing = hall(run.time, generator.uniform(2.0, 4.0), generator)

    def apply(strength: float, run: Run) -> Parameters:
        run.columns[AIR] = REST + swing
        run.exposure = strength
        return _gains(run, strength * run.network.film)

    latent = variant == "latent"
    return Fault(None if latent else AIR, apply, 1.0, AIR if latent else None)


def _second_source(run: Run, generator: Generator, variant: str | None) -> Fault:
    # In the back wall or the arm, away from the foot and from the bearing.
    node = int(generator.choice([*range(WALL + 2, 2 * WALL), *range(2 * WALL + 1, BEARING)]))
    start = moment(run, generator)

    def apply(strength: float, run: Run) -> Parameters:
        heat = run.network.source(node, strength)
        latent = variant == "latent"
        course = 1.0 * (run.time >= start) if latent else run.columns[BEARING_HEAT]
        run.heat = run.heat + np.outer(course, heat)
        return _gains(run, heat) | ({"start_s": start} if latent else {})

    if variant == "latent":
        return Fault(None, apply, np.inf, BEARING_HEAT)
    return Fault(BEARING_HEAT, apply)


def _convection_state(run: Run, generator: Generator, variant: str | None) -> Fault:
    sign = either_sign(generator)
    channel = {None: COOLANT, "speed": SPEED, "cool_down": DRIVE}[variant]

    def apply(strength: float, run: Run) -> Parameters:
        value = run.columns[channel]
        state = (value == 0.0) if variant == "cool_down" else (value > 0.0)
        change = sign * strength
        run.film = run.film * np.where(state, 1.0 + change, 1.0)
        # Rate of the slowest mode by which the film's change alters it, to first order.
        shape = run.network.modes()[1][:, 0]
        return {"change": change, "rate": change * float(shape**2 @ run.network.film)}

    return Fault(channel, apply, 0.9 if sign < 0 else 5.0)


def _radiation(run: Run, generator: Generator, variant: str | None) -> Fault:
    def apply(strength: float, run: Run) -> Parameters:
        run.emissivity = strength
        # Rate of loss of the slowest mode that radiation stands for at rest.
        at_rest = 4 * strength * STEFAN_BOLTZMANN * (REST + KELVIN) ** 3 * run.network.area
        shape = run.network.modes()[1][:, 0]
        return {"emissivity": strength, "rate": float(shape**2 @ at_rest)}

    return Fault("T_column_degC", apply, 1.0)


def _periodic(run: Run, generator: Generator, variant: str | None) -> Fault:
    duration = run.time[-1]
    period = float(np.exp(generator.uniform(np.log(20 * run.dt), np.log(duration / 8))))
    node = int(generator.choice([*range(WALL + 2, 2 * WALL), *range(2 * WALL + 1, BEARING)]))
    phase = generator.uniform(0.0, 2 * np.pi)

    def apply(strength: float, run: Run) -> Parameters:
        heat = run.network.source(node, strength)
        course = np.sin(2 * np.pi * run.time / period + phase)
        run.heat = run.heat + np.outer(course, heat)
        follows = np.abs(run.network.rows @ run.network.swinging(heat, period))
        return {"period_s": period} | {
            f"amplitude_{name}": float(y) for name, y in zip(OUTPUTS, follows, strict=True)
        }

    return Fault(None, apply)


# ---------------------------------------------------------------------------- structure


def _joint_contact(run: Run, generator: Generator, variant: str | None) -> Fault:
    """A structure in series with a joint whose force is k x (1 + b x) for a compression x.

    Of an expansion e the structure transmits d = e - x, with k x (1 + b x) = e - x and k the
    joint's stiffness over the structure's; d for b = 0 is what the machine has without the fault.
    The joint stiffens one way and gives way the other; ``curvature`` is the leading term of
    d(b) = d + curvature d² + ...
    """
    channel = str(generator.choice(DEFLECTIONS))
    stiffness, sign = generator.uniform(0.2, 1.0), either_sign(generator)

    def apply(strength: float, run: Run) -> Parameters:
        stiffening = sign * strength

        def joint(d: Array) -> Array:
            expansion = d * (1.0 + stiffness) / stiffness
            root = (1.0 + stiffness) ** 2 + 4.0 * stiffness * stiffening * expansion
            # No root: the joint is open, and more expansion is not transmitted.
            return expansion - 2.0 * expansion / (1.0 + stiffness + np.sqrt(np.maximum(root, 0.0)))

        run.mechanics.append((channel, joint))
        curvature = stiffening / (stiffness * (1.0 + stiffness))
        return {"stiffness_1": stiffness, "stiffening": stiffening, "curvature": curvature}

    return Fault(channel, apply)


def _geometry_step(run: Run, generator: Generator, variant: str | None) -> Fault:
    when = moment(run, generator)
    steps = {name: either_sign(generator) * generator.uniform(0.5, 1.5) for name in DEFLECTIONS}

    def apply(strength: float, run: Run) -> Parameters:
        after = 1.0 * (run.time >= when)
        jumps = {name: strength * step for name, step in steps.items()}
        for name, jump in jumps.items():
            run.mechanics.append((name, partial(np.add, jump * after)))
        return {"time_s": when} | {f"step_{name}": jump for name, jump in jumps.items()}

    return Fault(None, apply)


def _part_temperature(run: Run, generator: Generator, variant: str | None) -> Fault:
    channel, sign = str(generator.choice(DEFLECTIONS)), either_sign(generator)

    def apply(strength: float, run: Run) -> Parameters:
        warmer = run.columns[PART] - run.columns[PART][0]
        run.mechanics.append((channel, lambda d: d + sign * strength * warmer))
        return {f"coefficient_{channel}": sign * strength}

    return Fault(PART, apply)


# ---------------------------------------------------------------------------- the record


def _record_too_short(run: Run, generator: Generator, variant: str | None) -> Fault:
    # Nothing acts: it is the calibration that ends too early.
    return Fault(None, lambda strength, run: {"covered": 0.5}, None)


FAULTS: dict[str, Callable[[Run, Generator, str | None], Fault]] = {
    "ambient_drift": _ambient_drift,
    "second_source": _second_source,
    "drive_nonlinearity": _drive_nonlinearity,
    "transport_delay": _transport_delay,
    "sensor_lag": sensor_faults.sensor_lag,
    "sensor_gain": sensor_faults.sensor_gain,
    "sensor_offset_step": sensor_faults.sensor_offset_step,
    "sensor_drift": sensor_faults.sensor_drift,
    "sensor_conversion": sensor_faults.sensor_conversion,
    "sensor_frozen": sensor_faults.sensor_frozen,
    "sensors_swapped": sensor_faults.sensors_swapped,
    "convection_state": _convection_state,
    "radiation": _radiation,
    "joint_contact": _joint_contact,
    "hysteresis": _hysteresis,
    "backlash": _backlash,
    "actuator_saturation": _actuator_saturation,
    "periodic": _periodic,
    "geometry_step": _geometry_step,
    "part_temperature": _part_temperature,
    "record_too_short": _record_too_short,
    "outliers": sensor_faults.outliers,
}

# Other forms of a fault, beside the one without a name.
VARIANTS: dict[str, tuple[str, ...]] = {
    "ambient_drift": ("latent",),
    "second_source": ("latent",),
    "drive_nonlinearity": ("dead_band", "quadratic"),
    "convection_state": ("speed", "cool_down"),
    "sensor_conversion": ("thermistor",),
}
