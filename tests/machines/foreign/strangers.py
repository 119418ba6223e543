"""Kinds of trouble that no catalogue has: what is asked of a diagnosis is to say so, and where."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from machines.foreign.fault import Builder, Fault, Scene, on_displacement, on_drive, on_reading
from machines.foreign.plant import Conditions
from machines.foreign.solver import Array, React

_COLD = 6.0  # of a coolant below rest [K]
_LEVELS = 40  # of a mass that changes


def _coolant_leak(scene: Scene) -> Fault:
    """From an instant on cold fluid runs over a warm place, more and more of it."""
    node, begins = scene.hot(), scene.moment()
    grows = scene.clean.rows[-1] * scene.generator.uniform(0.02, 0.1)

    def apply(strength: float, c: Conditions) -> None:
        def make() -> React:
            def react(k: int, here: Array) -> tuple[float, Array]:
                heat, since = np.zeros_like(here), c.time[k] - begins
                if since > 0:
                    flow = strength * -np.expm1(-since / grows)
                    heat[node] = -flow * (here[node] + _COLD)
                return 1.0, heat

            return react

        c.react.append(make)

    body = scene.plant.body
    typical = 0.1 * float(body.film.sum()) / np.sqrt(body.nodes)
    fastest = 0.3 * float(body.capacity[node]) / scene.plant.dt
    return Fault(None, apply, typical, fastest, begins, recurs=False)


def _contact_loss(scene: Scene) -> Fault:
    """A sensor comes loose: it shows more and more of the air's temperature."""
    channel, begins = scene.thermometer(), scene.moment()
    loosens = scene.clean.rows[-1] * scene.generator.uniform(0.01, 0.08)

    def apply(strength: float, c: Conditions) -> None:
        air = c.at_rows(c.air)

        def loose(t: Array, y: Array) -> Array:
            share = strength * -np.expm1(-np.maximum(t - begins, 0.0) / loosens)
            return (1.0 - share) * y + share * air

        on_reading(c, channel, loose)

    return Fault(channel, apply, 0.1, 1.0, begins, recurs=False)


def _drive_hum(scene: Scene) -> Fault:
    """The drive's current is heard in a sensor's line: a beat and noise in proportion to it."""
    channel, seed = scene.thermometer(), int(scene.generator.integers(2**31))
    period = scene.plant.dt * scene.generator.uniform(2.3, 9.0)
    drive = scene.plant.drive

    def apply(strength: float, c: Conditions) -> None:
        draw = np.random.default_rng([seed, len(c.rows)])
        noise = draw.standard_normal(len(c.rows))
        level = c.at_rows(c.commands[drive.channel], True) / drive.largest

        def hum(t: Array, y: Array) -> Array:
            return y + strength * level * (np.sin(2 * np.pi * t / period) + 0.5 * noise)

        on_reading(c, channel, hum)

    return Fault(channel, apply, 0.2, 1e3)


def _hidden_fan(scene: Scene) -> Fault:
    """A fan that nobody logs comes on above a temperature, and goes off below another."""
    node = scene.hot()
    high = scene.peak(node) * scene.generator.uniform(0.5, 0.7)
    low = 0.8 * high

    def apply(strength: float, c: Conditions) -> None:
        def make() -> React:
            on = False

            def react(k: int, here: Array) -> tuple[float, float]:
                nonlocal on
                on = here[node] > (low if on else high)
                return 1.0 + strength * on, 0.0

            return react

        c.react.append(make)

    return Fault(None, apply, 0.15, 3.0)


def _mass_change(scene: Scene) -> Fault:
    """A tank fills or is drained, a load is put on: all heat capacities change with time."""
    begins, sign = scene.moment(), scene.sign()
    length = scene.clean.rows[-1] * scene.generator.uniform(0.05, 0.3)

    def apply(strength: float, c: Conditions) -> None:
        ramp = np.round(_LEVELS * np.clip((c.time - begins) / length, 0.0, 1.0)) / _LEVELS
        c.mass = c.mass * np.exp(sign * strength * ramp)

    return Fault(None, apply, 0.2, 1.5, begins, recurs=False)


def _door_open(scene: Scene) -> Fault:
    """Doors are opened now and then: cold air, and more of it."""
    rows, draw = scene.clean.rows, scene.generator
    starts = np.sort(draw.uniform(0.15, 0.9, draw.integers(2, 5))) * rows[-1]
    lengths = draw.uniform(0.02, 0.06, len(starts)) * rows[-1]

    def apply(strength: float, c: Conditions) -> None:
        for start, length in zip(starts, lengths, strict=True):
            is_open = (c.time >= start) & (c.time < start + length)
            c.film = np.where(is_open, c.film * (1.0 + strength), c.film)
            # What the room's thermometer, away from the door, does not see.
            c.heat = c.heat - np.outer(is_open * strength * 4.0, scene.plant.body.film)

    return Fault(None, apply, 0.5, 8.0, float(starts[0]), float(starts[-1] + lengths[-1]), False)


def _melting(scene: Scene) -> Fault:
    """Something melts at a temperature on the way, and freezes on the way back: a plateau."""
    node, dt = scene.hot(), scene.plant.dt
    melts = scene.peak(node) * scene.generator.uniform(0.35, 0.6)
    capacity = float(scene.plant.body.capacity[node])
    peak = scene.peak(node)

    def apply(strength: float, c: Conditions) -> None:
        full = strength * capacity * peak

        def make() -> React:
            molten = 0.0

            def react(k: int, here: Array) -> tuple[float, Array]:
                nonlocal molten
                heat = np.zeros_like(here)
                if full:
                    flow = 0.2 * capacity / dt * (here[node] - melts)
                    flow = float(np.clip(flow, -molten / dt, (full - molten) / dt))
                    molten += flow * dt
                    heat[node] = -flow
                return 1.0, heat

            return react

        c.react.append(make)

    return Fault(None, apply, 0.5, 40.0)


def _stick_slip(scene: Scene) -> Fault:
    """A slide sticks until the force is large enough, then jumps to where it belongs."""
    channel = scene.deflection()
    reach = scene.reach(channel)

    def apply(strength: float, c: Conditions) -> None:
        def slide(t: Array, y: Array) -> Array:
            found, here = y.copy(), y[0]
            for k, there in enumerate(y):
                if abs(there - here) > strength * reach:
                    here = there
                found[k] = here
            return found

        on_displacement(c, channel, slide)

    return Fault(channel, apply, 0.05, 0.6)


def _duty_gain(scene: Scene) -> Fault:
    """Every time that the drive comes on, what it gives is off from what is logged by a chance."""
    drive, seed = scene.plant.drive, int(scene.generator.integers(2**31))

    def apply(strength: float, c: Conditions) -> None:
        def cycles(u: Array) -> Array:
            number = np.cumsum(np.diff(u > 0, prepend=False) & (u > 0))
            chance = np.random.default_rng([seed, len(c.rows)]).standard_normal(number[-1] + 1)
            return u * np.maximum(1.0 + strength * chance[number], 0.1)

        on_drive(c, cycles)

    return Fault(drive.channel, apply, 0.1, 0.6)


def _creep(scene: Scene) -> Fault:
    """A bolted joint gives way from an instant on: fast at first, without end."""
    channel, begins, sign = scene.deflection(), scene.moment(), scene.sign()
    tau, reach = scene.clean.rows[-1] * 0.01, scene.reach(channel)

    def apply(strength: float, c: Conditions) -> None:
        on_displacement(
            c,
            channel,
            lambda t, y: y + sign * strength * reach * np.log1p(np.maximum(t - begins, 0) / tau),
        )

    return Fault(channel, apply, 0.02, 1.0, begins, recurs=False)


def _crosstalk(scene: Scene) -> Fault:
    """A capacity between two lines: a reading takes a share of the other one's rate of change."""
    one, other = scene.generator.permutation(scene.plant.thermometers)[:2]
    sign, channel = scene.sign(), str(one)
    seconds = 5 * scene.plant.dt

    def apply(strength: float, c: Conditions) -> None:
        def leak(table: dict[str, Array]) -> dict[str, Array]:
            rate = np.gradient(_smooth(table[str(other)]), table["time_s"])
            return table | {channel: table[channel] + sign * strength * seconds * rate}

        if strength:
            c.readings.append(leak)

    return Fault(channel, apply, 0.2, 1e3)


def _smooth(y: Array) -> Array:
    """Mean over 15 rows, as an amplifier's filter takes it."""
    padded = np.pad(y, 7, mode="edge")
    return np.convolve(padded, np.full(15, 1 / 15), "valid")


# Some may become causes of the catalogue one day, and are then right by these names.
MAY_BE_KNOWN: Mapping[str, tuple[Builder, frozenset[str]]] = {
    "drive_hum": (_drive_hum, frozenset({"state_noise", "noise_state", "drive_noise"})),
    "hidden_fan": (_hidden_fan, frozenset({"switching_loss", "unlogged_loss", "thermostat_fan"})),
    "melting": (_melting, frozenset({"latent_heat", "phase_change", "melting"})),
    "stick_slip": (_stick_slip, frozenset({"stick_slip", "displacement_backlash"})),
    "duty_gain": (_duty_gain, frozenset({"drive_gain"})),
}
# The others never will.
NEVER_KNOWN: Mapping[str, Builder] = {
    "coolant_leak": _coolant_leak,
    "contact_loss": _contact_loss,
    "mass_change": _mass_change,
    "door_open": _door_open,
    "creep": _creep,
    "crosstalk": _crosstalk,
}
