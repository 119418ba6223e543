"""From a model to its estimator, and from measured temperatures to heat and deflection."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, as_model, read, read_noise, reads, warn_pauses
from thermaltool.api.result import Notice, Result, notice, silent, to_frame
from thermaltool.errors import ModelError
from thermaltool.units import names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from thermaltool.api.inputs import ModelLike
    from thermaltool.estimation.batch import EstimatedRecord
    from thermaltool.estimation.deconvolution import Method
    from thermaltool.estimation.design import EstimatorDesign
    from thermaltool.estimation.parameter_rules import Rule
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.signals.agreement import Agreement


@dataclass(frozen=True, repr=False)
class DesignReport(Result):
    """A model with its estimator, and the trade-off that it was chosen from.

    Attributes
    ----------
    design : EstimatorDesign
    """

    design: EstimatorDesign

    @property
    def model(self) -> Model:
        """The model with its design."""
        return self.design.model

    @property
    def frame(self) -> pandas.DataFrame:
        """Every choice with its settings, lag [s], errors of the heat and of each deflection."""
        import pandas

        rows = []
        for form, choices in self.design.choices.items():
            for choice in choices:
                predicted = choice.prediction
                row = {"form": form, **choice.settings, "lag_s": predicted.lag}
                for name, error in zip(
                    self.design.problem.drives, predicted.heat_rmse, strict=True
                ):
                    row[f"rmse_{name}"] = error
                for k, name in enumerate(self.design.problem.outputs):
                    row[f"band_{name}"] = predicted.band[k]
                    row[f"noise_{name}"] = predicted.noise_sigma[k]
                rows.append(row | {"chosen": choice is self.design.best})
        return pandas.DataFrame(rows)

    def document(self) -> dict[str, Any]:
        """The whole trade-off, JSON-ready."""
        from thermaltool.report.estimators import design_document

        return design_document(self.design)

    def table(self) -> str:
        """Every choice of every form, and the one that was taken."""
        from thermaltool.report.estimators import design_summary, design_table

        summary = design_summary(self.design)
        return f"{design_table(self.design)}\n{summary}" if self.design.choices else summary

    def draw(self) -> Figure:
        """The predicted band of every choice, and what it is made of.

        Raises
        ------
        ModelError
            Every drive is measured: there was nothing to choose.
        """
        from thermaltool.report.trade_off import draw_trade_off

        if not self.design.choices:
            raise ModelError("every drive is measured: there is no trade-off to draw")
        return draw_trade_off(self.document(), "the design", self.model)


@dataclass(frozen=True, repr=False)
class LogEstimate(Result):
    """Heat and deflection, estimated from the temperatures in a log.

    Attributes
    ----------
    log : Log
        The readings, and what was measured of the estimates.
    found : EstimatedRecord
    """

    log: Log
    found: EstimatedRecord

    @property
    def columns(self) -> Mapping[str, NDArray[Any]]:
        """``time_s`` and the estimates, shape (n,)."""
        return self.found.columns()

    @property
    def agreements(self) -> Mapping[str, Agreement]:
        """How far the estimates are from what was measured of them."""
        return self.found.agreement

    @property
    def frame(self) -> pandas.DataFrame:
        """Estimates against time [s]."""
        return to_frame(self.columns)

    def document(self) -> dict[str, Any]:
        """Agreement and zero of every measured channel, the alarm, how a method chose."""
        from thermaltool.report.deconvolution import deconvolution_document

        found: dict[str, Any] = {
            "agreement": {
                name: each.document() | self.found.zeros[name].document()
                for name, each in self.agreements.items()
            }
        }
        if self.found.alarm is not None:
            found["alarm"] = self.found.alarm.document(self.found.time)
        if self.found.change is not None:
            found["change"] = self.found.change.document()
        if self.found.departure is not None:
            found["departure"] = self.found.departure.document()
        if self.found.deconvolved is not None:
            found["deconvolution"] = deconvolution_document(self.found.deconvolved)
        return found

    def table(self) -> str:
        """How a method chose; band and error of every estimate that was measured."""
        from thermaltool.report.deconvolution import deconvolution_table
        from thermaltool.report.simulation import estimate_table
        from thermaltool.report.text import zero_message

        parts = [] if self.found.deconvolved is None else [
            deconvolution_table(self.found.deconvolved)
        ]  # fmt: skip
        if self.agreements:
            parts.append(estimate_table(self.agreements))
        zeros = self.found.zeros.items()
        parts += [zero_message(name, zero, self.log, "estimated") for name, zero in zeros
                  if zero.rows]  # fmt: skip
        return "\n".join(parts)

    def draw(self) -> Figure:
        """The estimates, against what was measured of them where it was."""
        from thermaltool.report.pairs import draw_estimate
        from thermaltool.report.records import draw_log

        log = replace(self.log, columns=self.found.estimates)
        if not self.agreements:
            return draw_log(log)
        return draw_estimate(log, self.log, zeros=self.found.zeros)


def regularize(
    model: ModelLike,
    noise: str | os.PathLike[str] | Any | None = None,
    *,
    form: Literal["auto", "kalman", "kernel"] = "auto",
    measured: str | Sequence[str] = (),
    sensors: str | Sequence[str] = (),
    dt: float | None = None,
    walk: float | None = None,
    criterion: Literal["heat", "deflection", "both"] | None = None,
    delay: float | None = None,
    cutoff: float | None = None,
    regularization: tuple[float, float, float] | None = None,
    warn: Notice = notice,
    progress: Notice = silent,
) -> DesignReport:
    """Design the estimator from the model and the measured noise.

    Both forms minimize the predicted band of the deflection error after a step of the calibrated
    level: what is missing while the estimate catches up, and what the sensors' noise leaves. Of
    the heat they minimize the root of the mean squared error.

    Parameters
    ----------
    model : Model, a result that holds one, str or path
    noise : what `noise` returned, or a file of it; optional
        Not needed where every drive is measured.
    form : {"auto", "kalman", "kernel"}
        "auto" takes the one that fares better by the criterion.
    measured : str or sequence of str
        Drives that are read, not estimated. All, in a model without a sensor.
    sensors : str or sequence of str
        Only these.
    dt : float, optional [s]
        Sample period of the estimator. Default: that of the calibration.
    walk : float, optional
        Pins the random-walk rate of the Kalman form [share of the level per √s].
    criterion : {"heat", "deflection", "both"}, optional
        What the design is for. Default: the deflection where the model has one, else the heat.
    delay : float, optional [s]
        Pins the artificial delay of the kernel form.
    cutoff : float, optional [Hz]
        Pins the filter of the kernel form.
    regularization : (A, B, c), optional
        Pins f_R = (At + Bt²)e^(−ct) of the kernel form [unit/s, unit/s², 1/s].
    warn, progress : callable
        Take a sentence about what the design reads or leaves out, and a word now and then.

    Returns
    -------
    DesignReport

    Raises
    ------
    ModelError
        The noise is needed and not there, or does not fit the model.
    FitError
        No usable design.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> print(tt.regularize(fit))
    chosen: feedforward, from Q_motor_W
    """
    from thermaltool.estimation.design import DesignPlan, design_estimator, needs_noise
    from thermaltool.estimation.design_model import DesignModel
    from thermaltool.model import only_sensors

    model, measured, sensors = as_model(model), names(measured), names(sensors)
    if sensors:
        model = only_sensors(model, sensors)
    if noise is None and needs_noise(model, measured):
        raise ModelError("an estimate weighs the sensors' noise: give what noise returned")
    known = {} if noise is None else read_noise(noise)
    problem = DesignModel.of(model, known, dt or model.sample_period, measured)
    for sentence in problem.all_notes:
        warn(sentence)
    pinned = {"delay_s": delay, "cutoff_Hz": cutoff}
    pinned |= dict(zip("ABc", regularization or (None,) * 3, strict=True))
    plan = DesignPlan(
        form, walk, criterion, {name: v for name, v in pinned.items() if v is not None}
    )
    design = design_estimator(model, problem, plan, progress)
    if design.choices:
        progress("done\n")
    for note in design.notes:
        warn(note)
    return DesignReport(design)


@reads(Reading)
def estimate(
    model: ModelLike,
    data: Data,
    *,
    initial: Literal["auto", "rest", "settled", "free"] = "auto",
    smooth: bool = False,
    lag: float | None = None,
    walk: float | Literal["likelihood", "design"] | None = None,
    bands: bool = False,
    method: Method | None = None,
    rule: Rule | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    future: int | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> LogEstimate:
    """Heat and deflection from measured temperatures.

    The numbers are those that `Compensator` gives row by row, the effects of the model included,
    unless they are smoothed.

    Parameters
    ----------
    model : Model with a design, a result that holds one, str or path
        From `regularize`.
    data : str, path, pandas.DataFrame or Record
    initial : {"auto", "rest", "settled", "free"}
        The machine at the first row: at rest in what is measured there (a room of any
        temperature), settled at all first readings, or, with `smooth`, in a state that is
        estimated. "auto" takes rest, with `smooth` unless the first readings contradict it.
    smooth : bool
        Each estimate rests on all readings of the record, later ones included. With `nan_policy`
        "hold" a sensor's missing readings count as none.
    lag : float, optional [s]
        Each estimate rests on the readings up to so long after it, as a stream's does.
    walk : float, "likelihood" or "design", optional
        How fast the heat changes: a random-walk rate [share of the level per √s], at the maximum
        of the likelihood of this record's readings, or as the design has it. Default: "design";
        with `smooth` the likelier of "likelihood" and a smaller walk beside steps.
    bands : bool
        Standard errors of all estimates, as columns ``sigma_...``.
    method : {"tikhonov0", "tikhonov1", "tikhonov2", "tv", "beck"}, optional
        The heat of one drive from the whole record, of a machine at rest at the first row:
        Tikhonov regularization of a difference of the heat, total variation, Beck's function
        specification. It goes with none of the four options before.
    rule : str, optional
        What chooses its parameter: "likelihood", "gcv", "quasi-optimality", "discrepancy" or
        "l-curve". Default: the one with the least expected error, or the first that is not refused.
    at_least, at_most : float, optional
        Bounds of its heat [unit of the drive].
    future : int, optional
        Future rows of "beck".
    warn : callable
        Takes a sentence where the first reading is not rest, the model extrapolates or the log
        pauses. Default: a `ThermalToolWarning`.
    **reading
        See `read_log`.

    Returns
    -------
    LogEstimate

    Raises
    ------
    ModelError
        No design, or one for other parameters; no smoother for its form.
    LogError
        A log that cannot be read, or that lacks a sensor.
    ValueError
        Options that do not go together, or a lag that is none.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> tt.estimate(tt.regularize(fit), frame).agreements["d_z_um"].band < 0.1
    True
    """
    from thermaltool.estimation.batch import estimate as estimate_record
    from thermaltool.estimation.deconvolution import DeconvolutionPlan
    from thermaltool.estimation.lookahead import Lookahead
    from thermaltool.estimation.pipeline import EstimatorPipeline
    from thermaltool.model import NOT_AT_REST, UNTOLD_REST
    from thermaltool.report.text import (
        excursion_message,
        look_messages,
        period_messages,
        row_message,
        still_messages,
        stuck_messages,
    )

    model = as_model(model)
    pipeline = EstimatorPipeline.of(model)
    if method is None and any(each is not None for each in (rule, at_least, at_most, future)):
        raise ValueError("a rule, bounds and future rows go with a method")
    plan = None if method is None else DeconvolutionPlan(method, rule, at_least, at_most, future)
    how = Lookahead(smooth, lag, walk, bands, plan)
    need = pipeline.columns
    if how.takes_all and reading.get("nan_policy") == "hold":
        # A smoother needs no reading that nobody has made; a method names them.
        need = tuple(each.column for each in pipeline.input_columns if not each.sensor)
    log = read(data, need, warn=warn, **reading)
    found = estimate_record(model, pipeline, log, initial, how)
    for sentence in look_messages(log, found, bands):
        warn(sentence)
    for sentence in found.deconvolved.notes if found.deconvolved else ():
        warn(sentence)
    for says in (stuck_messages(log, need), still_messages(log, need), period_messages(log, model)):
        for sentence in says:
            warn(sentence)
    not_at_rest = "is not rest: the state there is estimated"
    if found.initial == "rest":
        not_at_rest = f"{NOT_AT_REST} or free" if smooth else NOT_AT_REST
    for column, value in found.not_at_rest.items():
        warn(row_message(log, 0, f"{column}: {value:.4g} at the start {not_at_rest}"))
    for column in found.untold_rest:
        first = float(log.column(column)[0])
        warn(row_message(log, 0, f"{column}: {first:.4g} at the start {UNTOLD_REST}"))
    for excursion in found.excursions:
        warn(excursion_message(log, excursion))
    known = "the drives are held or run on"
    over = "the heat is taken to wander on" if pipeline.estimates_drives else known
    warn_pauses(log, warn, f"{over} over it")
    for excursion in found.extrapolated:
        warn(excursion_message(log, excursion))
    return LogEstimate(log, found)
