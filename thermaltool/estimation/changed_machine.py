"""How a machine has changed since its calibration, where its record says so: loss, or a gain.

A loss of heat that is larger everywhere lets every temperature decay faster: all poles of the
responses move by one rate ν [1/s] and their residues stay, exactly for a body with a loss of its
whole surface that is thin (a fin), nearly for one that conducts better than it loses. A sensor that
has come loose shows less of the same. Each hypothesis has one number, which is taken where the
readings are likeliest, in the filter of the innovation test: what the calibration leaves of each
sensor counts as noise there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from thermaltool.errors import FitError, LogError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.innovation_test import checking_filter
from thermaltool.estimation.likelihood import log_likelihood
from thermaltool.estimation.start import Initial
from thermaltool.responses.modes import Float, Modes

# Rates of the loss that are tried first, over the slowest rate of a response [1]: of less, of more,
LESS = (-0.9, -0.7, -0.55, -0.4, -0.2, -0.1, -0.05)
MORE = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
# and gains of a sensor over the model's [1].
GAINS = (0.2, 0.35, 0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 1.01, 1.03, 1.07, 1.15, 1.3, 1.5)
MAX_EVALUATIONS = 20
# No loss falls by more of the slowest rate, the deflections' too: without any nothing would settle.
MAX_LESS = 0.95
# So much likelier than no change [nats]. Right models gain half a nat on the mean by a number that
# is searched for; what calibrations miss made it up to 12 on the frame, a loss of 150 % above 56.
MIN_LIKELIER = 20.0
# A change that is so much likelier than none [nats] may be: standard errors hold it.
MAY_BE = 5.0
# So much likelier than any other change [nats], e³ = 20 to one, it is taken.
MIN_AHEAD = 3.0
# The standard error of a size is found from likelihoods this share of its search interval away.
CURVED = 0.1


@dataclass(frozen=True)
class Change:
    """A change of the machine that explains a record better than the model does.

    Attributes
    ----------
    sensor : str
        Whose gain is another one; empty where it is the loss of heat.
    size : float
        That gain over the model's [1], or the rate by which every decay is faster [1/s].
    likelier : float
        Than no change [nats].
    ahead : float
        Than the next best change [nats].
    estimator, edge : KalmanEstimator
        Of the changed machine, and of one that has changed by a standard error more.
    slowest : tuple of float
        Slowest time constant of the sensors' responses before and after [s].
    inside : bool
        Whether it lies between the sizes that are tried: at their ends another may be likelier.
    is_enough : bool
        Whether the readings contradict the changed machine no more.
    taken : bool
        Whether estimates are those of the changed machine.
    """

    sensor: str
    size: float
    likelier: float
    ahead: float
    estimator: KalmanEstimator
    edge: KalmanEstimator
    slowest: tuple[float, float]
    inside: bool = True
    is_enough: bool = False
    taken: bool = False

    @property
    def explains(self) -> bool:
        """Whether the readings say clearly that it is this change, if any."""
        return self.inside and self.likelier > MIN_LIKELIER and self.ahead > MIN_AHEAD

    def document(self) -> dict[str, Any]:
        """As JSON."""
        size = {"gain": self.size} if self.sensor else {"decay_rate_per_s": self.size}
        return {
            "of": self.sensor or "loss of heat",
            **size,
            "likelier_nats": self.likelier,
            "ahead_nats": self.ahead,
            "taken": self.taken,
        }


def likeliest_change(
    kalman: KalmanEstimator,
    model_error: Sequence[float],
    gain_error: Sequence[float],
    time: Float,
    readings: Float,
    initial: Initial,
    level: Sequence[float],
) -> Change | None:
    """The change of a machine that makes a record likeliest; None where none is needed.

    Parameters
    ----------
    kalman : KalmanEstimator
        Of the design.
    model_error : sequence of float
        For each sensor what the model leaves of it beside noise [unit of the sensor],
    gain_error : sequence of float
        and that over the sensor's signal [1]: so far its gain may be off from the start.
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        Relative to rest; rows with NaN do not count.
    initial : {"rest", "settled", "free"}
        The machine at the first row.
    level : sequence of float, one for each drive [unit of the drive]
    """

    def likelihood(changed: KalmanEstimator) -> float:
        tested = checking_filter(changed, model_error)
        try:
            return log_likelihood(tested, time, readings, initial, level)
        except (FitError, LogError, np.linalg.LinAlgError):
            return -np.inf

    alone, slowest = likelihood(kalman), _slowest(kalman.sensed)
    if not np.isfinite(alone):
        return None
    found = []
    for sensor, tried, changed in _hypotheses(kalman, slowest):
        size, step, value = _likeliest(likelihood, changed, tried)
        inside = tried[0] < size < tried[-1]
        found.append((value - alone, sensor, size, step, changed, inside))
    found.sort(key=lambda each: -each[0])
    likelier, sensor, size, step, changed, inside = found[0]
    if not likelier > MAY_BE:
        return None
    other = changed(size)
    times = 1 / slowest, 1 / _slowest(other.sensed)
    ahead = likelier - max(found[1][0], 0.0)
    error = _standard_error(likelihood, changed, size, step, gain_error)
    edge = size + math.copysign(error, size - (1.0 if sensor else 0.0))
    return Change(sensor, size, likelier, ahead, other, changed(edge), times, inside)


def _hypotheses(
    kalman: KalmanEstimator, slowest: float
) -> Iterator[tuple[str, Sequence[float], Callable[[float], KalmanEstimator]]]:
    """Whose gain (or the loss), sizes that are tried first, and the machine with a size."""
    both = (*kalman.sensed, *kalman.followed)
    lasts = any(np.any(modes.poles.real >= 0) for _, _, modes in both)
    less = [] if lasts else [_slowest(both) * share for share in LESS]
    tried = [*less, *(slowest * share for share in MORE)]
    yield "", tried, partial(_with_loss, kalman)
    for k, sensor in enumerate(kalman.sensors):
        yield sensor, GAINS, partial(_with_gain, kalman, k)


def _likeliest(
    likelihood: Callable[[KalmanEstimator], float],
    machine: Callable[[float], KalmanEstimator],
    tried: Sequence[float],
) -> tuple[float, float, float]:
    """The likeliest size, a step beside it, and its likelihood."""
    # Slow to import, and the stream needs none of it.
    from scipy.optimize import minimize_scalar

    def of(size: float) -> float:
        return likelihood(machine(size))

    values = [of(each) for each in tried]
    best = int(np.argmax(values))
    low, high = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
    found = minimize_scalar(
        lambda x: -of(float(x)), bounds=(low, high), method="bounded",
        options={"xatol": 1e-3 * (high - low), "maxiter": MAX_EVALUATIONS},
    )  # fmt: skip
    size, value = tried[best], values[best]
    if -found.fun > value:
        size, value = float(found.x), float(-found.fun)
    return size, CURVED * (high - low), value


def _standard_error(
    likelihood: Callable[[KalmanEstimator], float],
    machine: Callable[[float], KalmanEstimator],
    size: float,
    step: float,
    gain_error: Sequence[float],
) -> float:
    """Of a size: by the likelihood, and by what the gains of the sensors are off from the start."""

    def vertex(changed: Callable[[KalmanEstimator], KalmanEstimator]) -> tuple[float, float]:
        low, mid, high = (likelihood(changed(machine(size + by))) for by in (-step, 0.0, step))
        bend = 2 * mid - low - high
        if not 0 < bend < math.inf:
            return 0.0, step
        return min(max(0.5 * (high - low) / bend, -10.0), 10.0) * step, step / math.sqrt(bend)

    at, error = vertex(lambda kalman: kalman)
    moved = [vertex(partial(_with_gain, sensor=k, gain=1 + by))[0] - at
             for k, by in enumerate(gain_error)]  # fmt: skip
    return math.hypot(error, *moved)


def _slowest(terms: Sequence[tuple[int, int, Modes]]) -> float:
    """The slowest rate of responses [1/s]; of those that decay."""
    rates = np.concatenate([-modes.poles.real for _, _, modes in terms])
    decaying = rates[rates > 0]
    return float(np.min(decaying)) if len(decaying) else 1.0


def _with_loss(kalman: KalmanEstimator, rate: float) -> KalmanEstimator:
    rate = max(rate, -MAX_LESS * _slowest((*kalman.sensed, *kalman.followed)))
    sensed, followed = (
        tuple((to, drive, replace(modes, poles=modes.poles - rate)) for to, drive, modes in terms)
        for terms in (kalman.sensed, kalman.followed)
    )
    return replace(kalman, sensed=sensed, followed=followed)


def _with_gain(kalman: KalmanEstimator, sensor: int, gain: float) -> KalmanEstimator:
    def of(modes: Modes) -> Modes:
        return replace(modes, weights=gain * modes.weights, double=gain * modes.double,
                       direct=gain * modes.direct)  # fmt: skip

    sensed = tuple(
        (to, drive, of(modes) if to == sensor else modes) for to, drive, modes in kalman.sensed
    )
    return replace(kalman, sensed=sensed)
