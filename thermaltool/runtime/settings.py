"""From a model and the user's settings to a stream."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from thermaltool.control.heaters import Stabilizer, parts_of
from thermaltool.control.setpoint import Limits, Setpoint
from thermaltool.errors import ModelError
from thermaltool.estimation.pipeline import EstimatorPipeline, InputColumn
from thermaltool.estimation.variable_cooling import VariableCoolingEstimator
from thermaltool.model import Model
from thermaltool.runtime.checkpoint import Checkpoint, design_digest
from thermaltool.runtime.compensator import Compensator, Pass, Policy
from thermaltool.runtime.heaters import LEAD_PERIODS, HeaterStepper, held_output, powers
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.records import open_records
from thermaltool.runtime.sensors import ANYTHING, Interval, Report, Sensor
from thermaltool.runtime.stepper import Stepper, VariableCoolingStepper
from thermaltool.runtime.stream import Stream, Writer

Format = Literal["csv", "ndjson"]

# Where nothing is said, readings are held and pauses borne for this many sample periods of the
# design, and not below `LEAST_HOLD` [s].
HOLD_PERIODS, LEAST_HOLD = 10, 10.0
# For the slew rate a pause counts as this many sample periods at the most.
SLEW_PERIODS = 2
# Arrival times are rounded to this [s].
ARRIVAL_STEP = 1e-3


@dataclass(frozen=True)
class Settings:
    """What the user may choose; setpoints in their own unit, times in s.

    Attributes
    ----------
    sign : float
        Setpoint over deflection: -1 for an offset that cancels it.
    safe : float or None
        The safe setpoint; None holds the last one.
    hold, max_gap, timeout : float or None
        Of readings, of the slew rate's patience, of the watchdog; None for `default_hold`.
    frozen_after : float
    ranges : mapping of channel to (low, high)
        Of readings as they come, in place of the calibrated range of the model, widened by its
        width to both sides.
    limits : (low, high)
    slew, step : float
        Rate and quantizer of the setpoints; inf and 0 for none.
    period : float or None
        Of an input without a clock.
    arrival : bool
        The clock is the time of arrival.
    columns : str or None
        File of a column map.
    from_format, to_format : "csv" or "ndjson"
    estimates : bool
        Whether heat and deflections are written too.
    settled : bool
        The machine has stood at the first readings for long; else it is at rest there.
    checkpoint : str or None
    checkpoint_every : float
    heater : str or None
        The drive that is set so that an output stays at zero, in place of offsets. No design is
        needed then.
    target : str or None
        That output; None for the model's only deflection.
    lead : float or None
        How far it is foretold [s]; None for two sample periods.
    """

    sign: float = -1.0
    safe: float | None = 0.0
    hold: float | None = None
    max_gap: float | None = None
    timeout: float | None = None
    frozen_after: float = math.inf
    ranges: Mapping[str, Interval] = field(default_factory=dict)
    limits: Interval = ANYTHING
    slew: float = math.inf
    step: float = 0.0
    period: float | None = None
    arrival: bool = False
    columns: str | None = None
    from_format: Format = "csv"
    to_format: Format = "csv"
    estimates: bool = False
    settled: bool = False
    checkpoint: str | None = None
    checkpoint_every: float = 10.0
    heater: str | None = None
    target: str | None = None
    lead: float | None = None


@dataclass(frozen=True)
class Loop:
    """What makes setpoints of readings.

    Attributes
    ----------
    compensator : Compensator
    columns : tuple of str
        That are read.
    names, told : list of str
        Of the setpoints, and of the estimates.
    digest : str
        Tells a checkpoint of this loop from others.
    """

    compensator: Compensator
    columns: tuple[str, ...]
    names: list[str]
    told: list[str]
    digest: str


def default_hold(period: float) -> float:
    """How long the last good value stands in, where the user does not say [s]."""
    return max(LEAST_HOLD, HOLD_PERIODS * period)


def setpoint_name(channel: str) -> str:
    """The setpoint that cancels a deflection: ``d_x_um`` gives ``offset_x_um``."""
    return "offset_" + channel.partition("_")[2]


def open_stream(
    model: Model,
    settings: Settings,
    source: int,
    sink: int,
    emit: Callable[[str], None],
    name: str = "<stdin>",
) -> Stream:
    """The stream of `model` between two file descriptors; nothing is read or written yet.

    Parameters
    ----------
    model : Model
    settings : Settings
    source, sink : int
        File descriptors.
    emit : callable
        Gets each message, one line.
    name : str
        What messages call the source.

    Raises
    ------
    ModelError
        No design, one for other parameters, no deflection to cancel, or a range for a channel
        that is no sensor.
    LogError
        The column map cannot be read.
    ValueError
        Limits without a multiple of the step between them, or a safe setpoint outside.
    """
    period = _period(model, settings)
    timeout = default_hold(period) if settings.timeout is None else settings.timeout
    messages = Messages(emit, name)
    loop = (_offsets if settings.heater is None else _heater)(model, settings, period, messages)
    return Stream(
        pipe=LinePipe(source, sink),
        records=open_records(
            settings.from_format,
            loop.columns,
            settings.columns,
            settings.period,
            arrival=ARRIVAL_STEP if settings.arrival else None,
            mend="--period gives one to a stream without, --clock arrival takes the time of "
            "arrival",
        ),
        writer=Writer(
            settings.to_format, [*loop.names, *(loop.told if settings.estimates else ())]
        ),
        compensator=loop.compensator,
        messages=messages,
        estimates=settings.estimates,
        timeout=timeout or math.inf,
        tick=period,
        checkpoint=Checkpoint(settings.checkpoint, loop.digest) if settings.checkpoint else None,
        checkpoint_every=settings.checkpoint_every,
    )


def _period(model: Model, settings: Settings) -> float:
    """That of regularize --dt, which may not be that of the calibration; of a heater the latter."""
    period = settings.period or model.sample_period
    if not settings.period and settings.heater is None:
        period = float(model.estimator_design().get("sample_period_s", period))
    if not 0 < period < math.inf:
        raise ModelError("sample_period_s of the design is not above 0")
    return period


def _offsets(model: Model, settings: Settings, period: float, messages: Messages) -> Loop:
    """Offsets that cancel the deflections which the model's design estimates."""
    pipeline = EstimatorPipeline.of(model)
    estimator = pipeline.estimator
    deflections = {output.channel for output in model.deflections}
    followed = [k for k, name in enumerate(estimator.estimates) if name in deflections]
    if not followed:
        raise ModelError("the model's design estimates no deflection: nothing to compensate")
    setpoints = [_setpoint(settings.limits, settings) for _ in followed]
    policy = _policy(settings, period, settings.sign)
    compensator = Compensator(
        VariableCoolingStepper(estimator, period)
        if isinstance(estimator, VariableCoolingEstimator)
        else Stepper(estimator, period),
        _sensors(pipeline.input_columns, policy.hold, settings, messages),
        followed,
        setpoints,
        policy,
        messages,
        **_around(pipeline),
    )
    names = [setpoint_name(estimator.estimates[k]) for k in followed]
    told = list(estimator.estimates)
    return Loop(compensator, pipeline.columns, names, told, design_digest(model.estimator_design()))


def _heater(model: Model, settings: Settings, period: float, messages: Messages) -> Loop:
    """The power of a heater that holds an output at zero."""
    assert settings.heater is not None
    target = held_output(model, settings.target)
    parts_of(model, settings.heater, target)
    limits = powers(model, settings.heater, settings.limits)
    lead = LEAD_PERIODS * period if settings.lead is None else settings.lead
    stabilizer = Stabilizer(model, settings.heater, target, limits, lead)
    inputs = tuple(
        InputColumn(d.channel, d.reference, d.range, False, d.hold == "zero")
        for d in stabilizer.read
    )
    setpoint, policy = _setpoint(limits, settings), _policy(settings, period, 1.0)
    compensator = Compensator(
        HeaterStepper(stabilizer, lambda: setpoint.value),
        _sensors(inputs, policy.hold, settings, messages),
        [0],
        [setpoint],
        policy,
        messages,
    )
    digest = {"heater": settings.heater, "lead": lead, "parameters": model.parameters_digest(),
              "target": target}  # fmt: skip
    told = [f"wanted_{settings.heater}", target]
    columns = tuple(each.column for each in inputs)
    return Loop(compensator, columns, [settings.heater], told, design_digest(digest))


def _policy(settings: Settings, period: float, sign: float) -> Policy:
    hold = default_hold(period) if settings.hold is None else settings.hold
    max_gap = default_hold(period) if settings.max_gap is None else settings.max_gap
    # A stall must not save up way for one large step.
    slew_gap = SLEW_PERIODS * period if settings.max_gap is None else settings.max_gap
    return Policy(sign, settings.safe, hold, max_gap, slew_gap, settings.settled)


def _setpoint(limits: Interval, settings: Settings) -> Setpoint:
    allowed = Limits(*limits)
    if settings.safe is not None and allowed.clip(settings.safe) != settings.safe:
        raise ValueError(f"the safe setpoint {settings.safe:g} is outside the limits")
    return Setpoint(allowed, settings.slew, settings.step, settings.safe or 0.0)


def _around(pipeline: EstimatorPipeline) -> dict[str, Pass]:
    """What a sample passes before and behind the estimator; nothing where no effect is there."""
    around: dict[str, Pass] = {}
    if not pipeline.passes_inputs:
        around["inputs"] = pipeline.estimator_inputs
    if any(pipeline.estimate_maps):
        around["told"] = pipeline.given_out
    return around


def _sensors(
    inputs: Sequence[InputColumn], hold: float, settings: Settings, report: Report
) -> list[Sensor]:
    """The columns that are read, with their rest and range from the model."""
    columns = [each.column for each in inputs]
    for channel in settings.ranges:
        if channel not in columns:
            raise ModelError(
                f"a range for {channel}, but the sensors of the model are {', '.join(columns)}"
            )
    return [
        Sensor(
            each.column,
            rest=math.nan if each.rest == "first" else each.rest,
            calibrated=each.calibrated or ANYTHING,
            bounds=settings.ranges.get(each.column),
            hold=hold,
            # What is commanded may well stand still.
            frozen_after=math.inf if each.commanded else settings.frozen_after,
            report=report,
            back=each.to_true,
            at_rest=each.sensor,
        )
        for each in inputs
    ]
