"""How far a model may be from its machine, as the readings of a record say: what bands hold.

A model that is a little wrong, by a gain or a time constant, shows in the innovations before it
shows anywhere else. Each sensor has a gain and a pace of its own beside the model's. By how much
they differ among the sensors is what the readings know (the curvature of the likelihood); what the
calibration leaves of the sensors is the prior, as many times as large as the readings make
likeliest (empirical Bayes). A gain or a pace that all sensors share reads like another heat: it is
held to be as wrong as those of single sensors are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.estimation.changed_machine import with_gain, with_pace
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.innovation_test import checking_filter
from thermaltool.estimation.likelihood import log_likelihood
from thermaltool.estimation.start import Initial
from thermaltool.responses.modes import Float
from thermaltool.signals.symmetric import eigh

# Factors on the prior that are tried; relative errors stay below MAX_ERROR [1].
SCALES = np.geomspace(0.5, 1e3, 34)
MAX_ERROR = 0.3
# So much likelier than a model that is right [nats], standard errors hold it: as much as a change
# of the machine that may be.
MIN_EVIDENCE = 5.0
# Of a standard deviation so much is tried, and the difference of estimates scaled up: a linear one.
TRIAL_SHARE, MAX_TRIAL = 0.05, 0.05
# Directions that are known better than this are left out [1].
MIN_SIZE = 1e-7


@dataclass(frozen=True)
class ModelDeparture:
    """Errors of a model that a record makes likely.

    Attributes
    ----------
    second_moment : ndarray, shape (2 n_sensors, 2 n_sensors)
        Of gains and time constants of the sensors over the model's, gains first, less one [1].
    evidence : float
        Than a model that is right so much likelier [nats].
    """

    second_moment: Float
    evidence: float

    @property
    def sizes(self) -> tuple[float, float]:
        """How far gains and time constants are off, root mean square over the sensors [1]."""
        gains, paces = np.split(np.diag(self.second_moment), 2)
        return math.sqrt(np.mean(gains)), math.sqrt(np.mean(paces))

    def document(self) -> dict[str, float]:
        """As JSON."""
        gain, pace = self.sizes
        return {"likelier_nats": self.evidence, "gains_percent": 100 * gain,
                "time_constants_percent": 100 * pace}  # fmt: skip

    def variance(
        self, kalman: KalmanEstimator, estimated: Callable[[KalmanEstimator], Float]
    ) -> Float:
        """Of the estimates of a record, shape (n, n_estimates).

        Parameters
        ----------
        kalman : KalmanEstimator
        estimated : callable
            Estimates by another estimator, shape (n, n_estimates).
        """
        own = estimated(kalman)
        found = np.zeros(own.shape)
        sizes, axes = eigh(self.second_moment)
        for size, axis in zip(sizes, axes.T, strict=True):
            if size > MIN_SIZE**2:
                share = min(TRIAL_SHARE, MAX_TRIAL / math.sqrt(size))
                moved = estimated(_moved(kalman, share * math.sqrt(size) * axis)) - own
                found += np.square(moved / share)
        return found


def model_departure(
    kalman: KalmanEstimator,
    model_error: Sequence[float],
    gain_error: Sequence[float],
    time: Float,
    readings: Float,
    initial: Initial,
    level: Sequence[float],
) -> ModelDeparture | None:
    """How far a model may be from the machine of a record; None where nothing says so.

    Parameters
    ----------
    kalman, model_error, gain_error, time, readings, initial, level
        As for `changed_machine.likeliest_change`.
    """
    # Steps stay where the likelihood is nearly a parabola, also of a sensor that is hardly known.
    unit = np.minimum(np.concatenate([gain_error, gain_error]), MAX_ERROR / 2)

    def likelihood(away: Float) -> float:
        tested = checking_filter(_moved(kalman, unit * away), model_error)
        return log_likelihood(tested, time, readings, initial, level)

    try:
        slope, information = _curvature(likelihood, len(unit))
    except (FitError, LogError, ModelError, np.linalg.LinAlgError):
        return None
    # What differs among the sensors.
    apart = np.kron(np.eye(2), np.eye(len(kalman.sensors)) - 1 / len(kalman.sensors))
    alone = apart * unit / unit[:, None]
    slope, information = alone.T @ slope, alone.T @ information @ alone
    scales = SCALES[SCALES * np.max(unit) <= MAX_ERROR]
    evidences = [_evidence(slope, information, scale) for scale in scales]
    best = int(np.argmax(evidences))
    if not evidences[best] > MIN_EVIDENCE:
        return None
    covariance = np.linalg.inv(information + np.eye(len(unit)) / scales[best] ** 2)
    mean = unit * (covariance @ slope)
    second = np.outer(unit, unit) * covariance + np.outer(mean, mean)
    return ModelDeparture(second, evidences[best])


def _moved(kalman: KalmanEstimator, away: Float) -> KalmanEstimator:
    """With gains and paces that are so far from one."""
    gains, paces = np.split(1 + away, 2)
    for k, (gain, pace) in enumerate(zip(gains.tolist(), paces.tolist(), strict=True)):
        kalman = with_pace(with_gain(kalman, k, gain), k, pace)
    return kalman


def _curvature(likelihood: Callable[[Float], float], count: int) -> tuple[Float, Float]:
    """Slope and information of a log likelihood at zero, by differences over one unit."""
    axes, middle = np.eye(count), likelihood(np.zeros(count))
    ahead, behind = (np.array([likelihood(sign * axis) for axis in axes]) for sign in (1.0, -1.0))
    information = np.diag(2 * middle - ahead - behind)
    for j, k in combinations(range(count), 2):
        both = likelihood(axes[j] + axes[k]) - ahead[j] - ahead[k] + middle
        information[j, k] = information[k, j] = -both
    # What the likelihood is curved the other way in is no information.
    sizes, vectors = eigh(information)
    return 0.5 * (ahead - behind), (vectors * np.maximum(sizes, 0.0)) @ vectors.T


def _evidence(slope: Float, information: Float, scale: float) -> float:
    """Of errors so many times as large as the prior's, over that of none [nats]."""
    precision = information + np.eye(len(slope)) / scale**2
    _, determinant = np.linalg.slogdet(scale**2 * precision)
    return 0.5 * float(slope @ np.linalg.solve(precision, slope) - determinant)
