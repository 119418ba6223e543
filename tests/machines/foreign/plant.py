"""A machine of other physics than the tool's, and one log of it: what acts, and what is read."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from machines.foreign.schedules import Schedule, duty, staircase, swing, switched, workpieces
from machines.foreign.solver import Array, Body, Loads, React, simulate

Generator = np.random.Generator
Table = dict[str, Array]
# Time [s] and signal in, signal out.
Change = Callable[[Array, Array], Array]

REST = 21.0  # [°C]
ROOM, FAN, PART = "T_room_degC", "x_fan_1", "T_part_degC"
QUIET_ROOM = 0.02  # swing of a room that is kept at its temperature [K]
_WARM = 0.3  # length of what went before a warm start, over that of the log


@dataclass(frozen=True)
class Noise:
    """Of a reading: white noise and slow drift (standard deviations), its smallest step."""

    white: float
    drift: float
    step: float = 0.001

    @property
    def sigma(self) -> float:
        return float(np.sqrt(self.white**2 + self.drift**2 + self.step**2 / 12))


@dataclass(frozen=True)
class Thermostat:
    """Heat is commanded by the temperature of a `node`: `gain` [W/K] below up to `rise` [K]."""

    node: int
    gain: float
    rise: float


@dataclass(frozen=True)
class Drive:
    """A logged input.

    Parameters
    ----------
    channel : str
    largest : float
        In the unit of the channel.
    inlet : (n,) ndarray
        Share of its heat that each node takes.
    law : function
        From what acts, over `largest`, to heat [W].
    thermostat : Thermostat, optional
        What commands it.
    calibration, duty : Schedule
        Of a designed excitation, and of all later logs.
    grows : (int, float), optional
        Node whose warmth adds to the heat, and by what share for a kelvin: copper's resistance.
    """

    channel: str
    largest: float
    inlet: Array
    law: Callable[[Array], Array]
    thermostat: Thermostat | None = None
    calibration: Schedule = staircase
    duty: Schedule = duty
    grows: tuple[int, float] | None = None


@dataclass(frozen=True)
class Plant:
    """A machine.

    Parameters
    ----------
    name : str
    body : Body
    drives : tuple of Drive
        The last one is commanded freely: what goes wrong with a drive happens to it.
    sensors, deflections : mapping of channel to (n,) ndarray
        Weights of the nodes' temperatures above rest.
    noise : mapping of channel to Noise
    dt : float [s]
        Of the grid, on which rows lie where the clock is even.
    steps : int
        Of the grid, in one log.
    pump : str
        Channel of a machine beside, on or off, that should warm nothing.
    source : int
        Node that it warms where it does.
    room : float [K]
        Swing of the room, where the user knows it as an input; else it is kept.
    weather : Schedule
        Course of the room for a swing of 1.
    days : float [K]
        Deviation of a log's room from another's. The machine has not come to rest in it.
    jitter : float
        Irregular clock: departure of a row's time, over the step of its clock (4 grid steps).
    dropped : float
        Share of the rows that are lost.
    warm : float
        Share of the later logs that begin on a warm machine.
    part : bool
        Whether there is a workpiece.
    emissivity : float
        Of the clean machine, where radiation beyond its linear part matters.
    own : frozenset of str
        Causes that are true of the machine itself: naming them is no error.
    foreign : mapping of channel to (name, scale, offset)
        How the log calls and counts it: channel = scale * value + offset.
    """

    name: str
    body: Body
    drives: tuple[Drive, ...]
    sensors: Mapping[str, Array]
    deflections: Mapping[str, Array]
    noise: Mapping[str, Noise]
    dt: float
    steps: int
    pump: str
    source: int
    room: float = 0.0
    weather: Schedule = swing
    days: float = 0.0
    jitter: float = 0.0
    dropped: float = 0.0
    warm: float = 0.0
    part: bool = False
    emissivity: float = 0.0
    own: frozenset[str] = frozenset()
    foreign: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    @property
    def outputs(self) -> dict[str, Array]:
        return {**self.sensors, **self.deflections}

    @property
    def thermometers(self) -> list[str]:
        return list(self.sensors)

    @property
    def drive(self) -> Drive:
        return self.drives[-1]

    @property
    def inputs(self) -> list[str]:
        """What a user would give as drives."""
        return [d.channel for d in self.drives] + [ROOM] * bool(self.room)


@dataclass
class Conditions:
    """Everything that acts in one log; an effect changes it at the place where it acts.

    Parameters
    ----------
    time : (m,) ndarray [s]
        Of the grid; below zero what went before a warm start.
    rows : (r,) ndarray [s]
        Times of the rows.
    commands : dict of channel to (m,) ndarray
        In the unit of the channel.
    setpoints : dict of channel to (m,) ndarray [K]
        Of drives under a thermostat.
    beside : dict of channel to (m,) ndarray
        What is logged beside: pump, fan, workpiece.
    air : (m,) ndarray [K]
        Above rest.
    act : list of Change
        From the command of the last drive, over its largest, to what acts.
    heat : (m, n) ndarray [W]
    film, mass : (m,) ndarray
    emissivity : float
    react : list of functions of (Conditions) to React
        Made anew for every simulation, since they remember.
    mechanics, sensors : dict of channel to list of Change
        From a displacement to what is there to be measured; from a truth, relative to rest, to
        what its sensor says. At the rows.
    readings : list of functions
        From the table of all readings to the one that is logged.
    """

    time: Array
    rows: Array
    commands: Table
    setpoints: Table
    beside: Table
    air: Array
    heat: Array
    film: Array
    mass: Array
    act: list[Change] = field(default_factory=list)
    emissivity: float = 0.0
    react: list[Callable[[], React]] = field(default_factory=list)
    mechanics: dict[str, list[Change]] = field(default_factory=dict)
    sensors: dict[str, list[Change]] = field(default_factory=dict)
    readings: list[Callable[[Table], Table]] = field(default_factory=list)

    def copy(self) -> Conditions:
        return copy.deepcopy(self)

    def at_rows(self, values: Array, is_held: bool = False) -> Array:
        """A signal of the grid at the rows."""
        if is_held:
            return values[np.searchsorted(self.time, self.rows + 1e-9, "right") - 1]
        return np.interp(self.rows, self.time, values)


@dataclass(frozen=True)
class Course:
    """A simulated log: `table` without noise, and the temperatures of the nodes (m, n)."""

    table: Table
    nodes: Array
    commands: Table


def draw(plant: Plant, generator: Generator, calibrating: bool = False) -> Conditions:
    """Conditions of a clean log."""
    before = 0
    idle = False
    if not calibrating and generator.random() < plant.warm:
        before = int(_WARM * plant.steps)
    elif plant.days:
        before, idle = int(_WARM * plant.steps), True
    time = np.asarray(plant.dt * np.arange(-before, plant.steps), float)
    rows = time[time >= 0]
    if plant.jitter:
        step = 4 * plant.dt
        rows = np.asarray(step * np.arange(1, plant.steps // 4), float)
        rows = rows + step * plant.jitter * generator.uniform(-1.0, 1.0, len(rows))
        rows = np.round(rows[generator.random(len(rows)) > plant.dropped], 1)
        rows = np.concatenate([[0.0], rows])
    commands, setpoints = {}, {}
    for each in plant.drives:
        course = (each.calibration if calibrating else each.duty)(time[before * idle :], generator)
        course = np.concatenate([np.zeros(before * idle), course])
        if each.thermostat:
            setpoints[each.channel] = each.thermostat.rise * course
        else:
            commands[each.channel] = np.round(each.largest * course, 3)
    amplitude = generator.uniform(0.7, 1.3) * plant.room if plant.room else QUIET_ROOM
    air = amplitude * plant.weather(time, generator)
    air = air - np.interp(0.0, time, air)
    if plant.days:
        today, yesterday = generator.normal(0.0, plant.days, 2)
        air = air + today + (yesterday - today) * np.clip(-time / (plant.dt * before), 0.0, 1.0)
    beside = {plant.pump: switched(time, generator), FAN: switched(time, generator)}
    if plant.part:
        beside[PART] = workpieces(time, generator)
    ones = np.ones(len(time))
    heat = np.zeros((len(time), plant.body.nodes))
    c = Conditions(time, rows, commands, setpoints, beside, air, heat, ones, ones.copy())
    c.emissivity = plant.emissivity
    return c


def run(plant: Plant, c: Conditions) -> Course:
    """What would be logged without noise."""
    loads = Loads(c.heat.copy(), c.air, c.film, c.mass, c.emissivity, [make() for make in c.react])
    commands = dict(c.commands)
    for each in plant.drives:
        if each.channel in commands:
            acts = commands[each.channel] / each.largest
            for change in c.act if each is plant.drive else ():
                acts = change(c.time, acts)
            heat = np.outer(each.law(acts), each.inlet)
            if each.grows:
                loads.react.append(_growing(heat, *each.grows))
            else:
                loads.heat = loads.heat + heat
        else:
            commands[each.channel] = given = np.zeros(len(c.time))
            loads.react.append(_thermostat(each, c.setpoints[each.channel], given))
    nodes = simulate(plant.body, plant.dt, loads)
    table: Table = {"time_s": c.rows}
    table |= {name: c.at_rows(values, True) for name, values in commands.items()}
    for name, values in c.beside.items():
        is_part = name == PART
        table[name] = c.at_rows(values, not is_part) + REST * is_part
    table[ROOM] = REST + c.at_rows(c.air)
    for name, weights in plant.outputs.items():
        y = c.at_rows(nodes @ weights)
        for change in (*c.mechanics.get(name, ()), *c.sensors.get(name, ())):
            y = change(c.rows, y)
        table[name] = y + REST * name.endswith("degC")
    for change_all in c.readings:
        table = change_all(table)
    return Course(table, nodes, commands)


def _thermostat(drive: Drive, setpoint: Array, given: Array) -> React:
    """Heat in proportion to what is missing, within what the heater can."""
    assert drive.thermostat is not None
    node, gain = drive.thermostat.node, drive.thermostat.gain

    def react(k: int, here: Array) -> tuple[float, Array]:
        wanted = gain * (setpoint[k] - here[node]) if setpoint[k] else 0.0
        given[k] = np.round(np.clip(wanted, 0.0, drive.largest), 2)
        return 1.0, drive.law(given[k] / drive.largest) * drive.inlet

    return react


def _growing(heat: Array, node: int, share: float) -> React:
    """Heat that is more where its node is warm."""

    def react(k: int, here: Array) -> tuple[float, Array]:
        return 1.0, heat[k] * (1.0 + share * here[node])

    return react


def clean_twin(c: Conditions, clean: Conditions, course: Course) -> Conditions:
    """The clean conditions under the commands that were given in a log with an effect."""
    twin = clean.copy()
    twin.commands, twin.setpoints = dict(course.commands), {}
    twin.rows = c.rows
    return twin


def read(plant: Plant, c: Conditions, course: Course, generator: Generator) -> Table:
    """What is logged: with noise, in steps."""
    quiet = c.copy()
    quiet.readings = []
    table = run(plant, quiet).table if c.readings else dict(course.table)
    for name in (*plant.outputs, ROOM, *([PART] if plant.part else [])):
        noise = plant.noise.get(name, Noise(0.01, 0.0))
        table[name] = table[name] + noise.white * generator.standard_normal(len(c.rows))
        table[name] = table[name] + noise.drift * _wander(c.rows, generator)
        table[name] = noise.step * np.round(table[name] / noise.step)
    for change in c.readings:
        table = change(table)
    return table


def _wander(time: Array, generator: Generator) -> Array:
    """An Ornstein-Uhlenbeck process of deviation 1, its time constant a twentieth of the log."""
    keep = np.exp(-np.diff(time) / (np.ptp(time) / 20))
    normal = generator.standard_normal(len(time))
    course = np.empty(len(time))
    course[0] = normal[0]
    for k, share in enumerate(keep):
        course[k + 1] = share * course[k] + np.sqrt(1 - share**2) * normal[k + 1]
    return course


def as_logged(plant: Plant, table: Table) -> Table:
    """The table under the names and in the units of the machine's own logger."""
    found = {}
    for name, values in table.items():
        other, scale, offset = plant.foreign.get(name, (name, 1.0, 0.0))
        found[other] = (values - offset) / scale
    return found
