"""Estimates of whole records, and what a user should know of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import LogError
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.model import Excursion, Model, away_from_rest, beside, excursions, extrapolated
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.agreement import Agreement, agreement
from thermaltool.units import Reference


@dataclass(frozen=True)
class EstimatedRecord:
    """Heat and deflections estimated from a record.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    estimates : mapping of channel to ndarray, shape (n,)
    agreement : mapping of channel to Agreement
        With what the record holds of the same channels.
    not_at_rest : mapping of column to float
        First readings, relative to rest, that contradict a machine at rest.
    excursions : tuple of Excursion
        Where true values behind the readings leave what the calibration has seen,
    extrapolated : tuple of Excursion
        and where the estimates do.
    """

    time: Float
    estimates: Mapping[str, Float]
    agreement: Mapping[str, Agreement]
    not_at_rest: Mapping[str, float]
    excursions: tuple[Excursion, ...]
    extrapolated: tuple[Excursion, ...]

    def columns(self) -> dict[str, Float]:
        """The table: ``time_s`` and the estimates."""
        return {"time_s": self.time, **self.estimates}


def estimate(
    model: Model, pipeline: EstimatorPipeline, record: Record, settled: bool = False
) -> EstimatedRecord:
    """Estimates of a whole record, equal to those of the stream line by line.

    Parameters
    ----------
    model : Model
    pipeline : EstimatorPipeline
        Of the same model.
    record : Record
        The columns that the pipeline reads, without NaN.
    settled : bool
        The machine has stood at the first readings for long; else it is at rest there.

    Raises
    ------
    LogError
        A column is missing, or no true value gives a reading.
    """
    true_values = pipeline.true_values({name: record.column(name) for name in pipeline.columns})
    rests = {o.channel: o.offset for o in model.outputs}
    behind, not_at_rest = dict(record.columns), {}
    # Sensors come first; of a scheduled drive the estimator takes more than its one column.
    names = zip(pipeline.estimator.sensors, pipeline.input_columns, true_values.T, strict=False)
    for name, column, values in names:
        if len(none := np.flatnonzero(np.isnan(values))):
            message = f"no truth gives this reading ({len(none)} rows)"
            raise LogError(message, record.name, record.line(int(none[0])), column.column)
        if column.sensor and column.calibrated is not None:
            rest = rests[name]
            behind[name] = values + (0.0 if rest == "first" else rest)
            if not settled and len(values) and away_from_rest(values[0], column.calibrated):
                not_at_rest[column.column] = float(values[0])
    columns = pipeline.run(record.time, true_values, settled).T
    estimates = dict(zip(pipeline.estimator.estimates, columns, strict=True))
    return EstimatedRecord(
        record.time,
        estimates,
        _agreement(model, record, estimates),
        not_at_rest,
        excursions(model, behind),
        extrapolated(model, estimates),
    )


def _agreement(
    model: Model, record: Record, estimates: Mapping[str, Float]
) -> dict[str, Agreement]:
    """With the measured channels; what has no zero counts from the level of its first rows."""
    references = {d.channel: d.reference for d in model.drives}
    references |= {o.channel: o.offset for o in model.outputs}
    return {
        name: agreement(_counted(record.columns[name], values, references[name]), values)
        for name, values in estimates.items()
        if name in record.columns and len(record)
    }


def _counted(measured: Float, estimated: Float, rest: Reference) -> Float:
    return beside(measured, estimated) if rest == "first" else measured - rest
