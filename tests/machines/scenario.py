"""A log of the lumped machine: its schedules, and every place where a fault may act on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from machines.network import BEARING, NODES, OUTPUTS, REST, Network
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.plants.excitation import held
from thermaltool.plants.noise import Sensor, ornstein_uhlenbeck, read_sensors
from thermaltool.units import parse_channel

Array = NDArray[np.float64]
Generator = np.random.Generator
Table = dict[str, Array]
Parameters = dict[str, float]
Change = Callable[[Array], Array]

DRIVE = "Q_main_1"
AIR, PART = "T_ambient_degC", "T_part_degC"
BEARING_HEAT, COOLANT, SPEED = "Q_bearing_1", "x_coolant_1", "n_spindle_rpm"
SENSORS = tuple(name for name in OUTPUTS if not name.endswith("_um"))
DEFLECTIONS = tuple(name for name in OUTPUTS if name.endswith("_um"))

_LENGTH = 1500, 2500  # samples of a log
_PERIOD = 2.0, 5.0  # sample period [s]
_COVERED = 3.0  # length of a log in slowest time constants, where the samples allow it
_HOLDS = 0.013, 0.13  # how long a level is held, as a share of the log
_WANDER = 0.3  # amplitude of the ordinary course of the hall's temperature [K]


@dataclass
class Run:
    """A log about to be simulated; a fault changes it at the place where it acts.

    Parameters
    ----------
    network : Network
    time : (m,) ndarray
        Evenly spaced [s].
    columns : dict of str to (m,) ndarray
        True values of what is logged beside the outputs.
    drive : list of functions
        From command to heat, each relative to full drive, one after the other.
    heat : (m, n) ndarray
        Heat into the nodes beside that of the drive [W].
    film : (m,) ndarray
        Film coefficient relative to its usual one.
    exposure : float
        Share of the surfaces that the air of the hall reaches; the rest is in an enclosure of
        constant temperature.
    emissivity : float
    mechanics, sensors : list of (channel, function)
        From one deflection to what is there to be measured, from a truth to what its sensor says.
    readings : list of functions
        From the table of all readings to the one that is logged.
    """

    network: Network
    time: Array
    columns: Table
    drive: list[Change] = field(default_factory=list)
    heat: Array = field(init=False)
    film: Array = field(init=False)
    exposure: float = 0.0
    emissivity: float = 0.0
    mechanics: list[tuple[str, Change]] = field(default_factory=list)
    sensors: list[tuple[str, Change]] = field(default_factory=list)
    readings: list[Callable[[Table], Table]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.heat = np.zeros((len(self.time), NODES))
        self.film = np.ones(len(self.time))

    @property
    def dt(self) -> float:
        return float(self.time[1] - self.time[0])

    def simulate(self) -> Table:
        """Outputs as they would be logged without noise."""
        outputs = self._sensed()
        for change in self.readings:
            outputs = change(outputs)
        return outputs

    def read(self, noise: dict[str, Sensor], seed: int) -> Table:
        """What is logged: time, columns and outputs, with noise."""
        table = read_sensors(self.columns | self._sensed(), noise, self.dt, seed)
        for change in self.readings:
            table = change(table)
        return {"time_s": self.time} | table

    def _sensed(self) -> Table:
        """Outputs as the sensors turn them out."""
        command = self.columns[DRIVE]
        for act in self.drive:
            command = act(command)
        heat = self.heat.copy()
        heat[:, BEARING] += self.network.power * command
        air = self.exposure * (self.columns[AIR] - self.columns[AIR][0])
        temperature = self.network.simulate(heat, self.dt, self.film, air, self.emissivity)
        outputs = dict(zip(OUTPUTS, self.network.rows @ temperature.T, strict=True))
        for name, change in (*self.mechanics, *self.sensors):
            outputs[name] = change(outputs[name])
        return {name: y + REST * name.endswith("degC") for name, y in outputs.items()}


@dataclass(frozen=True)
class Fault:
    """A fault with its place and time drawn, but not yet its strength.

    Strength zero changes nothing; which strength gives a wanted size is searched elsewhere.

    Parameters
    ----------
    channel : str or None
        What a diagnosis should name: the drive, a sensor, another column; None where the column
        is not logged, or none is meant.
    apply : function
        Of strength and run: changes the run, returns the true parameters.
    most : float
        Largest strength that makes sense; None where the fault has no strength.
    unlogged : str or None
        Column that the log goes without.
    """

    channel: str | None
    apply: Callable[[float, Run], Parameters]
    most: float | None = np.inf
    unlogged: str | None = None


def either_sign(generator: Generator) -> float:
    return float(generator.choice([-1.0, 1.0]))


def moment(run: Run, generator: Generator) -> float:
    """A sample in the middle 60 % of the log [s]."""
    return float(run.time[int(len(run.time) * generator.uniform(0.2, 0.8))])


def sensors_of(machine_seed: int) -> dict[str, Sensor]:
    """Sensors of a machine, by unit."""
    generator = np.random.default_rng([machine_seed, 102])
    drift, white = generator.uniform(0.005, 0.01), generator.uniform(0.05, 0.1)
    warm = Sensor(white=0.02, drift=drift, decimals=3)
    return {"K": warm, "degC": warm, "um": Sensor(white=white, drift=0.3 * white, decimals=3)}


def noise_of(name: str, sensors: dict[str, Sensor]) -> float:
    """Standard deviation of all noise on a channel, in its unit."""
    sensor = sensors[parse_channel(name).unit]
    return float(np.hypot(sensor.white, sensor.drift))


def new_run(
    network: Network, key: tuple[int, ...], calibrating: bool = False, full: float = 1.0
) -> Run:
    """Schedules of a log, from rest: of a calibration, or of a random duty.

    `key` seeds them; every column draws from its own stream. The drive goes up to `full`.
    """
    low, high = _PERIOD
    covered = _COVERED * network.slowest
    dt = round(float(np.clip(covered / 2000, low, high)), 1)
    time = np.round(dt * np.arange(int(np.clip(covered / dt, *_LENGTH))), 6)
    streams = [np.random.default_rng([*key, 103, int(calibrating), k]) for k in range(6)]
    drive = _staircase if calibrating else _duty
    columns = {
        DRIVE: full * drive(time, streams[0]),
        AIR: REST + hall(time, _WANDER, streams[1]),
        PART: REST + _parts(time, streams[2]),
        BEARING_HEAT: _switched(time, streams[3]),
        COOLANT: _switched(time, streams[4]),
        SPEED: _switched(time, streams[5], (1500.0, 3000.0, 6000.0)),
    }
    return Run(network, time, columns)


def hall(time: Array, amplitude: float, generator: Generator) -> Array:
    """Temperature of a hall [K] about its mean: part of a day's swing, and slow wandering."""
    period = generator.uniform(0.6, 1.6) * time[-1]
    swing = np.sin(2 * np.pi * (time / period + generator.random()))
    wander = ornstein_uhlenbeck(len(time), time[1] - time[0], 0.3, time[-1] / 15, generator)
    # Air has a heat capacity too: its course has no corners.
    weight = (time[1] - time[0]) / (time[-1] / 100)
    smooth = lfilter([weight], [1.0, weight - 1.0], wander)
    course: Array = amplitude * (swing + smooth)
    return course


def _levels(time: Array, lengths: list[float], levels: list[float]) -> Array:
    """Levels, each held for its length [s]; the last one to the end."""
    return held(time, zip(levels, [*lengths[:-1], np.inf], strict=True))


def _staircase(time: Array, generator: Generator) -> Array:
    """Steps of several levels, a long hold, cooling down, steps again."""
    # Levels spread over the whole range in random order: a calibration goes through it.
    levels = np.round(generator.permutation(np.linspace(0.25, 1.0, 6)), 2)
    lengths = time[-1] * generator.dirichlet(np.full(6, 4.0))
    hold, rest = 0.25, 0.2
    return _levels(
        time,
        [*(0.4 * lengths[:4]), hold * time[-1], rest * time[-1], *(0.4 * lengths[4:])],
        [*levels[:4], float(generator.choice([0.8, 0.9, 1.0])), 0.0, *levels[4:]],
    )


def _duty(time: Array, generator: Generator) -> Array:
    """Random levels, about one in four off, each held for a random time."""
    lengths: list[float] = []
    levels: list[float] = []
    while sum(lengths) < time[-1]:
        lengths.append(_holding(time, generator))
        off = bool(levels and levels[-1]) and generator.random() < 0.25
        levels.append(0.0 if off else round(generator.uniform(0.2, 1.0), 2))
    # Whatever else is drawn, a log has full drive, low drive and none.
    places = generator.permutation(len(levels))
    for place, level in zip(places[:3], (1.0, 0.3, 0.0), strict=True):
        levels[place] = level
    return _levels(time, lengths, levels)


def _switched(
    time: Array,
    generator: Generator,
    on: tuple[float, ...] = (1.0,),
) -> Array:
    """Off and on by turns, off first, each held for a random time."""
    lengths: list[float] = []
    levels: list[float] = []
    while sum(lengths) < time[-1]:
        lengths.append(_holding(time, generator))
        levels.append(float(generator.choice(on)) if len(levels) % 2 else 0.0)
    return _levels(time, lengths, levels)


def _holding(time: Array, generator: Generator) -> float:
    """How long a level is held [s]."""
    return float(time[-1] * np.exp(generator.uniform(*np.log(_HOLDS))))


def _parts(time: Array, generator: Generator) -> Array:
    """Temperature of the part above rest [K]: a new one comes in warm or cold, and settles."""
    course = np.zeros_like(time)
    start = 0.0
    while start < time[-1]:
        length = time[-1] * generator.uniform(0.1, 0.35)
        settled, arriving = generator.uniform(-1.0, 2.0), generator.uniform(-5.0, 8.0)
        since = (time - start) / generator.uniform(0.05, 0.15) / time[-1]
        here = (time >= start) & (time < start + length)
        course[here] = (settled + (arriving - settled) * np.exp(-since))[here]
        start += length
    return course
