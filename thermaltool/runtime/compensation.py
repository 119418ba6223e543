"""From a model to the process that compensates: offsets, or the power of a heater."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from thermaltool.control.actuation import DEVIATION
from thermaltool.control.controller import HeaterController
from thermaltool.control.heaters import Stabilizer, parts_of, powers
from thermaltool.control.law_choice import linear_estimator
from thermaltool.control.setpoint import Limits, Setpoint
from thermaltool.documents import content_digest
from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import Estimator, KalmanEstimator
from thermaltool.estimation.forms import linear_kalman
from thermaltool.estimation.pipeline import EstimatorPipeline, InputColumn
from thermaltool.estimation.plausible_change import plausible_changes, reach_of, white_noise_of
from thermaltool.estimation.settling_time import REMAINDER
from thermaltool.estimation.start import drive_levels
from thermaltool.model import Model, Term
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.clock_check import LONGEST_PAUSE, ClockCheck
from thermaltool.runtime.compensator import SetpointProcess
from thermaltool.runtime.heater_control import ControlProcess, ControlStepper
from thermaltool.runtime.heaters import LEAD_PERIODS, HeaterStepper, held_output
from thermaltool.runtime.messages import Messages, Report
from thermaltool.runtime.policy import Policy
from thermaltool.runtime.sensing.frozen import FrozenCheck
from thermaltool.runtime.sensing.leave_one_out import LeaveOneOut
from thermaltool.runtime.sensing.sensors import SensorChannel
from thermaltool.runtime.sensing.substitute import Substituting
from thermaltool.runtime.sensing.vote import (
    CONTRADICTION,
    NOISE_MARGIN,
    PATIENCE,
    PATIENCE_PERIODS,
    Vote,
)
from thermaltool.runtime.settings import ANYTHING, SLEW_PERIODS, Settings
from thermaltool.runtime.stepper import Stepper, Steps, stepper_of

if TYPE_CHECKING:
    from thermaltool.runtime.monitor import Monitor

# Where nothing is said, readings are held and pauses borne for this many sample periods of the
# design, and not below this [s]: one lost line of a slow logger is no loss, nor are ten of a quick.
HOLD_PERIODS, MIN_HOLD = 10, 10.0
# Filters agree whose deflections differ by less than this part of the calibrated range.
AGREEMENT = 0.01
# So many sensors at least can say which one is wrong: of two that differ, either may be.
MIN_VOTERS = 3
# On a slow disk the newest state may be so many times older than its interval.
LATE_SAVES = 10
CLOCK_ADVICE = "--period gives one to a stream without, --clock arrival takes the time of arrival"


def default_hold(period: float) -> float:
    """How long the last good value stands in, where the user does not say [s]."""
    return max(MIN_HOLD, HOLD_PERIODS * period)


def setpoint_name(channel: str) -> str:
    """The setpoint that cancels a deflection: ``d_x_um`` gives ``offset_x_um``."""
    return "offset_" + channel.partition("_")[2]


def offsets(
    model: Model,
    settings: Settings,
    messages: Messages,
    sign: float = -1.0,
    settled: bool = False,
) -> SetpointProcess:
    """Offsets that cancel the deflections which the model's design estimates.

    Parameters
    ----------
    model : Model
    settings : Settings
    messages : Messages
    sign : float
        Setpoint over deflection: -1 for an offset that cancels it.
    settled : bool
        The machine has stood at the first readings for long; else it is at rest there.

    Raises
    ------
    ModelError
        No design, one for other parameters, no deflection to cancel, or a range for a channel
        that is no sensor.
    ValueError
        Limits without a multiple of the step between them, or a safe setpoint outside.
    """
    design = model.estimator_design()
    period = _period(settings, model.design_period())
    pipeline = EstimatorPipeline.of(model)
    estimator = pipeline.estimator
    deflections = {output.channel for output in model.deflections}
    followed = [k for k, name in enumerate(estimator.estimates) if name in deflections]
    if not followed:
        raise ModelError("the model's design estimates no deflection: nothing to compensate")
    stands_in = pipeline.passes_inputs and model.redundancy is not None and not settings.trust
    sensors = _sensors(pipeline.input_columns, period, settings, messages, design, stands_in)
    mapped = any(pipeline.estimate_maps)
    plain = isinstance(estimator, KalmanEstimator) and pipeline.passes_inputs and not mapped
    watch = plain and len(sensors) > 1 and not settings.trust
    ranges = {output.channel: output.range for output in model.deflections}
    stepper: Steps
    if watch:
        stepper = _watched(estimator, period, ranges)
    else:
        stepper = stepper_of(estimator, period)
        if stands_in:
            stepper = _substituting(stepper, pipeline.columns, model)
    return SetpointProcess(
        stepper,
        sensors,
        followed,
        [
            _offset(settings, name, ranges[name])
            for name in (estimator.estimates[k] for k in followed)
        ],
        _policy(settings, period, sign, settled),
        _clock_check(settings, period, messages),
        messages,
        names=[setpoint_name(estimator.estimates[k]) for k in followed],
        estimates=estimator.estimates if settings.estimates else (),
        with_status=settings.status,
        patience=default_hold(period),
        clock_advice=CLOCK_ADVICE,
        digest=content_digest(design),
        inputs=None if pipeline.passes_inputs else pipeline.estimator_inputs,
        outputs=pipeline.given_out if mapped else None,
        vote=_vote(sensors, design, period) if watch and len(sensors) >= MIN_VOTERS else None,
        reduced=[_seen(ranges[estimator.estimates[k]], sign) for k in followed]
        if watch or stands_in
        else (),
        monitor=_monitor(model, pipeline, settings, messages, design, period),
    )


def _monitor(
    model: Model,
    pipeline: EstimatorPipeline,
    settings: Settings,
    report: Report,
    design: Mapping[str, Any],
    period: float,
) -> Monitor | None:
    if not settings.bands and settings.lag is None:
        return None
    # Imported where it is asked for: a stream starts without it.
    from thermaltool.runtime.monitor import Monitor

    estimator = linear_kalman(pipeline.estimator)
    if estimator is not pipeline.estimator or any(pipeline.estimate_maps):
        what = "known columns" if estimator is not pipeline.estimator else "a curve"
        raise ModelError(f"beside {what} a stream has neither standard errors nor late estimates")
    level = drive_levels(model, estimator.drives)
    return Monitor(estimator, design, period, report, bands=settings.bands, lag=settings.lag,
                   level=level)  # fmt: skip


def _offset(settings: Settings, deflection: str, seen: tuple[float, float]) -> Setpoint:
    return settings.setpoint(settings.limits, channel=deflection, seen=seen[1] - seen[0])


def _substituting(stepper: Stepper, columns: Sequence[str], model: Model) -> Substituting:
    assert model.redundancy is not None
    gains: dict[str, dict[str, float]] = {each.channel: {} for each in model.deflections}
    for term in model.terms:
        if (own := gains.get(term.output)) is not None:
            own[term.drive] = own.get(term.drive, 0.0) + term.response.dc_gain()
    return Substituting(stepper, columns, model.redundancy, gains)


def _watched(
    estimator: Estimator, period: float, ranges: Mapping[str, tuple[float, float]]
) -> LeaveOneOut:
    assert isinstance(estimator, KalmanEstimator)
    widths = (ranges[name][1] - ranges[name][0] for name in estimator.outputs)
    return LeaveOneOut(estimator, period, [AGREEMENT * width for width in widths])


def _vote(sensors: Sequence[SensorChannel], design: Mapping[str, Any], period: float) -> Vote:
    allowed = [
        CONTRADICTION * (each.calibrated[1] - each.calibrated[0])
        + NOISE_MARGIN * white_noise_of(design, each.channel)
        for each in sensors
    ]
    return Vote(allowed, max(PATIENCE, PATIENCE_PERIODS * period))


def _seen(span: tuple[float, float], sign: float) -> Limits:
    """Set points for the deflections that the calibration has seen."""
    return Limits(*sorted(sign * deflection for deflection in span))


def heater_power(
    model: Model,
    settings: Settings,
    messages: Messages,
    heater: str,
    target: str | None = None,
    lead: float | None = None,
    settled: bool = False,
) -> SetpointProcess:
    """The power of a heater that holds an output at zero; no design is needed.

    Parameters
    ----------
    model, settings, messages, settled
        As for `offsets`.
    heater : str
        The drive that is set.
    target : str or None
        The output that is held; None for the model's only deflection.
    lead : float [s] or None
        How far it is foretold; None for two sample periods.

    Raises
    ------
    ModelError
        No such drive or output, no power to give, or a range for a channel that is no sensor.
    ValueError
        As for `offsets`.
    """
    period = _period(settings, model.sample_period)
    target = held_output(model, target)
    terms = parts_of(model, heater, target)[2]
    limits = powers(model, heater, settings.limits)
    lead = LEAD_PERIODS * period if lead is None else lead
    stabilizer = Stabilizer(model, heater, target, limits, lead)
    inputs = tuple(
        InputColumn(d.channel, d.zero, d.range, False, d.hold == "zero") for d in stabilizer.read
    )
    setpoint = settings.setpoint(limits, channel=heater)
    known = {"plausible_change": plausible_changes(model, {}, (), period)}
    digest = {"heater": heater, "lead": lead, "parameters": model.parameters_digest(),
              "target": target}  # fmt: skip
    return SetpointProcess(
        HeaterStepper(stabilizer, lambda: setpoint.value, _settling_time(terms)),
        _sensors(inputs, period, settings, messages, known),
        [0],
        [setpoint],
        _policy(settings, period, 1.0, settled),
        _clock_check(settings, period, messages),
        messages,
        names=[heater],
        estimates=(f"wanted_{heater}", target) if settings.estimates else (),
        with_status=settings.status,
        patience=default_hold(period),
        clock_advice=CLOCK_ADVICE,
        digest=content_digest(digest),
    )


def controlled_heaters(
    controller: HeaterController, settings: Settings, messages: Messages, settled: bool = False
) -> SetpointProcess:
    """Powers of the heaters of a controller document, and offsets of its axes.

    Parameters
    ----------
    controller : HeaterController
    settings, messages, settled
        As for `offsets`.

    Raises
    ------
    ModelError
        A controller that its model does not bear.
    ValueError
        As for `offsets`.
    """
    period = _period(settings, controller.period)
    pipeline, estimator = linear_estimator(controller.model)
    design = controller.model.estimator_design()
    tops = {drive.channel: drive.maximum for drive in controller.drives}
    # A power is measured between nothing and full power, whatever the calibration has seen; what is
    # clearly below nothing is a meter whose sign is wrong.
    measurable = {channel: (-DEVIATION * top, 2 * top) for channel, top in tops.items()}
    settings = replace(settings, ranges={**measurable, **settings.ranges})
    columns = [
        replace(each, calibrated=(0.0, tops[each.column])) if each.column in tops else each
        for each in pipeline.input_columns
    ]
    setpoints = [
        replace(settings, slew=drive.slew).setpoint((0.0, drive.maximum), channel=drive.channel)
        for drive in controller.drives
    ]
    stepper = ControlStepper(
        controller, estimator, lambda: [setpoint.value for setpoint in setpoints], messages
    )
    ranges = {output.channel: output.range for output in controller.model.deflections}
    axes = [
        settings.setpoint((-reach, reach), channel=name, seen=ranges[name][1] - ranges[name][0])
        for name, reach in controller.axes.items()
    ]
    names = [*controller.channels, *map(setpoint_name, controller.axes)]
    wanted = [f"wanted_{channel}" for channel in names]
    left = [f"left_{channel.partition('_')[2]}" for channel in controller.tolerance]
    return ControlProcess(
        stepper,
        _sensors(columns, period, settings, messages, design, stands_in=True),
        list(range(len(names))),
        [*setpoints, *axes],
        _policy(settings, period, 1.0, settled),
        _clock_check(settings, period, messages),
        messages,
        names=names,
        estimates=(*wanted, *estimator.estimates, *left) if settings.estimates else (),
        with_status=settings.status,
        patience=default_hold(period),
        clock_advice=CLOCK_ADVICE,
        digest=content_digest(controller.document()),
        summary=stepper.summary,
    )


def _settling_time(terms: Sequence[Term]) -> float:
    """Until a wrong start of these terms is forgotten [s]."""
    return -math.log(REMAINDER) * max(term.response.slowest() for term in terms)


def _period(settings: Settings, period: float) -> float:
    """The sample period [s]: as chosen, else as the model has it."""
    period = settings.period or period
    if not CLOCK_STEP <= period < LONGEST_PAUSE:
        raise ModelError(f"a sample period of {period:g} s is none of a stream")
    return period


def _policy(settings: Settings, period: float, sign: float, settled: bool) -> Policy:
    slew_gap = SLEW_PERIODS * period if settings.max_gap is None else settings.max_gap
    every, max_age = settings.checkpoint_every, settings.checkpoint_max_age
    return Policy(
        period, sign, settings.safe, slew_gap, settled, max_age, LATE_SAVES * every,
        hold_at_end=settings.end == "hold",
    )  # fmt: skip


def _clock_check(settings: Settings, period: float, messages: Messages) -> ClockCheck:
    hold, max_gap = settings.bridged(default_hold(period))
    return ClockCheck(messages, hold, max_gap=max_gap, expected=period)


def _frozen_check(each: InputColumn, settings: Settings, design: Mapping[str, Any]) -> FrozenCheck:
    """By the noise that the design knows, where the user says nothing else."""
    by_noise = each.sensor and math.isinf(settings.frozen_after) and not settings.trust
    return FrozenCheck(white_noise_of(design, each.column) if by_noise else 0.0)


def _sensors(
    inputs: Sequence[InputColumn],
    period: float,
    settings: Settings,
    report: Report,
    design: Mapping[str, Any] | None = None,
    stands_in: bool = False,
) -> list[SensorChannel]:
    """The columns that are read, with their rest, range and largest change from the model."""
    known = design if design is not None and not settings.trust else {}
    several = stands_in or (bool(known) and sum(each.sensor for each in inputs) > 1)
    settings.check_ranges([each.column for each in inputs])
    return [
        SensorChannel(
            each.column,
            rest=math.nan if each.rest == "first" else each.rest,
            calibrated=each.calibrated or ANYTHING,
            bounds=settings.ranges.get(each.column),
            hold=settings.bridged(default_hold(period))[0],
            # What is commanded may well stand still.
            frozen_after=math.inf if each.commanded else settings.frozen_after,
            report=report,
            back=each.to_true,
            at_rest=each.tells_rest,
            surrounds=each.tells_rest and not each.sensor,
            reach=reach_of({} if each.commanded else known, each.column),
            frozen=_frozen_check(each, settings, design or {}),
            consequence="lost" if several else "safe setpoint",
        )
        for each in inputs
    ]
