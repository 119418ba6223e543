"""What is uncertain in a model, in its estimates.

To first order a wrong response ΔH acts on the estimate as a reading that is wrong by −ΔH q, and on
a deflection by ΔH q itself, q being the drive, estimated or measured: no estimator is designed
anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from thermaltool.estimation.calibration_error import (
    ActingDrive,
    deflection_variance,
    sensor_changes,
)
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.model import Model
from thermaltool.responses.modes import Float

# Readings that are smoothed at a time: a bound of memory.
MAX_TOGETHER = 2_000_000


def parameter_variance(
    model: Model,
    kalman: KalmanEstimator,
    time: Float,
    estimates: Float,
    readings: Float,
    estimated: Callable[[Float], Float],
    known: Mapping[str, ActingDrive] | None = None,
    warm: bool = False,
) -> Float:
    """Variance of the estimates of a record that the model's uncertainty makes.

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
    known : mapping of drive to ActingDrive, optional
        Drives that are measured.
    warm : bool
        The machine has had the heats of the first row before it; else it was at rest.

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
        found = np.sum(np.square(estimated(np.array(several))), axis=0)
        several.clear()
        return np.asarray(found)

    heats = zip(kalman.drives, estimates.T, strict=False)
    acting = {name: ActingDrive(q, "zero", float(q[0]) if warm else 0.0) for name, q in heats}
    acting |= known or {}
    for output in model.outputs:
        name = output.channel
        if name in kalman.outputs:
            at = drives + kalman.outputs.index(name)
            variance[:, at] += deflection_variance(model, output, time, acting)
        elif name in kalman.sensors:
            for change in sensor_changes(model, output, time, acting):
                wrong = np.zeros(readings.shape)
                wrong[:, kalman.sensors.index(name)] = change
                wrong[missing] = np.nan
                several.append(wrong)
                if len(several) == together:
                    variance += added()
    return variance + added()
