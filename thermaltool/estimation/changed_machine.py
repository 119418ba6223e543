"""How a machine has changed since its calibration, where its record says so.

Its loss of heat may be another one, or one sensor's gain or pace.

A loss of heat that is larger everywhere lets every temperature decay faster: all poles of the
responses move by one rate ν [1/s] and their residues stay, exactly for a body with a loss of its
whole surface that is thin (a fin), nearly for one that conducts better than it loses. A sensor that
has come loose shows less of the same; with other time constants (those of the model may be a little
wrong) it shows the same later or earlier. Each hypothesis has one number, which is taken where the
readings are likeliest, in the filter of the innovation test: what the calibration leaves of each
sensor counts as noise there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from thermaltool.errors import FitError, LogError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.innovation_test import Alarm, checking_filter
from thermaltool.estimation.likelihood import log_likelihood
from thermaltool.estimation.loss_test import slowest_rate, with_loss_rate
from thermaltool.estimation.start import Initial
from thermaltool.responses.modes import Float, Modes
from thermaltool.status import PARTED, QUIET

# Rates of the loss that are tried first, over the slowest rate of a response [1]: of less, of more,
LESS = (-0.9, -0.7, -0.55, -0.4, -0.2, -0.1, -0.05)
MORE = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
# and gains of a sensor over the model's [1].
GAINS = (0.2, 0.35, 0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 1.01, 1.03, 1.07, 1.15, 1.3, 1.5)
# Factors on the time constants of a sensor's responses [1]: beyond, it is another sensor.
PACES = (0.8, 0.9, 0.95, 0.98, 0.99, 1.01, 1.02, 1.05, 1.11, 1.25)
MAX_EVALUATIONS, SIZE_TOLERANCE = 12, 3e-3
# No loss falls by more of the slowest rate, the deflections' too: without any nothing would settle.
MAX_LESS = 0.95
# So much likelier than no change [nats]. Right models gain half a nat on the mean by a number that
# is searched for; what calibrations miss made it up to 12 on the frame, a loss of 150 % above 56.
MIN_LIKELIER = 20.0
# A change that is so much likelier than none [nats] may be: standard errors hold it.
MAY_BE = 5.0
# So much likelier than any other change [nats], e³ = 20 to one, it is taken.
MIN_AHEAD = 3.0
# A smaller change of the loss, over the slowest rate, is none of the machine [1]: calibrations have
# time constants wrong by percents.
MIN_LOSS = 0.05
# The standard error of a size is found from likelihoods this share of its search interval away.
CURVED = 0.1


Kind = Literal["loss", "gain", "pace"]


@dataclass(frozen=True)
class Change:
    """A change of the machine that explains a record better than the model does.

    Attributes
    ----------
    kind : {"loss", "gain", "pace"}
        Of heat, or of what a sensor shows.
    sensor : str
        Whose gain or pace it is; empty where it is the loss of heat.
    size : float
        That gain over the model's [1], the time constants over the model's [1], or the rate by
        which every decay is faster [1/s].
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
    most : bool
        Whether less is left beside it than it explains.
    is_enough : bool
        Whether the readings contradict the changed machine no more.
    taken : bool
        Whether estimates are those of the changed machine.
    """

    kind: Kind
    sensor: str
    size: float
    likelier: float
    ahead: float
    estimator: KalmanEstimator
    edge: KalmanEstimator
    slowest: tuple[float, float]
    inside: bool = True
    most: bool = True
    is_enough: bool = False
    taken: bool = False

    @property
    def explains(self) -> bool:
        """Whether the readings say clearly that it is this change, if any."""
        clear = self.likelier > MIN_LIKELIER and self.ahead > MIN_AHEAD
        whole = self.inside and self.most
        return clear and whole and (self.kind != "loss" or abs(self.share) > MIN_LOSS)

    @property
    def is_clear(self) -> bool:
        """Whether it is clear: of a sensor with or without an alarm, of a loss that ends it."""
        return self.explains and (self.is_enough or self.kind != "loss")

    @property
    def share(self) -> float:
        """Of the model's loss, gain or time constants so much more [1]."""
        before, after = self.slowest
        return before / after - 1 if self.kind == "loss" else self.size - 1

    def document(self) -> dict[str, Any]:
        """As JSON."""
        names = {"loss": "decay_rate_per_s", "gain": "gain", "pace": "time_constants"}
        size = {names[self.kind]: self.size, "more_percent": 100 * self.share}
        return {
            "of": self.sensor or "loss of heat",
            "kind": self.kind,
            **size,
            "likelier_nats": self.likelier,
            "ahead_nats": self.ahead,
            "clear": self.is_clear,
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

    alone, slowest = likelihood(kalman), slowest_rate(kalman.sensed)
    if not np.isfinite(alone):
        return None
    found = []
    for kind, sensor, tried, changed in _hypotheses(kalman, slowest):
        size, step, value = _likeliest(likelihood, changed, tried, float(kind != "loss"), alone)
        inside = tried[0] < size < tried[-1]
        found.append((value - alone, kind, sensor, size, step, changed, inside))
    found.sort(key=lambda each: -each[0])
    # The best of so many would be likelier by chance.
    price = math.log(len(found))
    likelier, kind, sensor, size, step, changed, inside = found[0]
    likelier -= price
    if not likelier > MAY_BE:
        return None
    other = changed(size)
    times = 1 / slowest, 1 / slowest_rate(other.sensed)
    ahead = likelier - max(found[1][0] - price, 0.0)
    error = _standard_error(likelihood, changed, size, step, gain_error)
    edge = size + math.copysign(error, size - (1.0 if sensor else 0.0))
    return Change(kind, sensor, size, likelier, ahead, other, changed(edge), times, inside)


def with_loss(alarm: Alarm, change: Change | None) -> Alarm:
    """An alarm also where the loss of heat is told to be another one, which ratios show late.

    Parameters
    ----------
    alarm : Alarm
    change : Change or None
        Of the same record.
    """
    if alarm.word != QUIET or change is None or change.kind != "loss" or not change.is_clear:
        return alarm
    more = "more" if change.size > 0 else "less"
    return Alarm(PARTED, f"the machine loses {abs(100 * change.share):.3g} % {more} heat")


def _hypotheses(
    kalman: KalmanEstimator, slowest: float
) -> Iterator[tuple[Kind, str, Sequence[float], Callable[[float], KalmanEstimator]]]:
    """What, whose, sizes that are tried first, and the machine with a size."""
    both = (*kalman.sensed, *kalman.followed)
    lasts = any(np.any(modes.poles.real >= 0) for _, _, modes in both)
    less = [] if lasts else [slowest_rate(both) * share for share in LESS]
    tried = [*less, *(slowest * share for share in MORE)]
    yield "loss", "", tried, partial(_with_loss, kalman)
    for k, sensor in enumerate(kalman.sensors):
        yield "gain", sensor, GAINS, partial(with_gain, kalman, k)
        yield "pace", sensor, PACES, partial(with_pace, kalman, k)


def _likeliest(
    likelihood: Callable[[KalmanEstimator], float],
    machine: Callable[[float], KalmanEstimator],
    tried: Sequence[float],
    none: float,
    alone: float,
) -> tuple[float, float, float]:
    """The likeliest size, a step beside it, and its likelihood.

    Sizes are tried one after the other, uphill from `none`, where it is `alone`.
    """
    # Slow to import, and the stream needs none of it.
    from scipy.optimize import minimize_scalar

    def of(size: float) -> float:
        return likelihood(machine(size))

    sizes = sorted([*tried, none])
    best = sizes.index(none)
    values = {best: alone}
    for step in (1, -1):
        while 0 <= best + step < len(sizes):
            values[best + step] = of(sizes[best + step])
            if not values[best + step] > values[best]:
                break
            best += step
        if sizes[best] != none:
            break
    low, high = sizes[max(best - 1, 0)], sizes[min(best + 1, len(sizes) - 1)]
    found = minimize_scalar(
        lambda x: -of(float(x)), bounds=(low, high), method="bounded",
        options={"xatol": SIZE_TOLERANCE * (high - low), "maxiter": MAX_EVALUATIONS},
    )  # fmt: skip
    size, value = sizes[best], values[best]
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
    moved = [vertex(partial(with_gain, sensor=k, gain=1 + by))[0] - at
             for k, by in enumerate(gain_error)]  # fmt: skip
    return math.hypot(error, *moved)


def _with_loss(kalman: KalmanEstimator, rate: float) -> KalmanEstimator:
    """Another loss; never so much less that nothing would settle."""
    both = (*kalman.sensed, *kalman.followed)
    return with_loss_rate(kalman, max(rate, -MAX_LESS * slowest_rate(both)))


def with_gain(kalman: KalmanEstimator, sensor: int, gain: float) -> KalmanEstimator:
    """An estimator of which one sensor shows `gain` times as much.

    Parameters
    ----------
    kalman : KalmanEstimator
    sensor : int
    gain : float [1]
    """

    def of(modes: Modes) -> Modes:
        return replace(modes, weights=gain * modes.weights, double=gain * modes.double,
                       direct=gain * modes.direct)  # fmt: skip

    return _with_responses(kalman, sensor, of)


def with_pace(kalman: KalmanEstimator, sensor: int, slower: float) -> KalmanEstimator:
    """An estimator of which one sensor's time constants are `slower` times as long.

    Its steady states stay: H(s) becomes H(`slower` s).

    Parameters
    ----------
    kalman : KalmanEstimator
    sensor : int
    slower : float [1]
    """

    def of(modes: Modes) -> Modes:
        return replace(modes, poles=modes.poles / slower, weights=modes.weights / slower,
                       double=modes.double / slower**2)  # fmt: skip

    return _with_responses(kalman, sensor, of)


def _with_responses(
    kalman: KalmanEstimator, sensor: int, of: Callable[[Modes], Modes]
) -> KalmanEstimator:
    sensed = tuple(
        (to, drive, of(modes) if to == sensor else modes) for to, drive, modes in kalman.sensed
    )
    return replace(kalman, sensed=sensed)
