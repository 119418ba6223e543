"""Causes of the tool's catalogue, each built into the machine at the place where it acts.

None of it is the tool's own law where physics has another: a loop of many relays, a body that
radiates with the fourth power, a room that reaches every node.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from machines.foreign import sensor_faults
from machines.foreign.fault import Builder, Fault, Scene, on_displacement, on_drive
from machines.foreign.plant import FAN, PART, ROOM, Conditions
from machines.foreign.schedules import swing
from machines.foreign.solver import Array

_RELAYS = 300


# ---------------------------------------------------------------- drive


def _drive_nonlinearity(scene: Scene) -> Fault:
    sign = scene.sign()

    def apply(strength: float, c: Conditions) -> None:
        on_drive(c, lambda u: np.sign(u) * np.abs(u) ** np.exp(sign * strength))

    return Fault(scene.plant.drive.channel, apply, 0.2, 1.3)


def _transport_delay(scene: Scene) -> Fault:
    dt = scene.plant.dt

    def apply(strength: float, c: Conditions) -> None:
        whole, part = divmod(strength / dt, 1.0)

        def late(u: Array) -> Array:
            padded = np.concatenate([np.full(int(whole) + 1, u[0]), u])
            return (1.0 - part) * padded[1 : len(u) + 1] + part * padded[: len(u)]

        on_drive(c, late)

    return Fault(scene.plant.drive.channel, apply, dt, 0.1 * dt * scene.plant.steps)


def _hysteresis(scene: Scene) -> Fault:
    """A crowd of relays (Preisach): each switches on above one level, off below another."""
    width = scene.generator.uniform(0.3, 0.7)
    middle = scene.generator.uniform(-0.1, 1.1, _RELAYS)
    half = 0.5 * scene.generator.uniform(0.3, 1.0, _RELAYS) * width
    rest = float(np.mean(middle + half < 0.0))

    def relays(u: Array) -> Array:
        state = middle + half < 0.0
        found = np.empty_like(u)
        for k, level in enumerate(u):
            state = np.where(level >= middle + half, True, state & (level > middle - half))
            found[k] = state.mean()
        return (found - rest) * 1.2

    def apply(strength: float, c: Conditions) -> None:
        on_drive(c, lambda u: (1.0 - strength) * u + strength * relays(u))

    return Fault(scene.plant.drive.channel, apply, 0.2, 1.0)


def _backlash(scene: Scene) -> Fault:
    def apply(strength: float, c: Conditions) -> None:
        def play(u: Array) -> Array:
            follows, here = np.zeros_like(u), 0.0
            for k, command in enumerate(u):
                here = min(max(here, command - strength / 2), command + strength / 2)
                follows[k] = here
            return follows

        on_drive(c, play)

    return Fault(scene.plant.drive.channel, apply, 0.1, 0.8)


def _actuator_saturation(scene: Scene) -> Fault:
    def apply(strength: float, c: Conditions) -> None:
        on_drive(c, lambda u: np.minimum(u, 1.0 - strength))

    return Fault(scene.plant.drive.channel, apply, 0.2, 0.8)


# ---------------------------------------------------------------- heat balance


def _ambient_drift(scene: Scene) -> Fault | None:
    if scene.plant.room:  # the user knows it as an input
        return None
    seed = int(scene.generator.integers(2**31))

    def apply(strength: float, c: Conditions) -> None:
        course = swing(c.time, np.random.default_rng(seed))
        c.air = c.air + strength * (course - np.interp(0.0, c.time, course))

    return Fault(ROOM, apply, 1.0, 12.0)


def _second_source(scene: Scene, latent: bool = False) -> Fault:
    node, pump = scene.plant.source, scene.plant.pump
    begins = scene.moment()

    def apply(strength: float, c: Conditions) -> None:
        c.heat[:, node] += strength * (c.time >= begins if latent else c.beside[pump])

    start = begins if latent else None
    full = scene.plant.drive.law(np.array([1.0]))[0]
    return Fault(None if latent else pump, apply, 0.05 * full, full, start, recurs=not latent)


def _convection_state(scene: Scene) -> Fault:
    def apply(strength: float, c: Conditions) -> None:
        c.film = c.film * (1.0 + strength * c.beside[FAN])

    return Fault(FAN, apply, 0.1, 3.0)


def _loss_change(scene: Scene) -> Fault:
    sign = scene.sign()

    def apply(strength: float, c: Conditions) -> None:
        c.film = c.film * np.exp(sign * strength)

    return Fault(None, apply, 0.05, 1.5)


def _radiation(scene: Scene) -> Fault:
    def apply(strength: float, c: Conditions) -> None:
        c.emissivity += strength

    return Fault(None, apply, 0.3, 1.0)


def _periodic(scene: Scene) -> Fault:
    period = scene.clean.rows[-1] * scene.generator.uniform(0.04, 0.15)
    phase, node = scene.generator.uniform(0.0, 2 * np.pi), scene.plant.source

    def apply(strength: float, c: Conditions) -> None:
        c.heat[:, node] += strength * np.sin(2 * np.pi * c.time / period + phase)

    full = scene.plant.drive.law(np.array([1.0]))[0]
    return Fault(None, apply, 0.05 * full, full)


# ---------------------------------------------------------------- structure


def _joint_contact(scene: Scene) -> Fault:
    channel, sign = scene.deflection(), scene.sign()
    reach = scene.reach(channel)

    def apply(strength: float, c: Conditions) -> None:
        on_displacement(c, channel, lambda t, y: y + sign * strength * y * np.abs(y) / reach)

    return Fault(channel, apply, 0.1, 0.45)


def _geometry_step(scene: Scene) -> Fault:
    channel, sign, begins = scene.deflection(), scene.sign(), scene.moment()
    reach = scene.reach(channel)

    def apply(strength: float, c: Conditions) -> None:
        on_displacement(c, channel, lambda t, y: y + sign * strength * reach * (t >= begins))

    return Fault(channel, apply, 0.05, 2.0, begins, recurs=False)


def _part_temperature(scene: Scene) -> Fault | None:
    if not scene.plant.part:
        return None
    channel, sign = scene.deflection(), scene.sign()

    def apply(strength: float, c: Conditions) -> None:
        part = c.at_rows(c.beside[PART])
        on_displacement(c, channel, lambda t, y: y + sign * strength * (part - part[0]))

    return Fault(PART, apply, 0.3, 20.0)


CATALOGUE: Mapping[str, Builder] = {
    "ambient_drift": _ambient_drift,
    "second_source": _second_source,
    "second_source/latent": partial(_second_source, latent=True),
    "drive_nonlinearity": _drive_nonlinearity,
    "transport_delay": _transport_delay,
    "sensor_lag": sensor_faults.sensor_lag,
    "sensor_gain": sensor_faults.sensor_gain,
    "sensor_offset_step": sensor_faults.sensor_offset_step,
    "sensor_drift": sensor_faults.sensor_drift,
    "sensor_conversion": sensor_faults.sensor_conversion,
    "convection_state": _convection_state,
    "radiation": _radiation,
    "joint_contact": _joint_contact,
    "hysteresis": _hysteresis,
    "backlash": _backlash,
    "actuator_saturation": _actuator_saturation,
    "periodic": _periodic,
    "geometry_step": _geometry_step,
    "part_temperature": _part_temperature,
    "outliers": sensor_faults.outliers,
}
# Of the catalogue since the draws of the exam were told: drawn where it is asked for.
SINCE: Mapping[str, Builder] = {"loss_change": _loss_change}
# Without a strength: they have the size that they have.
NATURAL: Mapping[str, Builder] = {
    "sensor_frozen": sensor_faults.sensor_frozen,
    "sensors_swapped": sensor_faults.sensors_swapped,
}
