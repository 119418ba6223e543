"""Forecasting compensatory control as a stream: error lines in, command lines out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from thermaltool.control.fcc import (
    MAX_READING,
    ActuatorModel,
    ActuatorState,
    Forecaster,
    ForecastingControl,
)
from thermaltool.control.setpoint import Setpoint
from thermaltool.errors import LogError, counted
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.clock_check import ClockCheck, PeriodCheck
from thermaltool.runtime.compensator import SetpointProcess
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.policy import Policy
from thermaltool.runtime.sensing.sensors import SensorChannel
from thermaltool.runtime.settings import ANYTHING, SLEW_PERIODS, Settings
from thermaltool.runtime.stepper import Steps
from thermaltool.timeseries.recursive.arma import RecursiveArma
from thermaltool.timeseries.recursive.direct import DirectForecast

# Where nothing is said, bad readings are bridged and pauses borne for this many samples: as long
# as a forecast of a cut is worth something.
HOLD_PERIODS = 20
# Silence that is answered is not below this [s]: a pipe and a scheduler need some time themselves.
MIN_TIMEOUT = 0.1
SMALLEST = 1e-30  # a reading of nothing
# A modelled action this many times the largest reading is not in the readings.
RUNAWAY = 1e4
ESTIMATES = ("wanted", "uncompensated", "forecast")


@dataclass(frozen=True)
class ErrorModel:
    """How the error without the action is forecast.

    Attributes
    ----------
    order : (p, q) or None
        ARMA(p, q), iterated; None for a direct forecast at the horizon.
    spindle : float [rev/min], str or None
        Speed, or its column; None for nothing that repeats.
    harmonics : int
        What repeats with the spindle, for the direct forecast.
    forgetting : float
        Weight of a sample against the next.
    lags : int
        Differences that the direct forecast uses.
    """

    order: tuple[int, int] | None = None
    spindle: float | str | None = None
    harmonics: int = 6
    forgetting: float = 0.999
    lags: int = 5

    def forecaster(self, horizon: int, period: float) -> Forecaster:
        """It, at so many samples ahead; ValueError where an order is out of range."""
        if self.order is not None:
            return RecursiveArma(*self.order, forgetting=self.forgetting)
        known = self.spindle if isinstance(self.spindle, float) else 0.0
        return DirectForecast(
            horizon,
            self.lags,
            harmonics=0 if self.spindle is None else self.harmonics,
            forgetting=self.forgetting,
            turn=_turn(known, period),
        )


@dataclass
class Controller(Steps):
    """A forecasting control that answers each sample of a `SetpointProcess`.

    The error is the first reading and the speed, where there is one, the second; a reading that
    is held did not come.

    Attributes
    ----------
    control : ForecastingControl
    sensor : SensorChannel
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
    sensor: SensorChannel
    setpoint: Setpoint
    bridged: int = HOLD_PERIODS
    name: str = "<stdin>"
    samples: int = field(default=0, init=False)
    squares: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    at_limit: int = field(default=0, init=False)
    _largest: float = field(default=0.0, init=False)
    _wanted: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        super().__init__()
        self._ticks = max(round(self.control.period / CLOCK_STEP), 1)

    def rest(self) -> list[float]:
        """Estimates before anything is known."""
        return [self.setpoint.value, 0.0, 0.0]

    def start(self, readings: list[float], settled: bool = False) -> list[float]:
        """Estimates at the first readings: the actuator stands where it was put."""
        self.control.forget_lags(self.setpoint.value)
        return self._step(readings)

    def step(self, ticks: int, readings: list[float]) -> list[float]:
        """Wanted command, error without the action, and its forecast."""
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
        good = reading is not None and -MAX_READING < reading < MAX_READING
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
        """Root mean square of the error as read and without the action; nothing of no sample."""
        if not self.samples:
            return ""
        read, without = (math.sqrt(s / self.samples) for s in self.squares)
        text = (
            f"{self.samples} samples: error {read:.3g} RMS as read, {without:.3g} RMS without the "
            f"action (reconstructed), horizon {self.control.horizon} samples"
        )
        if self.control.gate.refused:
            text += f"; {counted(self.control.gate.refused, 'reading')} stood alone, bridged"
        if self.at_limit:
            text += f"; at the limit in {self.at_limit / self.samples:.1%} of the samples"
        return text

    def state(self) -> list[float]:
        """Nothing: learnt anew in a second or two."""
        return []

    def resume(self, values: list[Any]) -> None:
        """There is nothing to go on from."""


def error_control(
    channel: str,
    command: str,
    actuator: ActuatorModel,
    error_model: ErrorModel,
    settings: Settings,
    messages: Messages,
    horizon: int = 0,
) -> SetpointProcess:
    """Commands that cancel an error ahead of the actuator's delay.

    Parameters
    ----------
    channel, command : str
        Column of the error, and name of the command.
    actuator : ActuatorModel
    error_model : ErrorModel
    settings : Settings
        With the sample period, which the lines have to keep.
    messages : Messages
    horizon : int
        Samples ahead at which the error is to be zero; 0 for the actuator's own.

    Raises
    ------
    ValueError
        A horizon within the delay, a safe command outside the limits, or the like.
    """
    period = settings.period
    assert period is not None
    usual = HOLD_PERIODS * period
    hold, max_gap = settings.bridged(usual)
    # At rest the actuator stands where the safe command has it.
    setpoint = settings.setpoint(settings.limits, "command")
    columns = [channel]
    if isinstance(error_model.spindle, str):
        columns.append(error_model.spindle)
    sensors = [
        SensorChannel(
            column,
            bounds=settings.ranges.get(column, ANYTHING),
            hold=hold,
            report=messages,
            at_rest=False,
        )
        for column in columns
    ]
    horizon = horizon or ActuatorState(actuator, period).default_horizon()
    forecaster = error_model.forecaster(horizon, period)
    control = ForecastingControl(actuator, forecaster, period, horizon, setpoint.value)
    name = messages.source
    controller = Controller(control, sensors[0], setpoint, round(max_gap / period), name)
    return SetpointProcess(
        controller,
        sensors,
        [0],
        [setpoint],
        Policy(period, 1.0, settings.safe, SLEW_PERIODS * period),
        ClockCheck(
            messages, hold, max_gap=max_gap, expected=period, period=PeriodCheck(period, name)
        ),
        messages,
        names=[command],
        estimates=ESTIMATES if settings.estimates else (),
        patience=max(usual, MIN_TIMEOUT),
        clock_advice="--clock none counts one --period for each line",
        summary=controller.summary,
    )


def _turn(speed: float, period: float) -> float:
    """Angle of the spindle per sample [rad] at so many revolutions per minute."""
    return 2 * math.pi * speed / 60 * period
