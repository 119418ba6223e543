"""Estimates of whole records, and what a user should know of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from thermaltool.errors import LogError, counted
from thermaltool.estimation.bands import model_errors
from thermaltool.estimation.changed_machine import Change
from thermaltool.estimation.deconvolution import Deconvolved
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.heat_steps import HeatSteps
from thermaltool.estimation.innovation_test import Alarm, checking_filter, not_rest
from thermaltool.estimation.lookahead import Lookahead, linear_kalman, look
from thermaltool.estimation.model_departure import ModelDeparture
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.estimation.start import Initial, Start
from thermaltool.model import (
    Excursion,
    Model,
    Zero,
    away_from_rest,
    excursions,
    extrapolated,
    zero_beside,
)
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.agreement import Agreement, agreement

# Before the name of an estimate stands this for its standard error.
SIGMA = "sigma_"


@dataclass(frozen=True)
class EstimatedRecord:
    """Heat and deflections estimated from a record.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    estimates : mapping of channel to ndarray, shape (n,)
    agreement : mapping of channel to Agreement
        With what the record holds of the same channels.
    zeros : mapping of channel to Zero
        What these count from in the record.
    not_at_rest : mapping of column to float
        First readings, relative to rest, that contradict a machine at rest.
    untold_rest : mapping of column to float
        Those of surroundings far from the calibration's, where no sensor tells of the machine.
    excursions : tuple of Excursion
        Where true values behind the readings leave what the calibration has seen,
    extrapolated : tuple of Excursion
        and where the estimates do.
    sigma : mapping of channel to ndarray, shape (n,)
        Standard errors, where they were asked for.
    sizes : KalmanEstimator or None
        With the sizes of walk and noise that were taken, where they are not the design's.
    alarm : Alarm or None
        Whether model and machine contradict each other; looked for where standard errors were
        asked for or all is smoothed.
    steps : HeatSteps or None
        What the readings say of steps of the heat, where these were looked for.
    no_steps : str
        Why they were not.
    deconvolved : Deconvolved or None
        How a method that was asked for came to its heat.
    change : Change or None
        Of the machine since its calibration, where the readings are much likelier with it.
    departure : ModelDeparture or None
        Errors of the model that the readings make likely.
    initial : {"rest", "settled", "free"}
        How the machine was taken to begin.
    """

    time: Float
    estimates: Mapping[str, Float]
    agreement: Mapping[str, Agreement]
    zeros: Mapping[str, Zero]
    not_at_rest: Mapping[str, float]
    excursions: tuple[Excursion, ...]
    extrapolated: tuple[Excursion, ...]
    sigma: Mapping[str, Float] = field(default_factory=dict)
    sizes: KalmanEstimator | None = None
    alarm: Alarm | None = None
    deconvolved: Deconvolved | None = None
    steps: HeatSteps | None = None
    no_steps: str = ""
    change: Change | None = None
    departure: ModelDeparture | None = None
    initial: Initial = "rest"
    untold_rest: Mapping[str, float] = field(default_factory=dict)

    def columns(self) -> dict[str, Float]:
        """The table: ``time_s``, the estimates and their standard errors."""
        errors = {SIGMA + name: values for name, values in self.sigma.items()}
        return {"time_s": self.time, **self.estimates, **errors}


def estimate(
    model: Model,
    pipeline: EstimatorPipeline,
    record: Record,
    initial: Start = "auto",
    how: Lookahead | None = None,
) -> EstimatedRecord:
    """Estimates of a whole record, equal to those of the stream line by line unless `how` says.

    Parameters
    ----------
    model : Model
    pipeline : EstimatorPipeline
        Of the same model.
    record : Record
        The columns that the pipeline reads; without NaN, but for sensors where all is smoothed.
    initial : {"auto", "rest", "settled", "free"}
        The machine at the first row: at rest in what is measured there, settled at the first
        readings, or, where all is smoothed, in a state that is estimated. "auto" takes rest, where
        all is smoothed unless the first readings contradict it.
    how : Lookahead, optional
        Which later readings count, and whether standard errors are told.

    Raises
    ------
    LogError
        A column is missing, or no true value gives a reading.
    ModelError
        A lookahead that the design's form does not have.
    """
    true_values = pipeline.true_values({name: record.column(name) for name in pipeline.columns})
    rests = {o.channel: o.offset for o in model.outputs}
    behind, not_at_rest = dict(record.columns), {}
    # Sensors come first; of a scheduled drive the estimator takes more than its one column.
    at_rest, may_rest = pipeline.at_rest(record.time, true_values), initial in ("auto", "rest")
    columns = zip(pipeline.estimator.sensors, pipeline.input_columns, true_values.T, strict=False)
    for k, (name, column, values) in enumerate(columns):
        read = np.isfinite(record.column(column.column))
        if len(none := np.flatnonzero(np.isnan(values) & read)):
            message = f"no truth gives this reading ({counted(len(none), 'row')})"
            raise LogError(message, record.name, record.line(int(none[0])), column.column)
        if column.sensor and column.calibrated is not None:
            rest = rests[name]
            behind[name] = values + (0.0 if rest == "first" else rest)
            above = values[:1] - at_rest[k]
            if may_rest and len(above) and away_from_rest(above[0], column.calibrated):
                not_at_rest[column.column] = float(above[0])
    if initial == "auto":
        initial = "rest"
        if how is not None and how.smooth and len(record):
            # What is too little for a warning is no rest all the same, where noise is less.
            kalman = linear_kalman(pipeline.estimator)
            checking = checking_filter(kalman, model_errors(model, kalman))
            above = true_values[0, : len(kalman.sensors)] - at_rest[: len(kalman.sensors)]
            for k in np.flatnonzero(not_rest(checking, above)).tolist():
                not_at_rest[pipeline.input_columns[k].column] = float(above[k])
            initial = "free" if not_at_rest else "rest"
    sigma: dict[str, Float] = {}
    sizes, alarm, deconvolved, steps, no_steps, change = None, None, None, None, "", None
    departure = None
    names = pipeline.estimator.estimates
    if initial != "free" and (how is None or how.plain):
        found = [*pipeline.run(record.time, true_values, initial == "settled").T]
    else:
        how = how or Lookahead()
        taken = np.column_stack(pipeline.estimator_inputs([*true_values.T]))
        looked = look(model, pipeline.estimator, record.time, taken, how, initial, not not_at_rest)
        found = pipeline.given_out([*looked.estimates.T])
        told = how.sizes != "design" and len(record) > 0
        sizes = looked.estimator if told else None
        deconvolved = looked.deconvolved
        steps, no_steps = looked.steps, looked.no_steps
        alarm, change, departure = looked.alarm, looked.change, looked.departure
        if looked.sigma is not None:
            # Through the maps behind the estimator, which may bend.
            high, low = (pipeline.given_out([*ends.T])
                         for ends in (looked.estimates + looked.sigma,
                                      looked.estimates - looked.sigma))  # fmt: skip
            errors = [np.abs(a - b) / 2 for a, b in zip(high, low, strict=True)]
            sigma = dict(zip(names, errors, strict=True))
    estimates = dict(zip(names, found, strict=True))
    zeros = _zeros(model, record, estimates, initial != "rest" or bool(not_at_rest))
    return EstimatedRecord(
        record.time,
        estimates,
        {
            name: agreement(record.columns[name] - zero.value, estimates[name])
            for name, zero in zeros.items()
        },
        zeros,
        not_at_rest,
        excursions(model, behind),
        extrapolated(model, estimates),
        sigma,
        sizes,
        alarm,
        deconvolved,
        steps,
        no_steps,
        change,
        departure,
        initial,
        pipeline.untold_rest(true_values) if may_rest else {},
    )


def _zeros(
    model: Model, record: Record, estimates: Mapping[str, Float], warm: bool
) -> dict[str, Zero]:
    """What each measured channel counts from beside its estimate."""
    references = {d.channel: d.reference for d in model.drives}
    references |= {o.channel: o.offset for o in model.outputs}
    return {
        name: zero_beside(record.time, record.columns[name], values, references[name], warm)
        for name, values in estimates.items()
        if name in record.columns and len(record)
    }
