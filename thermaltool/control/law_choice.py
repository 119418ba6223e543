"""The law that a controller document names, over the state of its model's estimator."""

from __future__ import annotations

import numpy as np

from thermaltool.control.controller import HeaterController
from thermaltool.control.laws import ControlLaw, HeatLimits, InversionLaw, RegulatorLaw
from thermaltool.control.prediction import ControlPrediction
from thermaltool.errors import ModelError
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.model import Model


def linear_estimator(model: Model) -> tuple[EstimatorPipeline, KnownInputEstimator]:
    """The estimator of a model, where it is linear from what is read to the deflections.

    Parameters
    ----------
    model : Model

    Raises
    ------
    ModelError
        No design, one that reads no drive, or effects that a linear law cannot follow.
    """
    pipeline = EstimatorPipeline.of(model)
    if not isinstance(pipeline.estimator, KnownInputEstimator):
        raise ModelError(
            "the estimator reads no power: run thermaltool regularize --measured with each "
            "control drive"
        )
    if not pipeline.passes_inputs or any(pipeline.estimate_maps):
        curved = ", ".join(effect.name for effect in model.effects) or "a schedule"
        raise ModelError(f"a controller is linear and cannot follow {curved}")
    return pipeline, pipeline.estimator


def law_of(
    controller: HeaterController,
    estimator: KnownInputEstimator,
    without: frozenset[str] = frozenset(),
) -> ControlLaw:
    """The law of a controller.

    Parameters
    ----------
    controller : HeaterController
    estimator : KnownInputEstimator
        Of its model.
    without : frozenset of str
        Drives that do not follow their setpoints: what is measured of them is a disturbance.

    Raises
    ------
    ModelError
        As `ControlPrediction`.
    """
    drives = [drive for drive in controller.drives if drive.channel not in without]
    prediction = ControlPrediction(
        estimator, tuple(drive.channel for drive in drives), tuple(controller.tolerance)
    )
    bounds = HeatLimits(
        np.array([drive.maximum for drive in drives]), np.array([drive.slew for drive in drives])
    )
    tolerance = list(controller.tolerance.values())
    if controller.method == "inversion":
        return InversionLaw(prediction, bounds, controller.lead)
    if controller.method == "receding-horizon":
        # Imported where it is asked for: its solver is an extra.
        from thermaltool.control.receding import RecedingHorizonLaw

        return RecedingHorizonLaw(
            prediction, bounds, tolerance, controller.period, controller.horizon,
            controller.duration, [controller.axes.get(each, 0.0) for each in controller.tolerance],
        )  # fmt: skip
    of_states = controller.method == "state-lqr"
    levels = disturbance_levels(controller.model, prediction)
    return RegulatorLaw(prediction, bounds, controller.lead, tolerance, of_states, levels)


def disturbance_levels(model: Model, prediction: ControlPrediction) -> list[float]:
    """The largest value, relative to rest, that the calibration has seen of each disturbance."""
    ranges = {drive.channel: drive.range for drive in model.drives}
    return [max(ranges.get(channel, (0.0, 1.0)), key=abs) for channel in prediction.disturbances]
