"""Whether a model still goes with its machine: a test of the readings along the way.

A Kalman filter that lets the heat change as fast as it likes runs beside the estimator: what no
heat explains is left to the sensors' noise. Four signs say that model and machine have parted: the
innovations squared, over what the filter expects (NIS), and drifts that the sensors would need and
that noise and model do not account for, both as means over half an hour; sensors that answer in
other ratios (`gain_test`); and readings that are likelier from a machine that loses more heat
(`loss_test`). It needs numpy alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.filter_track import FilterTrack
from thermaltool.estimation.gain_test import GainTest
from thermaltool.estimation.loss_test import LossTest, loss_rate
from thermaltool.estimation.start import Initial
from thermaltool.estimation.static_gains import checked_sensors
from thermaltool.responses.modes import Float
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.status import NOT_POSSIBLE, PARTED, QUIET

# The test's heat changes faster than that of the design by this factor: a step of heat, which a
# random walk does not expect, is no alarm.
WALK_FACTOR = 10.0
# Squares are averaged with weights that fall by e in this time [s]: half an hour counts.
WINDOW = 900.0
# A mean holds no fewer rows [1], however long they last: of a few, noise alone makes twice what is
# expected, and a step of heat more than a walk expects.
WINDOW_ROWS = 15
# Mean of the normalized innovations squared, per sensor, above which they contradict: 1 is
# expected, and transients that the model misses raised it to 1.5 within 5 h on the frame.
MAX_NIS = 2.0
# Mean square of the drifts that the sensors would need, over what noise and model leave: up to 2.8
# within 5 h on the frame as it was calibrated, 12 to 21 with a loss of heat of 150 %.
MAX_DRIFT = 5.0
# What a model gets wrong of a sensor lasts so long [s]: it shows while a heat changes.
MISFIT_TIME = 60.0
# After a pause of more than so many periods the machine may be warm in any way. Where a response
# does not decay the heat may be any, which the steady gain follows in a while: so long [s], and for
# as many periods, nothing is tested.
MAX_PAUSE, BLIND_TIME = 5, 60.0
# A first reading further from rest than so many standard deviations of noise and model says that
# the machine is warm [1].
MAX_REST = 5.0
# Ratios and losses are tested where signals are so many times what is expected of an innovation
# (whitened): the heat of a machine that idles is noise, which answers in no ratio.
MIN_SIGNAL = 10.0
# A quiet record of which a smaller share of the rows counts says how many do.
MIN_TESTED = 0.5


@dataclass(frozen=True)
class Alarm:
    """What the test says of a record.

    Attributes
    ----------
    word : str
        "quiet", "parted" or "not possible".
    reason : str
        What says so; of a quiet one, what it has not looked at.
    row : int or None
        From which on model and machine have parted.
    """

    word: str
    reason: str = ""
    row: int | None = None

    def document(self, time: Float) -> dict[str, Any]:
        """As JSON, with the moment at which it comes.

        Parameters
        ----------
        time : ndarray, shape (n,) [s]
            Of the record.
        """
        at = None if self.row is None else float(time[self.row])
        return {"word": self.word, "reason": self.reason, "time_s": at}


class InnovationTest:
    """The test of one stream or record, row by row.

    Parameters
    ----------
    estimator : KalmanEstimator
    period : float [s]
        The expected sample length.
    model_error : sequence of float
        For each sensor what the model leaves of it beside noise [unit of the sensor].
    gain_error : sequence of float, optional
        That over the sensor's signal [1]; without it the ratios of the sensors are not tested.
    level : sequence of float, one for each drive, optional
        Standard deviation of the heat that a warm machine has had [unit of the drive]; without it
        every machine begins at rest, and a pause leaves the heat as it was.

    Attributes
    ----------
    nis : float
        Mean of the normalized innovations squared, per sensor.
    drift : float
        Mean square of the sensors' drifts, over what noise and model leave of them.
    can_tell : bool
        Whether a sensor can contradict the others: else some heat explains any reading.
    blind_spot : str
        What the test cannot see, and why; empty where it sees every sensor.
    counted : bool
        Whether the last row has been tested.
    """

    def __init__(
        self,
        estimator: KalmanEstimator,
        period: float,
        model_error: Sequence[float],
        gain_error: Sequence[float] = (),
        level: Sequence[float] = (),
    ) -> None:
        self._filter = checking_filter(estimator, model_error)
        noise = self._filter.noise
        self._period = max(round(period / CLOCK_STEP), 1)
        self._track = FilterTrack(self._filter, self._period, level)
        self._allowed = np.array([each.drift for each in noise])
        self._sensors, self._modal = len(noise), self._filter.modal
        self._blind = 0
        self.nis, self.drift, self.counted = 1.0, 1.0, False
        checked = checked_sensors(estimator)
        self.can_tell = bool(np.any(checked))
        self.blind_spot = _blind_spot(estimator, checked)
        self._gains = None
        if gain_error and self.can_tell:
            self._gains = GainTest(_shares(estimator), gain_error)
            self._gains.start(len(self._track.x))
        self._loss = None
        if self._gains is not None and (rate := loss_rate(self._filter, gain_error)) is not None:
            self._loss = LossTest(self._filter, rate, self._period, level)

    def start(self, readings: Float, initial: Initial = "rest") -> None:
        """Begin at the first readings.

        Of a machine that is warm rows count as soon as they tell of it more than of its start.

        Parameters
        ----------
        readings : ndarray, shape (n_sensors,)
        initial : {"rest", "settled", "free"}
            At rest, settled at the readings, or warm, of which no more is known; free of a response
            that does not decay: at rest. So is a machine at rest that reads otherwise.
        """
        self._track.start(readings, initial == "settled")
        self._blind = 0
        self.nis, self.drift, self.counted = 1.0, 1.0, False
        if self._gains is not None:
            self._gains.start(len(self._track.x))
        if self._loss is not None:
            self._loss.start(readings, initial == "settled")
        if initial == "free" or (initial == "rest" and np.any(not_rest(self._filter, readings))):
            self._free(readings)

    def _free(self, readings: Float, ticks: int = 0) -> bool:
        """Go on from a reading of a machine that is warm, if any, so much later; means stay."""
        if not self._track.free(readings):
            return False
        if self._gains is not None:
            self._gains.forget_state()
        if self._loss is not None:
            self._loss.free(ticks, readings)
        self._blind, self.counted = 0, False
        return True

    def step(self, ticks: int, readings: Float) -> None:
        """Take the readings after a sample of `ticks` clock steps.

        Parameters
        ----------
        ticks : int
        readings : ndarray, shape (n_sensors,)
        """
        if ticks > MAX_PAUSE * self._period and self._free(readings, ticks):
            return
        row = self._track.step(ticks, readings)
        sample, z, dt = row.sample, row.z, ticks * CLOCK_STEP
        counts = self._blind <= 0 and row.counts
        if ticks > MAX_PAUSE * self._period:
            self._blind = max(round(BLIND_TIME / CLOCK_STEP), MAX_PAUSE * self._period)
            counts = False
        if self._gains is not None:
            signals = sample.H[:, : self._modal] @ row.foretold[: self._modal]
            shows = counts and float(np.linalg.norm(sample.root @ signals)) > MIN_SIGNAL
            self._gains.step(sample, signals, z, dt, shows)
            if self._loss is not None:
                self._loss.step(ticks, readings, row, shows)
        if self._blind > 0:
            self._blind -= min(ticks, self._period)
        self.counted = counts
        if not counts:
            return
        weight = min(-math.expm1(-dt / WINDOW), 1 / WINDOW_ROWS)
        drift = self._track.x[-self._sensors :] / self._allowed
        self.nis += weight * (float(z @ z) / self._sensors - self.nis)
        self.drift += weight * (float(drift @ drift) / self._sensors - self.drift)

    @property
    def alarm(self) -> bool:
        """Whether model and machine have parted."""
        changed = self.nis > MAX_NIS or self.drift > MAX_DRIFT
        changed = changed or self._ratios_differ or self._loses_more
        return self.can_tell and changed

    @property
    def _ratios_differ(self) -> bool:
        return self._gains is not None and self._gains.value > self._gains.limit

    @property
    def _loses_more(self) -> bool:
        return self._loss is not None and self._loss.alarm

    @property
    def reason(self) -> str:
        """What raises the alarm."""
        if self.nis > MAX_NIS:
            return f"normalized innovations squared of {self.nis:.3g} (1 is expected)"
        if self._gains is not None and self._ratios_differ:
            gains = self._gains.gains()
            found = ", ".join(f"{name} {100 * (gain - 1):+.2g} %" for name, gain in
                              zip(self._filter.sensors, gains, strict=True))  # fmt: skip
            return (f"the sensors' ratios differ from the model's ({found}; chi-squared "
                    f"{self._gains.value:.3g}, limit {self._gains.limit:.3g})")  # fmt: skip
        if self._loss is not None and self._loses_more:
            return (f"the readings are {self._loss.value:.3g} nats likelier from a machine that "
                    "loses more heat, its slowest time constant "
                    f"{self._loss.shorter_percent:.2g} % shorter")  # fmt: skip
        drift = self._track.x[-self._sensors :]
        worst = int(np.argmax(np.abs(drift) / self._allowed))
        return (
            f"{self._filter.sensors[worst]} would have to drift by {drift[worst]:.3g}, the mean "
            f"square of the drifts is {self.drift:.3g} (1 is expected)"
        )

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        x, unknown = self._track.state()
        gains = [] if self._gains is None else [self._gains.state()]
        loss = [] if self._loss is None else [{"loss": self._loss.state()}]
        start = [] if unknown is None else [{"start": unknown}]
        return [x, self.nis, self.drift, self._blind, *gains, *loss, *start]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this test.
        """
        x, nis, drift, blind, *more = values
        named = {k: v for each in more if isinstance(each, dict) for k, v in each.items()}
        gains = [each for each in more if not isinstance(each, dict)]
        if not np.isfinite([nis, drift]).all() or len(gains) != (self._gains is not None):
            raise ValueError("not a state of this test")
        if ("loss" in named) != (self._loss is not None) or not named.keys() <= {"loss", "start"}:
            raise ValueError("not a state of this test")
        self._track.resume(x, named.get("start"))
        if self._loss is not None:
            self._loss.resume(named["loss"])
        if self._gains is not None:
            self._gains.start(len(self._track.x))
            self._gains.resume(*gains)
        self.nis, self.drift, self._blind = float(nis), float(drift), int(blind)


def not_rest(checking: KalmanEstimator, readings: Float) -> NDArray[np.bool_]:
    """Of which sensors a first reading says that the machine is not at rest, shape (n_sensors,).

    Parameters
    ----------
    checking : KalmanEstimator
        What `checking_filter` gives.
    readings : ndarray, shape (n_sensors,)
        Relative to rest; NaN, of a sensor without a reading, says nothing.
    """
    noise = np.array([math.hypot(each.white, each.drift) for each in checking.noise])
    return np.asarray(np.abs(readings) > MAX_REST * noise)


def checking_filter(estimator: KalmanEstimator, model_error: Sequence[float]) -> KalmanEstimator:
    """The filter of the test: a heat that changes fast, sensors with what the model leaves of them.

    Parameters
    ----------
    estimator : KalmanEstimator
    model_error : sequence of float
        For each sensor [unit of the sensor].
    """
    walk = tuple(WALK_FACTOR * each for each in estimator.walk)
    noise = tuple(
        each if each.drift else replace(each, drift=each.white)
        for each in with_misfit(estimator, model_error).noise
    )
    # What follows the heat is not read.
    return replace(estimator, outputs=(), followed=(), walk=walk, noise=noise)


def with_misfit(estimator: KalmanEstimator, model_error: Sequence[float]) -> KalmanEstimator:
    """An estimator whose sensors have what the model leaves of them, beside their noise.

    Parameters
    ----------
    estimator : KalmanEstimator
    model_error : sequence of float
        For each sensor [unit of the sensor].
    """
    return replace(estimator, noise=tuple(map(_with_misfit, estimator.noise, model_error)))


def _with_misfit(noise: SensorNoise, error: float) -> SensorNoise:
    """A sensor's noise with what the model leaves of it, as a drift of both sizes and times."""
    drift = math.hypot(noise.drift, error)
    if not drift:
        return noise
    rate = (noise.drift**2 / noise.drift_time + error**2 / MISFIT_TIME) / drift**2
    return replace(noise, drift=drift, drift_time=1 / rate)


def _blind_spot(estimator: KalmanEstimator, checked: NDArray[np.bool_]) -> str:
    """What no other sensor can contradict, and why."""
    if checked.all():
        return ""
    alone = ", ".join(np.array(estimator.sensors)[~checked].tolist())
    if checked.any():
        return f"no alarm of {alone}: no other sensor shows the same heat"
    few = len(estimator.sensors) <= len(estimator.drives)
    why = "no more sensors than drives" if few else "no two sensors show the same drive"
    where = "no alarm is possible where model and machine part"
    return f"{where}: {why}, some heat explains any reading"


def _shares(estimator: KalmanEstimator) -> Float:
    """Share of each drive in what a sensor shows of drives that wander as they do."""
    found = np.zeros((len(estimator.sensors), len(estimator.drives)))
    for sensor, drive, modes in estimator.sensed:
        found[sensor, drive] += abs(modes.dc_gain()) * estimator.walk[drive]
    return found / np.maximum(np.sum(found, axis=1, keepdims=True), 1e-300)


def record_alarm(
    test: InnovationTest,
    time: Float,
    readings: Float,
    initial: Initial = "rest",
) -> Alarm:
    """Whether, and from which row on, the test says that model and machine have parted.

    Parameters
    ----------
    test : InnovationTest
        At its beginning.
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        Rows with NaN are passed over.
    initial : {"rest", "settled", "free"}
        The machine at the first row; see `InnovationTest.start`.
    """
    if not test.can_tell:
        return Alarm(NOT_POSSIBLE, test.blind_spot)
    rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
    if len(rows) < 2:
        return Alarm(NOT_POSSIBLE, "no alarm is possible: no two rows have readings of all sensors")
    # Whatever the machine has done before its sensors are read is not known.
    test.start(readings[rows[0]], "free" if rows[0] else initial)
    ticks = np.round(np.diff(time[rows]) / CLOCK_STEP).astype(np.int64).tolist()
    tested = 0
    for length, row in zip(ticks, rows[1:].tolist(), strict=True):
        test.step(length, readings[row])
        tested += test.counted
        if test.alarm:
            return Alarm(PARTED, test.reason, int(row))
    if not tested:
        return Alarm(NOT_POSSIBLE, "no alarm is possible: no row could be tested")
    if tested < MIN_TESTED * len(time):
        few = f"{tested} of {len(time)} rows could be tested"
        return Alarm(QUIET, "; ".join(filter(None, (few, test.blind_spot))))
    return Alarm(QUIET, test.blind_spot)
