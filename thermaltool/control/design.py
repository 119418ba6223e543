"""A controller from a model: what is asked is checked, and tried on the model itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermaltool.control.controller import ControlDrive, HeaterController
from thermaltool.control.heaters import powers
from thermaltool.control.law_choice import linear_estimator
from thermaltool.control.laws import AT_LIMIT
from thermaltool.control.methods import Method
from thermaltool.control.prediction import ControlPrediction
from thermaltool.control.set_drives import with_set_drives
from thermaltool.control.trial import TRIAL_SAMPLES, ControlTrial, tried_step
from thermaltool.errors import ModelError
from thermaltool.model import MARGIN, Model
from thermaltool.model.validity import thousandth
from thermaltool.units import parse_channel

# Without a tolerance of the user's: this part of the largest range that the calibration has seen of
# an output of the same unit.
TOLERANCE = 0.01
# The inversion is at zero after so many sample periods.
LEAD_PERIODS = 2
# Usual rate of a setpoint [unit of the drive per s].
USUAL_SLEW = 10.0
# Outputs that one more singular value below this part of the largest cannot tell apart.
INDEPENDENT = 1e-3


@dataclass(frozen=True)
class ControlPlan:
    """What is asked of a controller.

    Attributes
    ----------
    drives : sequence of (str, float or None)
        Drives that are set, with the largest value of each; None for what the calibration has seen.
    method : str
    outputs : sequence of str
        That are held; empty for all deflections.
    tolerance : mapping of output to float
    slew : float [unit of the drives per s]
    horizon, lead, duration : float or None [s]
        As for `HeaterController`; None for the slowest time constant of the control drives, for two
        sample periods, and for no end.
    axes : mapping of output to float
        As for `HeaterController`; of the receding horizon alone.
    """

    drives: Sequence[tuple[str, float | None]]
    method: Method = "receding-horizon"
    outputs: Sequence[str] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    slew: float = USUAL_SLEW
    horizon: float | None = None
    lead: float | None = None
    duration: float | None = None
    axes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ControlDesign:
    """A controller and its trials.

    Attributes
    ----------
    controller : HeaterController
    trials : tuple of ControlTrial
    notes : tuple of str
        Limits beyond the calibration, and outputs that the drives cannot hold apart.
    """

    controller: HeaterController
    trials: tuple[ControlTrial, ...]
    notes: tuple[str, ...]


def design_controller(model: Model, plan: ControlPlan) -> ControlDesign:
    """Design the controller of a model.

    Parameters
    ----------
    model : Model
        With a design whose estimator reads each control drive.
    plan : ControlPlan

    Raises
    ------
    ModelError
        A drive or output that the model does not have, or that nothing acts on; no power to give;
        an estimator that does not read the power; effects that are not linear, a long dead time.
    """
    outputs = _outputs(model, plan)
    drives = tuple(_control_drive(model, channel, top, plan.slew) for channel, top in plan.drives)
    channels = [drive.channel for drive in drives]
    for channel in channels:
        if channels.count(channel) > 1:
            raise ModelError(f"{channel} is given twice")
    _check_axes(plan, outputs)
    _check_acting(model, channels, outputs, plan.axes)
    model, lagged = with_set_drives(model, channels)
    prediction = ControlPrediction(linear_estimator(model)[1], tuple(channels), outputs)
    if not prediction.disturbances:
        raise ModelError(f"nothing but {', '.join(channels)} drives the model: nothing to hold off")
    period = model.design_period()
    horizon = plan.horizon or prediction.slowest()
    for name, length in (("horizon", horizon), ("lead", plan.lead), ("duration", plan.duration)):
        if length is not None and length < period:
            raise ModelError(f"a {name} of {length:g} s is below the sample period, {period:g} s")
    usual = _usual_tolerances(model, outputs)
    tolerance = _tolerances(usual, plan.tolerance)
    # A large tolerance is a weight: it asks no more of a drive than the usual one.
    least = {each: min(size, usual[each] or size) for each, size in tolerance.items()}
    _check_reach(prediction, drives, least, plan)
    controller = HeaterController(
        model,
        plan.method,
        drives,
        tolerance,
        period,
        horizon,
        plan.lead or LEAD_PERIODS * period,
        plan.duration,
        dict(plan.axes),
    )
    design = tried(controller)
    return replace(design, notes=(*lagged, *design.notes))


def tried(controller: HeaterController) -> ControlDesign:
    """A controller with its trials.

    Parameters
    ----------
    controller : HeaterController

    Raises
    ------
    ModelError
        A model that does not bear it.
    """
    estimator = linear_estimator(controller.model)[1]
    prediction = ControlPrediction(estimator, controller.channels, tuple(controller.tolerance))
    length = controller.duration or controller.horizon
    trials = tuple(
        tried_step(controller, prediction, k, length) for k in range(len(prediction.disturbances))
    )
    notes = (
        *_beyond_calibration(controller.model, controller.drives),
        *_dependent(prediction, controller, length),
        *_unused(controller.drives, trials),
    )
    return ControlDesign(controller, trials, notes)


def _unused(drives: Sequence[ControlDrive], trials: Sequence[ControlTrial]) -> tuple[str, ...]:
    """A note for each drive that is off in all trials, where another is not."""
    largest = {
        drive.channel: max(np.max(trial.heats[drive.channel]) for trial in trials) / drive.maximum
        for drive in drives
    }
    if max(largest.values()) <= AT_LIMIT:
        return ()
    steps = ", ".join(trial.disturbance for trial in trials)
    return tuple(
        f"{channel} stays off in every trial: the way it bends helps no step of {steps}"
        for channel, share in largest.items()
        if share <= AT_LIMIT
    )


def _outputs(model: Model, plan: ControlPlan) -> tuple[str, ...]:
    known = [output.channel for output in model.deflections]
    if not known:
        raise ModelError("the model has no deflection to hold")
    for channel in (*plan.outputs, *plan.tolerance):
        if channel not in known:
            raise ModelError(
                f"{channel} is no deflection of the model; there are {', '.join(known)}"
            )
    held = tuple(dict.fromkeys(plan.outputs)) or tuple(known)
    for channel, value in plan.tolerance.items():
        if channel not in held:
            raise ModelError(f"a tolerance for {channel}, which is not held")
        if not 0 < value < math.inf:
            raise ModelError(f"a tolerance for {channel} cannot be {value:g}")
    return held


def _control_drive(model: Model, channel: str, top: float | None, slew: float) -> ControlDrive:
    drives = {drive.channel: drive for drive in model.drives}
    if channel not in drives:
        raise ModelError(f"{channel} is not a drive of the model; there are {', '.join(drives)}")
    if drives[channel].reference != 0:
        raise ModelError(f"{channel} is not set like a power, but measured from its first value")
    if top is not None and not 0 < top < math.inf:
        raise ModelError(f"{channel}: no power between 0 and {top:g}: give {channel}:WATTS")
    if not 0 < slew < math.inf:
        raise ModelError(f"a slew rate cannot be {slew:g}")
    limits = (-math.inf, math.inf if top is None else top)
    maximum, seen = powers(model, channel, limits)[1], max(map(abs, drives[channel].range))
    suspect = thousandth(channel, maximum, seen)
    if suspect is not None:
        raise ModelError(
            f"{channel}: {maximum:g} is about a thousand times as much or as little as the "
            f"calibration has seen, {seen:g}: is it in {suspect.unit}?"
        )
    return ControlDrive(channel, maximum, slew)


def _beyond_calibration(model: Model, drives: Sequence[ControlDrive]) -> tuple[str, ...]:
    """A note for each drive that may be set where no calibration has been."""
    ranges = {drive.channel: drive.range for drive in model.drives}
    return tuple(
        f"{drive.channel}: what more than {ranges[drive.channel][1]:g} does is extrapolated: the "
        f"calibration has seen no more, and {drive.maximum:g} may be set"
        for drive in drives
        if drive.maximum > (1 + MARGIN) * ranges[drive.channel][1]
    )


def _check_axes(plan: ControlPlan, outputs: Sequence[str]) -> None:
    for channel, reach in plan.axes.items():
        if channel not in outputs:
            raise ModelError(f"an axis for {channel}, which is not held")
        if not 0 < reach < math.inf:
            raise ModelError(f"an axis cannot correct {channel} by {reach:g}")
    if plan.axes and plan.method != "receding-horizon":
        raise ModelError(f"{plan.method} leaves nothing to an axis: take receding-horizon")


def _check_acting(
    model: Model, channels: Sequence[str], outputs: Sequence[str], axes: Mapping[str, float]
) -> None:
    acts = {(term.drive, term.output) for term in model.terms}
    for channel in channels:
        if all((channel, output) not in acts for output in outputs):
            raise ModelError(f"{channel} acts on none of {', '.join(outputs)}: it holds nothing")
    for output in outputs:
        if output not in axes and all((channel, output) not in acts for channel in channels):
            raise ModelError(
                f"{output} cannot be controlled: none of {', '.join(channels)} acts on it "
                "(--hold the others alone)"
            )


def _check_reach(
    prediction: ControlPrediction,
    drives: Sequence[ControlDrive],
    least: Mapping[str, float],
    plan: ControlPlan,
) -> None:
    """Refuse drives and outputs between which a calibration has found next to nothing.

    Full power, or what the slew rate allows, is to move an output by the `least` that matters at
    some moment of the plan.
    """
    time = plan.duration or plan.horizon or prediction.slowest()
    times = time * np.arange(1, TRIAL_SAMPLES + 1) / TRIAL_SAMPLES
    # A heat that rises does no more than one that has been on.
    reached = np.array([np.minimum(drive.slew * times, drive.maximum) for drive in drives]).T
    moves = (np.abs(prediction.steps(times)) * reached[:, None]).max(axis=0)
    slow = any(drive.slew * time < drive.maximum for drive in drives)
    power = "what the slew rate allows" if slow else "full power"
    short = moves / np.array(list(least.values()))[:, None]
    for k, (output, size) in enumerate(least.items()):
        if output not in plan.axes and short[k].max() < 1:
            raise ModelError(
                f"{output} cannot be controlled: {power} of {', '.join(prediction.controls)} "
                f"moves it by {moves[k].max():.2g} within {time:.4g} s, less than its tolerance, "
                f"{size:.2g} (--hold the others alone)"
            )
    for k, drive in enumerate(drives):
        if short[:, k].max() < 1:
            raise ModelError(
                f"{drive.channel} acts on none of {', '.join(least)}: {power} moves no "
                f"output by its tolerance within {time:.4g} s"
            )


def _tolerances(usual: Mapping[str, float], given: Mapping[str, float]) -> dict[str, float]:
    for channel, size in usual.items():
        if channel not in given and not size > 0:
            raise ModelError(f"{channel} has not moved in the calibration: give it a --tolerance")
    return {channel: given.get(channel, size) for channel, size in usual.items()}


def _usual_tolerances(model: Model, outputs: Sequence[str]) -> dict[str, float]:
    spans = {o.channel: o.range[1] - o.range[0] for o in model.deflections}
    units = {channel: parse_channel(channel).unit for channel in outputs}
    return {
        channel: TOLERANCE * max(spans[each] for each in outputs if units[each] == units[channel])
        for channel in outputs
    }


def _dependent(
    prediction: ControlPrediction, controller: HeaterController, time: float
) -> tuple[str, ...]:
    """A note where the drives cannot move the outputs without an axis one without the other."""
    held = [k for k, output in enumerate(prediction.outputs) if output not in controller.axes]
    if len(held) < 2:
        return ()
    tops = np.array([drive.maximum for drive in controller.drives])
    sizes = np.linalg.svd(prediction.steps(np.array(time))[held] * tops, compute_uv=False)
    if len(tops) >= len(held) and sizes[-1] > INDEPENDENT * sizes[0]:
        return ()
    moved = ", ".join(prediction.outputs[k] for k in held)
    move = "moves" if len(tops) == 1 else "move"
    return (
        f"{', '.join(prediction.controls)} {move} {moved} together: not all of them can be held at "
        "zero",
    )
