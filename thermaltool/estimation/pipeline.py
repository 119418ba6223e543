"""The estimator of a model with the effects around it: from columns to estimates.

The batch command runs a whole log through `EstimatorPipeline.run`; the stream takes the same input
columns, the same recursion and the same last step, sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.effects.band import ScheduleBand
from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import Estimator, KalmanEstimator, load_estimator
from thermaltool.estimation.known_inputs import Feedforward, KnownInput, KnownInputEstimator
from thermaltool.estimation.permanent_effects import (
    InputColumn,
    StaticMap,
    apply_maps,
    contact_column,
    drive_maps,
    estimate_maps,
    reading_columns,
    reading_maps,
)
from thermaltool.estimation.variable_cooling import (
    VariableCoolingEstimator,
    cooling_effects,
)
from thermaltool.estimation.variable_feedforward import VariableFeedforward
from thermaltool.model import Model, away_from_rest, relative
from thermaltool.responses.modes import Float
from thermaltool.units import Reference


@dataclass(frozen=True)
class EstimatorInput:
    """One input of the estimator.

    Attributes
    ----------
    column : int
        The input column from which it comes.
    band : ScheduleBand or None
        Only this level's share of it,
    chooser : int
        by what this input column reads.
    """

    column: int
    band: ScheduleBand | None = None
    chooser: int = 0


@dataclass(frozen=True)
class EstimatorPipeline:
    """Readings, estimator, and the effects before and behind it.

    Attributes
    ----------
    estimator : Estimator
    input_columns : tuple of InputColumn
        One for each column that is read, the sensors first.
    inputs : tuple of EstimatorInput
        What the estimator takes, in the order of ``estimator.sensors``.
    estimate_maps : tuple of tuple of callable
        For each estimate, the static maps from it to what is given out.
    """

    estimator: Estimator
    input_columns: tuple[InputColumn, ...]
    inputs: tuple[EstimatorInput, ...]
    estimate_maps: tuple[tuple[StaticMap, ...], ...]

    @staticmethod
    def of(model: Model) -> EstimatorPipeline:
        """The pipeline that a model's design asks for.

        Parameters
        ----------
        model : Model

        Raises
        ------
        ModelError
            No design, one for other parameters, or one that is not sound.
        """
        design = model.estimator_design()
        linear = load_estimator(dict(design))
        place, outputs = reading_columns(model), {o.channel: o for o in model.outputs}
        columns = [
            InputColumn(
                place[sensor],
                outputs[place[sensor]].offset,
                outputs[sensor].range,
                True,
                to_true=reading_maps(model, sensor),
            )
            for sensor in design["sensors"]
        ]
        inputs = [EstimatorInput(k) for k in range(len(columns))]
        if isinstance(linear, KnownInputEstimator):
            more, taken = _known_columns(model, linear.known, len(columns))
            columns += more
            inputs += taken
        estimator = _with_cooling(model, linear)
        maps = tuple(estimate_maps(model, name) for name in estimator.estimates)
        return EstimatorPipeline(estimator, tuple(columns), tuple(inputs), maps)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that are read."""
        return tuple(each.column for each in self.input_columns)

    @property
    def estimates_drives(self) -> bool:
        """Whether a sensor is read, from which drives are estimated."""
        return any(each.sensor for each in self.input_columns)

    def true_values(self, columns: Mapping[str, Float]) -> Float:
        """True values behind the columns, relative to rest; NaN where a reading has none.

        Parameters
        ----------
        columns : mapping of str to ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n, n_columns)
        """
        found = [
            apply_maps(each.to_true, relative(columns[each.column], each.rest, each.hold))
            for each in self.input_columns
        ]
        return np.column_stack(found)

    def run(self, time: Float, true_values: Float, settled: bool = False) -> Float:
        """Estimates of a whole record, equal to the stream's sample by sample.

        Parameters
        ----------
        time : ndarray, shape (n,) [s], increasing
        true_values : ndarray, shape (n, n_columns)
        settled : bool
            The machine has stood at the first readings for long; else it is at rest there.

        Returns
        -------
        ndarray, shape (n, n_estimates)
        """
        taken = np.column_stack(self.estimator_inputs([*true_values.T]))
        estimates = self.estimator.run(time, taken, settled)
        return np.column_stack(self.given_out([*estimates.T]))

    def at_rest(self, time: Float, true_values: Float) -> Float:
        """What the sensors of a machine at rest read in a record, shape (n_sensors,).

        Parameters
        ----------
        time : ndarray, shape (n,) [s], increasing
        true_values : ndarray, shape (n, n_columns)
        """
        if not len(time):
            return np.zeros(len(self.input_columns))
        dt = float(time[1] - time[0]) if len(time) > 1 else 1.0
        return self.estimator.at_rest(dt, np.array(self.estimator_inputs([*true_values[0]])))

    def untold_rest(self, true_values: Float) -> dict[str, float]:
        """Surroundings far from those of the calibration at the first row, relative to these.

        Where a sensor is read it tells whether the machine has followed them; none here.

        Parameters
        ----------
        true_values : ndarray, shape (n, n_columns)
        """
        if self.estimates_drives or not len(true_values):
            return {}
        pairs = zip(self.input_columns, true_values[0].tolist(), strict=True)
        return {
            each.column: value
            for each, value in pairs
            if each.tells_rest and each.calibrated and away_from_rest(value, each.calibrated)
        }

    @property
    def passes_inputs(self) -> bool:
        """Whether the estimator takes the true values as they are."""
        mapped = any(each.to_acting for each in self.input_columns)
        return not mapped and all(each.band is None for each in self.inputs)

    def estimator_inputs(self, true_values: Sequence[Any]) -> list[Any]:
        """What the estimator takes of the true values of one sample, or of whole columns.

        Parameters
        ----------
        true_values : sequence of float or of ndarray, shape (n,)
            Of the input columns, relative to rest.
        """
        maps = (each.to_acting for each in self.input_columns)
        acting = [_mapped(each, value) for each, value in zip(maps, true_values, strict=True)]
        return [
            acting[each.column]
            if each.band is None
            else _mapped((each.band.share,), true_values[each.chooser]) * acting[each.column]
            for each in self.inputs
        ]

    def given_out(self, estimates: Sequence[Any]) -> list[Any]:
        """What is given out of the estimates of one sample, or of whole columns.

        Parameters
        ----------
        estimates : sequence of float or of ndarray, shape (n,)
        """
        pairs = zip(self.estimate_maps, estimates, strict=True)
        return [_mapped(maps, value) for maps, value in pairs]


def _mapped(maps: tuple[StaticMap, ...], value: Any) -> Any:
    """A number, or a column, through static maps."""
    if not maps:
        return value
    mapped = apply_maps(maps, np.asarray(value))
    return mapped if mapped.ndim else float(mapped)


def _known_columns(
    model: Model, known: Sequence[KnownInput], first: int
) -> tuple[list[InputColumn], list[EstimatorInput]]:
    """Columns of known inputs, each in each role once, and what is taken of them.

    They are numbered from `first`.

    Raises
    ------
    ModelError
        A schedule by a channel that is not read.
    """
    places: dict[tuple[str, str, Reference], int] = {}
    columns: list[InputColumn] = []
    for each in known:
        if (each.channel, each.role, each.rest) not in places:
            places[each.channel, each.role, each.rest] = first + len(columns)
            columns.append(_known_column(model, each))
    inputs = []
    for each in known:
        column, chooser = places[each.channel, each.role, each.rest], 0
        if each.band is not None:
            by = each.band.channel
            # Only a source has a rest of its own.
            at = places.get((by, "drive", "first"), places.get((by, "state", "first")))
            if at is None:
                raise ModelError(f"the schedule by {by} has no column: run regularize again")
            chooser = at
        inputs.append(EstimatorInput(column, each.band, chooser))
    return columns, inputs


def _known_column(model: Model, known: KnownInput) -> InputColumn:
    if known.role == "source":
        return InputColumn(known.channel, known.rest, None, False, known.hold == "zero")
    if known.role == "state":
        return InputColumn(known.channel, 0.0, None, False, True)
    if known.role == "contact":
        return contact_column(model, known.channel)
    for drive in model.drives:
        if drive.channel == known.channel:
            maps = drive_maps(model, drive.channel)
            return InputColumn(
                drive.channel, drive.zero, drive.range, False, drive.hold == "zero", (), maps
            )
    raise ModelError(
        f"the estimator reads the drive {known.channel}, which the model does not have: "
        "run thermaltool regularize again"
    )


def _with_cooling(model: Model, linear: Estimator) -> Estimator:
    effects = cooling_effects(model)
    if not effects:
        return linear
    kalman = linear.inner if isinstance(linear, KnownInputEstimator) else linear
    if isinstance(kalman, Feedforward):
        return VariableFeedforward(linear=linear, losses=effects)
    if not isinstance(kalman, KalmanEstimator):
        raise ModelError(
            f"{effects[0].name} takes the Kalman form: run thermaltool regularize again"
        )
    return VariableCoolingEstimator(linear=linear, kalman=kalman, losses=effects)
