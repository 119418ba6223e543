"""Test logs of the plants: what drives them, the simulation, and what the sensors read."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.plants import PLANTS, SettingError, build
from thermaltool.plants.boring_bar import PARTS
from thermaltool.plants.duties import DUTIES, settings
from thermaltool.plants.duties import air as air_course
from thermaltool.plants.excitation import INPUTS, hold, sample_times
from thermaltool.plants.heated import HEATERS, POWERS, SENSORS
from thermaltool.plants.noise import Sensor, read_sensors

Array = NDArray[np.float64]
Columns = dict[str, Array]
AIR, HEAT, COMMAND = "T_ambient_degC", "Q_main_1", "U_command_V"


class InputLog(Protocol):
    """What is taken of a log."""

    @property
    def time(self) -> Array: ...
    @property
    def columns(self) -> Mapping[str, Array]: ...
    @property
    def name(self) -> str: ...


class Read(Protocol):
    """From a file, or ``-`` for stdin, and the channels that it must have to a log."""

    def __call__(self, source: str, /, *, need: Sequence[str]) -> InputLog: ...


def run(
    name: str, options: Mapping[str, Any], read: Read, echo: Callable[[str], None]
) -> tuple[Columns, str]:
    """A test log of the plant called `name`.

    Parameters
    ----------
    name : str
        A key of `thermaltool.plants.PLANTS`.
    options : mapping of str to value
        All that it takes: `thermaltool.plants.COMMON` and its `Offer.options`; what is None is
        as usual.
    read : Read
    echo : callable
        Writes a line of a closed loop.

    Returns
    -------
    columns : dict of channel to ndarray, shape (n,)
    fault : str
        Why the log ends before its time, or nothing.

    Raises
    ------
    SettingError
        An option beyond what the plant can do.
    LogError
        As `read`; commands of a loop without their column.
    """
    runs = {"frame": _frame, "knee-mill": _frame, "boring-bar": _boring_bar}
    given = {**options, **{k: v for k, v in PLANTS[name].usual.items() if options[k] is None}}
    return runs.get(name, _heated)(name, given, read, echo)


def _frame(
    name: str, given: Mapping[str, Any], read: Read, echo: Callable[[str], None]
) -> tuple[Columns, str]:
    """A structure with one heater."""
    time, since = _clock(given)
    air = np.full_like(time, given["ambient"])
    if given["shape"] in INPUTS:
        heat = INPUTS[given["shape"]](since, given["seed"])
    else:
        (heat,), air = _from_log(name, given["shape"], read, (HEAT,), since, air)
    heat = np.round(given["level"] * heat, 6)
    load = {"load": given["load"]} if "load" in PLANTS[name].options else {}
    outputs: Columns = build(name).simulate(heat, air, given["dt"], **load)
    if not given["clean"]:
        temperature = Sensor(given["sigma"], given["drift"], given["drift_time"], decimals=3)
        displacement = Sensor(given["sigma_d"], decimals=2)
        sensors = {"degC": temperature, "K": temperature, "um": displacement}
        outputs = read_sensors(outputs, sensors, given["dt"], given["seed"])
    return {"time_s": time, HEAT: heat, AIR: air, **outputs}, ""


def _heated(
    name: str, given: Mapping[str, Any], read: Read, echo: Callable[[str], None]
) -> tuple[Columns, str]:
    """A structure with two heaters."""
    time, since = _clock(given)
    plant, seed = build(name), given["seed"]
    full, power, heater = plant.regulators[0].full, given["power"], given["heater"]
    if power is not None and power > full:
        raise SettingError(f"{name} has {full:g} W", "--power")
    air = air_course(time, given["ambient"], given["swing"], seed)
    if given["shape"] in DUTIES:
        on = heater != HEATERS[1], heater in (HEATERS[1], "both")
        powers = settings(given["shape"], on, full if power is None else power, since, seed)
    elif heater is None and power is None:
        held, air = _from_log(name, given["shape"], read, POWERS, since, air)
        powers = np.column_stack(held)
    else:
        raise SettingError("--heater and --power are for shapes: a log has its own powers")
    outputs: Columns = {AIR: air, **plant.simulate(powers, air, given["dt"])}
    if not given["clean"]:
        outputs = read_sensors(outputs, SENSORS, given["dt"], seed)
    return {"time_s": time, **dict(zip(POWERS, powers.T, strict=True)), **outputs}, ""


def _boring_bar(
    name: str, given: Mapping[str, Any], read: Read, echo: Callable[[str], None]
) -> tuple[Columns, str]:
    """A cut in open loop, or one that a pipe of commands answers line by line."""
    bar, part, speed = build(name), PARTS[given["part"]], given["speed"]
    period, commands, seed = bar.parameters.period, given["commands"], given["seed"]
    samples = len(_times(given["duration"], period)) - 1
    if commands is None:
        return bar.cut(part, speed, samples, seed=seed).columns(speed), ""
    if stat.S_ISFIFO(os.stat(commands).st_mode):
        # The header goes out first: the controller opens its end when it has something to say.
        echo("time_s,n_spindle_rpm,e_tool_um")
        with open(commands, encoding="utf-8") as answers:
            loop = _Loop(answers, echo, speed, period)
            record = bar.cut(part, speed, samples, loop.answer, seed)
        fault = f"{loop.fault}: {record.time.size} of {samples} samples" if loop.fault else ""
        return record.columns(speed), fault
    volts = read(commands, need=(COMMAND,)).columns[COMMAND]
    waiting = iter([*volts.tolist(), *[float(volts[-1])] * max(samples - len(volts), 0)])
    return bar.cut(part, speed, samples, lambda reading: next(waiting), seed).columns(speed), ""


def _clock(given: Mapping[str, Any]) -> tuple[Array, Array]:
    """Time from the first row, and from the start of the input [s]."""
    time = _times(given["duration"], given["dt"])
    return time, np.round(time - given["start"], 9)


def _times(duration: float, dt: float) -> Array:
    if duration < dt:
        raise SettingError(
            f"{duration:g} s is shorter than the sample period of {dt:g} s", "--duration"
        )
    return sample_times(duration, dt)


def _from_log(
    name: str, source: str, read: Read, channels: Sequence[str], since: Array, air: Array
) -> tuple[list[Array], Array]:
    """Inputs, and the air where the log has it, held between its rows."""
    if source != "-" and not os.path.exists(source):
        shapes = ", ".join(PLANTS[name].inputs)
        raise SettingError(f"{source!r} is no file and none of {shapes}", "--input")
    log = read(source, need=channels)
    if not len(log.time):
        raise LogError("no rows to take the heat from", log.name)
    elapsed = log.time - log.time[0]
    inputs = [hold(since, elapsed, log.columns[channel], before=0.0) for channel in channels]
    if AIR in log.columns:
        measured = log.columns[AIR]
        air = hold(since, elapsed, measured, before=measured[0])
    return inputs, air


class _Loop:
    """Lines out and commands in; `fault` tells why they have ended before the cut."""

    fault = ""

    def __init__(
        self, answers: IO[str], echo: Callable[[str], None], speed: float, period: float
    ) -> None:
        self._answers, self._echo, self._speed, self._period = answers, echo, speed, period
        self._count = 0
        self._at = -1

    def answer(self, reading: float) -> float | None:
        try:
            self._echo(f"{self._count * self._period:.10g},{self._speed:g},{reading!r}")
        except BrokenPipeError:
            self.fault = "nobody reads the lines any more"
            return None
        self._count += 1
        fields = self._fields()
        if self._at < 0 and fields is not None:
            if COMMAND not in fields:
                raise LogError(f"no column {COMMAND}", self._answers.name)
            self._at = fields.index(COMMAND)
            fields = self._fields()
        if fields is None:
            self.fault = "the commands have ended before the cut"
            return None
        try:
            return float(fields[self._at])
        except (IndexError, ValueError):
            self.fault = f"line {self._count + 1} is no command"
            return None

    def _fields(self) -> list[str] | None:
        """Of one line; None where there is none any more."""
        line = self._answers.readline()
        return line.rstrip("\n").split(",") if line else None
