"""Whether a machine loses more heat than its model: a cumulative sum of likelihood ratios.

Beside the filter of the model runs that of a machine that loses a given amount more; the logarithm
of the likelihood ratio is summed over the rows, never below zero, and is an alarm where it is large
(Page 1954; Lorden 1971). The sum forgets, as that of the ratios does. A loss of half that amount is
where it begins to rise: a calibration that is a little wrong makes no alarm. It needs numpy alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.filter_track import FilterTrack, TrackedRow
from thermaltool.estimation.gain_test import MEMORY
from thermaltool.responses.modes import Float, Modes
from thermaltool.responses.sample_clock import CLOCK_STEP

# The loss that is tested makes every decay faster by this share of the slowest one [1]: on a frame
# of finite elements that of films half as strong again.
LOSS = 0.35
# Or by so much more that the sensors' ratios move by so many standard errors of the gains [1]: it
# is told from none at half of them.
MIN_RATIOS = 8.0
# No larger loss is tested, over the slowest rate [1].
MAX_LOSS = 25.6
# The sum that is an alarm [nats]: without a change 20 rows a minute exceed 17 once in a thousand
# days (Lorden 1971); models that a calibration has a percent wrong made it up to 33 on clean days.
MIN_LIKELIER = 40.0
# The sum goes no further beyond the alarm [1]: a machine that is mended ends it.
MOST = 2.0


class LossTest:
    """The test of one stream or record.

    Parameters
    ----------
    checking : KalmanEstimator
        The filter of the innovation test.
    rate : float
        By which every decay of the machine that loses more is faster [1/s].
    period : int
        The expected sample length in clock steps.
    level : sequence of float, one for each drive
        As for `FilterTrack`.

    Attributes
    ----------
    value : float
        The sum [nats].
    shorter_percent : float
        The slowest time constant of the machine that loses more, below that of the model.
    """

    def __init__(
        self, checking: KalmanEstimator, rate: float, period: int, level: Sequence[float]
    ) -> None:
        self._track = FilterTrack(with_loss_rate(checking, rate), period, level)
        slowest = slowest_rate(checking.sensed)
        self.shorter_percent, self.value = 100 * rate / (slowest + rate), 0.0

    @property
    def alarm(self) -> bool:
        """Whether the machine loses more."""
        return self.value > MIN_LIKELIER

    def start(self, readings: Float, settled: bool) -> None:
        """Begin at the first readings, at rest or settled at them."""
        self._track.start(readings, settled)
        self.value = 0.0

    def free(self, ticks: int, readings: Float) -> None:
        """Go on from a reading of a warm machine after a pause, over which the sum forgets."""
        self._forget(ticks)
        if not self._track.free(readings):
            self.value = 0.0

    def step(self, ticks: int, readings: Float, model: TrackedRow, counts: bool) -> None:
        """Take a row.

        Parameters
        ----------
        ticks : int
        readings : ndarray, shape (n_sensors,)
        model : TrackedRow
            What the filter of the model says of it.
        counts : bool
            Whether this row may say something.
        """
        row = self._track.step(ticks, readings)
        self._forget(ticks)
        if counts and row.counts:
            value = self.value + row.log_density - model.log_density
            self.value = min(max(value, 0.0), MOST * MIN_LIKELIER)

    def _forget(self, ticks: int) -> None:
        self.value *= math.exp(-ticks * CLOCK_STEP / MEMORY)

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        return [self.value, *self._track.state()]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this test.
        """
        value, x, unknown = values
        if not 0 <= float(value) < np.inf:
            raise ValueError("not a state of this test")
        self._track.resume(x, unknown)
        self.value = float(value)


def loss_rate(estimator: KalmanEstimator, gain_error: Sequence[float]) -> float | None:
    """The rate by which every decay is faster on the machine that is tested [1/s]; None if none is.

    Parameters
    ----------
    estimator : KalmanEstimator
    gain_error : sequence of float
        Standard deviation of each sensor's gain around that of the model [1].
    """
    if any(np.any(modes.poles.real >= 0) for _, _, modes in estimator.sensed):
        return None
    slowest, share = slowest_rate(estimator.sensed), LOSS
    while share < MAX_LOSS:
        moved = _ratios_moved(estimator, share * slowest, gain_error)
        if moved >= MIN_RATIOS:
            return share * slowest
        # Ratios move less than in proportion.
        share *= min(max(MIN_RATIOS / max(moved, 1e-3), 1.02), 2.0)
    return None


def _ratios_moved(estimator: KalmanEstimator, rate: float, gain_error: Sequence[float]) -> float:
    """Change of the steady ratios of the sensors, over the standard errors of their gains [1]."""
    moved = np.zeros(len(estimator.drives))
    lossy = with_loss_rate(estimator, rate).sensed
    for drive in range(len(moved)):
        pairs = [
            (abs(after.dc_gain() / before.dc_gain()), gain_error[sensor])
            for (sensor, of, before), (_, _, after) in zip(estimator.sensed, lossy, strict=True)
            if of == drive and before.dc_gain()
        ]
        if pairs:
            gains, errors = np.array(pairs).T
            changes, weights = np.log(np.maximum(gains, 1e-300)), errors**-2.0
            # What all sensors have in common is another heat.
            changes = changes - np.sum(weights * changes) / np.sum(weights)
            moved[drive] = np.sqrt(np.sum(weights * changes**2))
    return float(np.max(moved))


def slowest_rate(terms: Sequence[tuple[int, int, Modes]]) -> float:
    """The slowest rate of responses that decays [1/s]; 1 where none does.

    Parameters
    ----------
    terms : sequence of (int, int, Modes)
    """
    rates = np.concatenate([-modes.poles.real for _, _, modes in terms])
    decaying = rates[rates > 0]
    return float(np.min(decaying)) if len(decaying) else 1.0


def with_loss_rate(estimator: KalmanEstimator, rate: float) -> KalmanEstimator:
    """The estimator of a machine that loses more heat everywhere: every pole moves, residues stay.

    Parameters
    ----------
    estimator : KalmanEstimator
    rate : float [1/s]
    """
    sensed, followed = (
        tuple((to, drive, replace(modes, poles=modes.poles - rate)) for to, drive, modes in terms)
        for terms in (estimator.sensed, estimator.followed)
    )
    return replace(estimator, sensed=sensed, followed=followed)
