"""Forecasting compensatory control as a stream: error lines in, command lines out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from thermaltool.control.fcc import (
    LARGEST,
    ActuatorModel,
    ActuatorState,
    Forecaster,
    ForecastingControl,
)
from thermaltool.control.setpoint import Limits, Setpoint
from thermaltool.errors import LogError
from thermaltool.responses.modes import CLOCK_STEP
from thermaltool.runtime.clocks import Rate
from thermaltool.runtime.compensator import Compensator, Policy
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.records import open_records
from thermaltool.runtime.sensors import ANYTHING, Interval, Sensor
from thermaltool.runtime.settings import SLEW_PERIODS
from thermaltool.runtime.stream import Stream, Writer
from thermaltool.timeseries.recursive.arma import RecursiveArma
from thermaltool.timeseries.recursive.direct import DirectForecast

# Where nothing is said, bad readings are bridged and pauses borne for this many samples.
HOLD_PERIODS = 20
SMALLEST = 1e-30  # a reading of nothing
# A modelled action this many times the largest reading is not in the readings.
RUNAWAY = 1e4
ALSO = ("wanted", "uncompensated", "forecast")


@dataclass(frozen=True)
class FccSettings:
    """What the user may choose; times in s, commands in their own unit.

    Attributes
    ----------
    channel, command : str
        Column of the error, and name of the command.
    period : float
        Sample period.
    actuator : ActuatorModel
    order : (p, q) or None
        Error model: ARMA(p, q), iterated; None for a direct forecast at the horizon.
    lags : int
        Differences that the direct forecast uses.
    harmonics : int
        What repeats with the spindle, for the direct forecast.
    spindle : float [rev/min], str or None
        Speed, or its column; None for nothing that repeats.
    horizon : int
        Samples ahead at which the error is to be zero; 0 for the model's own.
    forgetting : float
    limits, slew, step, safe
        Of the command, as for `runtime.settings.Settings`.
    hold, max_gap, timeout : float or None
        As there; None for `HOLD_PERIODS` samples.
    bounds : (low, high)
        Of the readings.
    has_clock : bool
        False where each line is one sample after the one before.
    columns : str or None
        File of a column map.
    from_format, to_format : "csv" or "ndjson"
    also : bool
        Whether `ALSO` are written too.
    """

    channel: str
    command: str
    period: float
    actuator: ActuatorModel
    order: tuple[int, int] | None = None
    lags: int = 5
    harmonics: int = 6
    spindle: float | str | None = None
    horizon: int = 0
    forgetting: float = 0.999
    limits: Interval = ANYTHING
    slew: float = math.inf
    step: float = 0.0
    safe: float | None = 0.0
    hold: float | None = None
    max_gap: float | None = None
    timeout: float | None = None
    bounds: Interval = ANYTHING
    has_clock: bool = True
    columns: str | None = None
    from_format: Literal["csv", "ndjson"] = "csv"
    to_format: Literal["csv", "ndjson"] = "csv"
    also: bool = False


@dataclass
class Controller:
    """A forecasting control that answers each sample of a `Compensator`.

    The error is the first reading and the speed, where there is one, the second; a reading that
    is held did not come.

    Attributes
    ----------
    control : ForecastingControl
    sensor : Sensor
        Of the error.
    setpoint : Setpoint
        Tells what was put out in fact.
    bridged : int
        Lacking samples up to which the forecast goes on without them.
    name : str
        What messages call the source.
    samples : int
    squares : (float, float)
        Sums of the squared error as read, and without the action.
    at_limit : int
        Good samples whose wanted command was outside the limits.

    Raises
    ------
    LogError
        Commands run away, as the readings do not follow them.
    """

    control: ForecastingControl
    sensor: Sensor
    setpoint: Setpoint
    bridged: int = HOLD_PERIODS
    name: str = "<stdin>"
    samples: int = field(default=0, init=False)
    squares: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    at_limit: int = field(default=0, init=False)
    _largest: float = field(default=0.0, init=False)
    _wanted: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._rate = Rate(self.control.period, self.name)
        self._ticks = max(round(self.control.period / CLOCK_STEP), 1)

    def rest(self) -> list[float]:
        return [self.setpoint.value, 0.0, 0.0]

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        self.control.forget_lags(self.setpoint.value)
        return self._step(readings)

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Wanted command, error without the action, and its forecast."""
        self._rate.take(ticks * CLOCK_STEP)
        lacking = round(ticks / self._ticks) - 1
        if lacking > self.bridged:
            self.control.forget_lags(self.setpoint.value)
        else:
            for _ in range(lacking):
                self.control.step(None, self.setpoint.value)
        return self._step(readings)

    def _step(self, readings: list[float]) -> list[float]:
        forecaster = self.control.forecaster
        if len(readings) > 1 and isinstance(forecaster, DirectForecast):
            forecaster.turn = _turn(readings[1], self.control.period)
        reading = None if self.sensor.held else readings[0]
        taken, limits = self.setpoint.value, self.setpoint.limits
        refused, at_limit = self.control.gate.refused, limits.clip(self._wanted) != self._wanted
        answer = self.control.step(reading, taken)
        self._wanted = answer.wanted
        good = reading is not None and -LARGEST < reading < LARGEST
        if reading is not None and good and self.control.gate.refused == refused:
            # At first the action stands for all that the gauge may come to read.
            size = max(abs(reading), 0.0 if self.samples else abs(answer.error))
            self.samples += 1
            self.at_limit += at_limit
            read, without = self.squares
            self.squares = read + reading * reading, without + answer.error * answer.error
            self._largest = max(self._largest, size)
        if not abs(answer.error) <= RUNAWAY * max(self._largest, SMALLEST):
            raise LogError(
                "the commands run away: the readings do not follow them (actuator off, a log of "
                "the past, or wrong --gain or --delay)",
                self.name,
            )
        return [*answer]

    def summary(self) -> str:
        """Root mean square of the error as read, and of what it would have been."""
        read, without = (math.sqrt(s / self.samples) if self.samples else 0.0 for s in self.squares)
        told = (
            f"{self.samples} samples: error {read:.3g} RMS as read, {without:.3g} RMS without the "
            f"action (reconstructed), horizon {self.control.horizon} samples"
        )
        if self.control.gate.refused:
            told += f"; {self.control.gate.refused} readings stood alone and were bridged"
        if self.samples and self.at_limit:
            told += f"; at the limit in {self.at_limit / self.samples:.1%} of the samples"
        return told

    def state(self) -> list[float]:
        """Nothing: learnt anew in a second or two."""
        return []

    def resume(self, values: list[Any]) -> None:
        """There is nothing to go on from."""


def open_fcc(
    settings: FccSettings,
    source: int,
    sink: int,
    emit: Callable[[str], None],
    name: str = "<stdin>",
) -> tuple[Stream, Controller]:
    """The stream between two file descriptors; nothing is read or written yet.

    Parameters
    ----------
    settings : FccSettings
    source, sink : int
        File descriptors.
    emit : callable
        Gets each message, one line.
    name : str
        What messages call the source.

    Raises
    ------
    LogError
        The column map cannot be read.
    ValueError
        A horizon within the delay, a safe command outside the limits, or the like.
    """
    period, limits = settings.period, Limits(*settings.limits)
    if settings.safe is not None and limits.clip(settings.safe) != settings.safe:
        raise ValueError(f"the safe command {settings.safe:g} is outside the limits")
    usual = HOLD_PERIODS * period
    hold = usual if settings.hold is None else settings.hold
    max_gap = usual if settings.max_gap is None else settings.max_gap
    timeout = usual if settings.timeout is None else settings.timeout
    messages = Messages(emit, name)
    # At rest the actuator stands where the safe command has it.
    setpoint = Setpoint(limits, settings.slew, settings.step, settings.safe or 0.0)
    sensors = [_sensor(settings.channel, settings.bounds, hold, messages)]
    if isinstance(settings.spindle, str):
        sensors.append(_sensor(settings.spindle, ANYTHING, hold, messages))
    horizon = settings.horizon or ActuatorState(settings.actuator, period).default_horizon()
    control = ForecastingControl(
        settings.actuator, _forecaster(settings, horizon), period, horizon, setpoint.value
    )
    controller = Controller(control, sensors[0], setpoint, round(max_gap / period), name)
    compensator = Compensator(
        controller,
        sensors,
        [0],
        [setpoint],
        Policy(1.0, settings.safe, hold, max_gap, SLEW_PERIODS * period),
        messages,
    )
    stream = Stream(
        pipe=LinePipe(source, sink),
        records=open_records(
            settings.from_format,
            tuple(sensor.channel for sensor in sensors),
            settings.columns,
            None if settings.has_clock else period,
            mend="--clock none counts one --period for each line",
        ),
        writer=Writer(settings.to_format, [settings.command, *(ALSO if settings.also else ())]),
        compensator=compensator,
        messages=messages,
        estimates=settings.also,
        timeout=timeout or math.inf,
        tick=period,
    )
    return stream, controller


def _sensor(channel: str, bounds: Interval, hold: float, messages: Messages) -> Sensor:
    return Sensor(channel, bounds=bounds, hold=hold, report=messages, at_rest=False)


def _turn(speed: float, period: float) -> float:
    """Angle of the spindle per sample [rad] at so many revolutions per minute."""
    return 2 * math.pi * speed / 60 * period


def _forecaster(settings: FccSettings, horizon: int) -> Forecaster:
    if settings.order is not None:
        return RecursiveArma(*settings.order, forgetting=settings.forgetting)
    harmonics = 0 if settings.spindle is None else settings.harmonics
    known = settings.spindle if isinstance(settings.spindle, float) else 0.0
    return DirectForecast(
        horizon,
        settings.lags,
        harmonics=harmonics,
        forgetting=settings.forgetting,
        turn=_turn(known, settings.period),
    )
