"""What is uncertain of a model in the estimates of a stream, worked out with the design."""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np

from thermaltool.documents import finite
from thermaltool.errors import ModelError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.parameter_error import parameter_variance
from thermaltool.model import Model

# A sensor's signal is this share of its largest in the calibration, on the mean [1].
SIGNAL_SHARE = 0.5
# No sensor and no model are better than this [1].
MIN_GAIN_ERROR = 1e-3


def design_bands(model: Model, problem: DesignModel, kalman: KalmanEstimator) -> dict[str, Any]:
    """What `stream_bands` and the innovation test read in a design.

    Parameters
    ----------
    model : Model
    problem : DesignModel
        Of the same model.
    kalman : KalmanEstimator

    Returns
    -------
    dict
        ``relative``: standard errors of the estimates that the parameters make, as shares of an
        estimate, after a step; ``model_error``: what the calibration left of each sensor beside
        noise; ``gain_error``: that over the sensor's signal.
    """
    # Over all trials together: each moves one drive, and says nothing of estimates that rest in it.
    squares, total = np.zeros((2, len(kalman.estimates)))
    recursion = kalman.recursion(problem.dt)
    for readings, _ in problem.trials:
        estimates = recursion.run(readings)[0]
        variance = parameter_variance(
            model, kalman, problem.clock, estimates, readings,
            lambda several: np.array([recursion.run(each)[0] for each in several]),
        )  # fmt: skip
        squares += np.mean(estimates**2, axis=0)
        total += np.mean(variance, axis=0)
    relative = np.sqrt(total / np.maximum(squares, 1e-300))
    return {
        "relative": np.minimum(relative, 1.0).tolist(),
        "model_error": model_errors(model, kalman),
        "gain_error": gain_errors(model, kalman),
    }


def model_errors(model: Model, kalman: KalmanEstimator) -> list[float]:
    """What the calibration leaves of each sensor beside noise [unit of the sensor].

    Root of the squared residual's rest. A sensor of which less is left than of the others, over its
    signal, counts with the root mean square of all: one calibration says little of one sensor.

    Parameters
    ----------
    model : Model
    kalman : KalmanEstimator

    Raises
    ------
    ModelError
        What a fit keeps of them is no number.
    """
    fits = {output.channel: output.fit for output in model.outputs}
    left = []
    for sensor in kalman.sensors:
        fit = fits[sensor]
        try:
            rmse = finite(fit.get("rmse", 0.0))
            noise = finite(fit["noise"]) if "noise" in fit else inf
        except ModelError as error:
            raise ModelError(f"fit of {sensor}: rmse, noise: {error}") from error
        left.append(sqrt(1 - (noise / rmse) ** 2) * rmse if rmse > noise else 0.0)
    signals = _signals(model, kalman)
    shares = [each / signal for each, signal in zip(left, signals, strict=True) if signal]
    together = sqrt(sum(each**2 for each in shares) / max(len(shares), 1))
    return [max(each, together * signal) for each, signal in zip(left, signals, strict=True)]


def gain_errors(model: Model, kalman: KalmanEstimator) -> list[float]:
    """How far each sensor's gain may be from the model's [1]: `model_errors` over its signal.

    Parameters
    ----------
    model : Model
    kalman : KalmanEstimator
    """
    pairs = zip(model_errors(model, kalman), _signals(model, kalman), strict=True)
    return [min(max(error / signal, MIN_GAIN_ERROR), 1.0) if signal else 1.0
            for error, signal in pairs]  # fmt: skip


def _signals(model: Model, kalman: KalmanEstimator) -> list[float]:
    ranges = {output.channel: max(map(abs, output.range)) for output in model.outputs}
    return [SIGNAL_SHARE * ranges[sensor] for sensor in kalman.sensors]
