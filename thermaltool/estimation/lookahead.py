"""Estimates that look at later readings, and the standard errors of all estimates of a record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.estimation.bands import gain_errors, model_errors
from thermaltool.estimation.calibration_error import acting_drives
from thermaltool.estimation.changed_machine import Change, likeliest_change, with_loss
from thermaltool.estimation.deconvolution import (
    DeconvolutionPlan,
    Deconvolved,
    deconvolve,
    followed,
)
from thermaltool.estimation.estimator import Estimator, KalmanEstimator
from thermaltool.estimation.even_clock import steps_on_any_clock
from thermaltool.estimation.fixed_lag import error_variance, fixed_lag
from thermaltool.estimation.forms import linear_kalman
from thermaltool.estimation.heat_steps import HeatSteps, smooth_with_steps
from thermaltool.estimation.innovation_test import (
    WALK_FACTOR,
    Alarm,
    InnovationTest,
    record_alarm,
    with_misfit,
)
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.estimation.likelihood import fit_sizes
from thermaltool.estimation.model_departure import ModelDeparture, model_departure
from thermaltool.estimation.parameter_error import parameter_variance
from thermaltool.estimation.pauses import with_pauses
from thermaltool.estimation.permanent_effects import apply_maps, drive_maps
from thermaltool.estimation.running_error import RunningError, running_errors
from thermaltool.estimation.smoother import smooth, smoothed_estimates
from thermaltool.estimation.start import Initial, drive_levels
from thermaltool.estimation.stream_bands import stream_bands
from thermaltool.model import Model
from thermaltool.responses.modes import Float
from thermaltool.status import NOT_POSSIBLE, PARTED, QUIET

# In a longer record a change of the machine is looked for after an alarm alone, which sees it then.
MAX_ROWS_WITHOUT_ALARM = 6000

RateSource = float | Literal["likelihood", "design"]


@dataclass(frozen=True)
class Lookahead:
    """Which readings an estimate of a record rests on, and what is told of it.

    Attributes
    ----------
    smooth : bool
        All of the record; else those up to its moment, and `lag` seconds more.
    lag : float or None [s]
    walk : float, "likelihood", "design" or None
        Random-walk rate of the heat [share of the level per √s], as the record tells it, or as the
        design has it; None for "design", or where all of the record counts for the likelier of a
        walk as the record tells it and a smaller one beside steps.
    bands : bool
        Standard errors, too.
    plan : DeconvolutionPlan or None
        Another method than the Kalman filter's; of the whole record, and it goes with none of the
        others.
    """

    smooth: bool = False
    lag: float | None = None
    walk: RateSource | None = None
    bands: bool = False
    plan: DeconvolutionPlan | None = None

    def __post_init__(self) -> None:
        if self.smooth and self.lag is not None:
            raise ValueError("smooth takes all later readings, lag some of them: give one")
        if self.plan and (self.smooth or self.lag is not None or self.walk or self.bands):
            raise ValueError("a method takes all readings and chooses its own parameter: it goes "
                             "with neither smooth nor lag, walk or bands")  # fmt: skip

    @property
    def takes_all(self) -> bool:
        """Whether each estimate rests on all of the record."""
        return self.smooth or self.plan is not None

    @property
    def plain(self) -> bool:
        """Whether the estimates are those of the stream, and nothing more is asked."""
        return not (self.takes_all or self.lag or self.walk or self.bands)

    @property
    def sizes(self) -> RateSource:
        """Where the size of the walk comes from."""
        return self.walk or ("likelihood" if self.smooth else "design")

    @property
    def may_step(self) -> bool:
        """Whether steps of the heat are looked for."""
        return self.smooth and self.walk is None


@dataclass(frozen=True)
class Looked:
    """Estimates of a record, relative to rest, before the effects behind the estimator.

    Attributes
    ----------
    estimates : ndarray, shape (n, n_estimates)
    sigma : ndarray, shape (n, n_estimates), or None
        Standard errors.
    estimator : KalmanEstimator
        With the sizes that were taken, without steps.
    alarm : Alarm or None
        Whether model and machine have parted, where standard errors were asked for or all is
        smoothed.
    steps : HeatSteps or None
        Where they were looked for.
    no_steps : str
        Why they were not.
    deconvolved : Deconvolved or None
        How another method came to its heat.
    change : Change or None
        Of the machine, where the readings are much likelier with it.
    departure : ModelDeparture or None
        Errors of the model (about the change, where it is clear) that the readings make likely.
    """

    estimates: Float
    sigma: Float | None
    estimator: KalmanEstimator
    alarm: Alarm | None = None
    deconvolved: Deconvolved | None = None
    steps: HeatSteps | None = None
    no_steps: str = ""
    change: Change | None = None
    departure: ModelDeparture | None = None


def look(
    model: Model,
    estimator: Estimator,
    time: Float,
    taken: Float,
    how: Lookahead,
    initial: Initial = "rest",
    at_rest: bool = True,
) -> Looked:
    """Estimates of a whole record as `how` asks.

    Parameters
    ----------
    model : Model
    estimator : Estimator
        Of the model's design.
    time : ndarray, shape (n,) [s], increasing
    taken : ndarray, shape (n, m)
        What the estimator takes; NaN where a sensor has no reading (of a smoother).
    how : Lookahead
    initial : {"rest", "settled", "free"}
        The machine at the first row: at rest, settled at the readings, or, where all is smoothed,
        in a state that is estimated.
    at_rest : bool
        Whether the first readings allow a machine at rest.

    Raises
    ------
    ModelError
        No Kalman form; a method for a machine that is not at rest; a free start of a filter.
    LogError, FitError
        As for `fit_sizes` and `deconvolve`.
    """
    if initial == "free" and not how.smooth:
        raise ModelError("--initial free goes with --smooth: a filter starts at a known state")
    settled = initial != "rest"
    begins: Initial = initial if settled or at_rest else "free"
    designed = kalman = linear_kalman(estimator)
    sensors = len(kalman.sensors)
    readings, behind = taken[:, :sensors], np.zeros((len(time), len(kalman.estimates)))
    if isinstance(estimator, KnownInputEstimator):
        before, behind = estimator.contributions(time, taken, initial == "settled")
        readings = readings - before
    level = drive_levels(model, kalman.drives)
    there = np.ones(len(time), bool)
    if how.smooth:
        time, readings, there = with_pauses(time, readings)
    known = acting_drives(estimator, taken[np.cumsum(there) - 1], initial)
    if how.plan is not None:
        if settled:
            raise ModelError("--method takes a machine at rest at the first row; --smooth takes "
                             "--initial settled, too")  # fmt: skip
        maps = drive_maps(model, kalman.drives[0])

        def acting(end: float) -> float:
            return float(apply_maps(maps, np.array([end]))[0])

        found = deconvolve(kalman, time, readings, level[0], how.plan, acting)
        estimates = followed(kalman, float(np.median(np.diff(time))), found.heat)
        return Looked(estimates + behind, None, kalman, deconvolved=found)
    alarm, change, departure = None, None, None
    if len(time) > 1 and (how.bands or how.smooth):
        alarm = _alarm(model, designed, time, readings, begins)
        # From a start that is not the machine's own a change would only explain the start.
        if how.walk != "design" and begins == initial:
            change = _change(model, designed, time, readings, initial, alarm)
    if change is not None and how.smooth and change.is_enough:
        change = replace(change, taken=True)
        kalman = change.estimator
    if isinstance(how.sizes, float):
        kalman = replace(kalman, walk=tuple(how.sizes * each for each in level))
    if how.sizes != "design" and len(time):
        pinned = how.sizes != "likelihood"
        kalman = fit_sizes(kalman, time, readings, pinned, initial, level).estimator
    sized = told = kalman
    if how.bands and not how.smooth and how.walk is None:
        told = _as_told(kalman, time, readings, level, initial)
    if alarm is not None and how.walk != "design" and begins == initial:
        alarm = with_loss(alarm, change)
        departure = _departure(model, designed, told, time, readings, initial, alarm, change)
    if how.smooth and how.sizes != "design":
        # What the calibration has left of the sensors is no heat.
        kalman = with_misfit(kalman, model_errors(model, kalman))

    steps, no_steps, is_known = None, "", change is not None and change.taken
    if how.may_step and alarm is not None and alarm.word == PARTED and not is_known:
        no_steps = "model and machine have parted"
    elif how.may_step and len(time) > 0:
        steps, no_steps = steps_on_any_clock(kalman, time, readings, level, initial, there)
    stepped = steps if steps and steps.are_likelier else None
    kalman = kalman if stepped is None else stepped.estimator

    def estimated(readings: Float, like: KalmanEstimator = kalman) -> Float:
        if how.smooth:
            rows = None if stepped is None else stepped.likeliest + stepped.pauses
            return smooth(like, time, readings, level, initial, rows).estimates
        if how.lag:
            return fixed_lag(like, time, readings, how.lag, settled)
        return like.run(time, readings, settled)

    def of_several(readings: Float) -> Float:
        if how.smooth and len(time) > 1:
            rows = None if stepped is None else stepped.likeliest + stepped.pauses
            return smoothed_estimates(kalman, time, readings, level, initial, rows)
        return np.array([estimated(each) for each in readings])

    def with_model(sigma: Float, estimates: Float, estimated: Callable[[Float], Float]) -> Float:
        """Standard errors for a model that is right, and those that its own errors make."""
        if len(time) < 2:
            return sigma
        variance = parameter_variance(
            model, kalman, time, estimates, readings, estimated, known, begins != "rest"
        )
        return np.sqrt(np.square(sigma) + variance)

    smoothed = None
    if how.smooth and (how.bands or stepped):
        smoothed = (smooth(kalman, time, readings, level, initial) if stepped is None
                    else smooth_with_steps(stepped, time, readings, level))  # fmt: skip
    estimates = estimated(readings) if smoothed is None else smoothed.estimates
    sigma = None
    if how.bands and smoothed is not None:
        sigma = with_model(smoothed.sigma, estimates, of_several)
    elif how.bands:
        sigma = _filtered_sigma(kalman, told, time, level, begins, how.lag)
        if how.walk == "design" and not how.lag and not known:
            # As a stream has them.
            relative, _, _ = stream_bands(model.estimator_design(), len(kalman.estimates))
            sigma = np.hypot(sigma, np.array(relative) * estimates)
        else:
            sigma = with_model(sigma, estimates, of_several)
    if sigma is not None and change is not None and (change.explains or change.kind == "loss"):
        # What a change leaves open that is taken, and all that one does which is not.
        like = replace(kalman, sensed=change.edge.sensed, followed=change.edge.followed)
        sigma = np.hypot(sigma, estimated(readings, like) - estimated(readings))
    if sigma is not None and departure is not None:
        variance = departure.variance(kalman, lambda like: estimated(readings, like))
        sigma = np.sqrt(np.square(sigma) + variance)
    if alarm is not None and alarm.row is not None:
        alarm = replace(alarm, row=int(np.count_nonzero(there[: alarm.row])))
    estimates, sigma = estimates[there] + behind, None if sigma is None else sigma[there]
    return Looked(estimates, sigma, sized, alarm, steps=steps, no_steps=no_steps, change=change,
                  departure=departure)  # fmt: skip


def _alarm(
    model: Model,
    designed: KalmanEstimator,
    time: Float,
    readings: Float,
    initial: Initial,
    changed: KalmanEstimator | None = None,
) -> Alarm:
    """By the noise of the design: what the record itself tells has seen the contradiction."""
    errors = model_errors(model, designed), gain_errors(model, designed)
    period, level = float(np.median(np.diff(time))), drive_levels(model, designed.drives)
    test = InnovationTest(changed or designed, period, *errors, level)
    return record_alarm(test, time, readings, initial)


def _change(
    model: Model,
    designed: KalmanEstimator,
    time: Float,
    readings: Float,
    initial: Initial,
    alarm: Alarm,
) -> Change | None:
    """What the record says of a change of the machine, and whether it explains all of it."""
    long = len(time) > MAX_ROWS_WITHOUT_ALARM and alarm.word != PARTED
    if alarm.word == NOT_POSSIBLE or long:
        return None
    errors = model_errors(model, designed), gain_errors(model, designed)
    level = drive_levels(model, designed.drives)
    found = likeliest_change(designed, *errors, time, readings, initial, level)
    if found is not None and found.explains:
        told = _as_told(found.estimator, time, readings, level, initial)
        left = _departure(model, designed, told, time, readings, initial, alarm, found)
        found = replace(found, most=left is None or left.evidence < found.likelier)
    # A gain that is off without an alarm is one of the calibration's own.
    if found is None or not found.explains or (found.sensor and alarm.word != PARTED):
        return found
    after = _alarm(model, designed, time, readings, initial, found.estimator)
    return replace(found, is_enough=after.word == QUIET)


def _departure(
    model: Model,
    designed: KalmanEstimator,
    told: KalmanEstimator,
    time: Float,
    readings: Float,
    initial: Initial,
    alarm: Alarm,
    change: Change | None,
) -> ModelDeparture | None:
    """What the record says of errors of the model, about a change of the machine that is clear."""
    if alarm.word == NOT_POSSIBLE:
        return None
    about = change.estimator if change is not None and change.explains else designed
    # A heat that wanders as it does here: one of another size would pass for an error of gains.
    about = replace(about, walk=tuple(each / WALK_FACTOR for each in told.walk))
    errors = model_errors(model, designed), gain_errors(model, designed)
    level = drive_levels(model, designed.drives)
    return model_departure(about, *errors, time, readings, initial, level)


def _filtered_sigma(
    kalman: KalmanEstimator,
    told: KalmanEstimator,
    time: Float,
    level: Sequence[float],
    begins: Initial,
    lag: float | None,
) -> Float:
    """Standard errors of estimates with readings up to their moment, or of `lag` seconds more.

    The gains are those of the walk that a design has chosen; how far they leave the estimates from
    the heat depends on how it wanders here, as `told`.
    """
    period = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    sigma = running_errors(RunningError(kalman, period, level, told), time, begins)
    if not lag or len(time) < 2:
        return sigma
    rows = round(lag / period)  # on the mean over the record's clock; the last rows have fewer
    ahead = np.minimum(np.arange(len(time))[::-1], rows)
    found = np.sqrt(error_variance(kalman, told, period, rows))
    late = sigma * (found / np.maximum(found[0], 1e-300))[ahead]
    # Steady gains bring their noise into a state that is known, too: that of a machine at rest.
    return np.maximum(late, found[ahead])


def _as_told(
    kalman: KalmanEstimator,
    time: Float,
    readings: Float,
    level: Sequence[float],
    initial: Initial,
) -> KalmanEstimator:
    """With the sizes that the readings tell; as it is where they tell none."""
    try:
        return fit_sizes(kalman, time, readings, initial=initial, level=level).estimator
    except (LogError, FitError):
        return kalman
