"""What the covariance of a model's parameters leaves uncertain in its estimates.

To first order a wrong response ΔH acts on the estimate as a reading that is wrong by −ΔH q, and on
a deflection by ΔH q itself, q being the heat: no estimator is designed anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.permanent_effects import sensor_time_constants
from thermaltool.model import Model, Term
from thermaltool.responses.modes import Float, Modes

# Of a standard deviation of the parameters so much is tried, and the difference scaled up: along
# a direction that no log tells, a whole one leaves the parameters' range.
TRIAL_SHARE = 0.05
# Directions that move a response by less than this share of its steady state are left out.
MIN_EFFECT = 1e-4
# Readings that are smoothed at a time: a bound of memory.
MAX_TOGETHER = 2_000_000


def parameter_variance(
    model: Model,
    kalman: KalmanEstimator,
    time: Float,
    estimates: Float,
    readings: Float,
    estimated: Callable[[Float], Float],
) -> Float:
    """Variance of the estimates of a record that the parameters' covariance makes.

    Parameters
    ----------
    model : Model
    kalman : KalmanEstimator
    time : ndarray, shape (n,) [s]
    estimates : ndarray, shape (n, n_estimates)
        From `readings`.
    readings : ndarray, shape (n, n_sensors)
        NaN where there is none.
    estimated : callable
        From readings of several records, shape (k, n, n_sensors), to estimates.

    Returns
    -------
    ndarray, shape (n, n_estimates)
    """
    variance, drives = np.zeros(estimates.shape), len(kalman.drives)
    missing = ~np.isfinite(readings)
    together = max(1, MAX_TOGETHER // max(readings.size, 1))
    several: list[Float] = []

    def added() -> Float | float:
        """Variance by the wrong readings that are gathered."""
        if not several:
            return 0.0
        found = np.sum(np.square(estimated(np.array(several)) / TRIAL_SHARE), axis=0)
        several.clear()
        return np.asarray(found)

    for term in model.terms:
        if term.drive not in kalman.drives:
            continue
        heat = estimates[:, kalman.drives.index(term.drive)]
        for own, other in _directions(model, term):
            shift = other.run(time, heat, "zero") - own.run(time, heat, "zero")
            if term.output in kalman.outputs:
                at = drives + kalman.outputs.index(term.output)
                variance[:, at] += (shift / TRIAL_SHARE) ** 2
            elif term.output in kalman.sensors:
                wrong = np.zeros(readings.shape)
                wrong[:, kalman.sensors.index(term.output)] = shift
                wrong[missing] = np.nan
                several.append(wrong)
                if len(several) == together:
                    variance += added()
    return variance + added()


def _directions(model: Model, term: Term) -> Iterator[tuple[Modes, Modes]]:
    """A term's response, and what it is a little along each direction of its covariance."""
    if term.covariance is None:
        return
    lags = sensor_time_constants(model, term.output)
    own = lagged_modes(term.response.modes(model.sample_period), *lags)
    sizes, vectors = np.linalg.eigh(np.asarray(term.covariance))
    t = np.geomspace(model.sample_period, 10 * term.response.slowest(), 200)
    steady = max(float(np.max(np.abs(own.step(t)))), 1e-300)
    for size, vector in zip(sizes, vectors.T, strict=True):
        if not size > 0:
            continue
        step = TRIAL_SHARE * np.sqrt(size) * vector
        values = dict(zip(term.covariance_names, step.tolist(), strict=True))
        moved = {name: getattr(term.response, name) + by for name, by in values.items()}
        try:
            response = replace(term.response, **moved)  # type: ignore[type-var]
        except (ModelError, ValueError):
            continue
        other = lagged_modes(response.modes(model.sample_period), *lags)
        moved_by = float(np.max(np.abs(other.step(t) - own.step(t)))) / TRIAL_SHARE
        if moved_by > MIN_EFFECT * steady:
            yield own, other
