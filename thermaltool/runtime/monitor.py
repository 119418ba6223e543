"""What a stream tells of its estimates beside them: late ones, standard errors, the alarm."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.fixed_lag import FixedLag, without_readings
from thermaltool.estimation.innovation_test import (
    NOT_POSSIBLE,
    PARTED,
    QUIET,
    UNTESTED,
    InnovationTest,
)
from thermaltool.estimation.stream_bands import stream_bands
from thermaltool.runtime.messages import Report
from thermaltool.runtime.process import ALARM

# Before the names of estimates: of their standard error, and of a late one.
SIGMA, LATE = "sigma_", "late_"
# Choices of sensors that are left out whose standard errors are kept.
MAX_LOST_CACHED = 16


class Monitor:
    """Runs beside the estimator on the same readings.

    Parameters
    ----------
    estimator : KalmanEstimator
        That of the design, without known inputs.
    design : mapping
    period : float [s]
    report : callable
        Gets (channel, message) when model and machine part, and when they agree again.
    bands : bool
        Standard errors, and the alarm.
    lag : float or None [s]
        Late estimates.

    Attributes
    ----------
    names : tuple of str
        Of the columns.
    alarm : bool
        Whether model and machine have parted.
    """

    def __init__(
        self,
        estimator: KalmanEstimator,
        design: Mapping[str, Any],
        period: float,
        report: Report,
        *,
        bands: bool,
        lag: float | None,
    ) -> None:
        self._report = report
        self._late = None if lag is None else FixedLag(estimator, lag, period)
        self._test: InnovationTest | None = None
        self._sigma: list[float] = []
        self._latest = [0.0] * len(estimator.estimates)
        self._estimator, self._period = estimator, period
        self._lost: tuple[int, ...] = ()
        self._widened = lru_cache(MAX_LOST_CACHED)(self._widening)
        # Clock steps that each has not seen.
        self._late_ticks = self._test_ticks = 0
        names: list[str] = []
        if bands:
            if "bands" not in design:
                raise ModelError("the design has no standard errors: run regularize again")
            kept = stream_bands(design, len(estimator.estimates))
            self._sigma, self._relative, error, gain_error = kept
            test = InnovationTest(estimator, period, error, gain_error)
            self._test = test if test.can_tell else None
            if test.blind_spot:
                report("", test.blind_spot)
            names += [SIGMA + name for name in estimator.estimates]
        if self._late is not None:
            names += [LATE + name for name in estimator.estimates]
        if bands:
            names.append(ALARM)
        self.names, self.alarm, self._tested = tuple(names), False, False

    def start(self, readings: Sequence[float], settled: bool) -> None:
        """Begin at the first readings: at rest, or settled at them."""
        first = np.array(readings)
        for part in (self._late, self._test):
            if part is not None:
                part.start(first, settled)
        self._latest = [0.0] * len(self._latest)
        self._late_ticks = self._test_ticks = 0
        self.alarm = self._tested = False

    def step(
        self, ticks: int, readings: Sequence[float], good: bool, lost: Collection[int] = ()
    ) -> None:
        """Take the readings after a sample of `ticks` clock steps, but those of `lost` sensors.

        Where they are not `good` (held, or of a sensor that is left out) nothing is tested.
        """
        now = np.array(readings)
        self._lost = tuple(sorted(lost))
        self._late_ticks += ticks
        self._test_ticks += ticks
        self._tested = False
        if not np.isfinite(now).all():
            return
        if self._late is not None:
            self._late.step(self._late_ticks, now, lost)
            self._late_ticks = 0
            late = self._late.latest_due()
            if late is not None:
                self._latest = late.tolist()
        if self._test is not None and good:
            self._test.step(self._test_ticks, now)
            self._tested = self._test.counted
            self._test_ticks = 0
            if self._test.alarm != self.alarm:
                self.alarm = self._test.alarm
                why = f"model and machine have parted: {self._test.reason}"
                self._report("", why if self.alarm else "model and machine agree again")

    @property
    def _word(self) -> str:
        """What the alarm says of the last row."""
        if self._test is None:
            return NOT_POSSIBLE
        if self.alarm:
            return PARTED
        return QUIET if self._tested else UNTESTED

    def values(self, estimates: Sequence[float]) -> list[Any]:
        """The columns beside these estimates; late ones are at rest until there are any."""
        written: list[Any] = []
        if self._sigma:
            more = self._widened(self._lost) if self._lost else [0.0] * len(self._sigma)
            written += [
                math.hypot(sigma, relative * estimate, beside)
                for sigma, relative, estimate, beside in zip(
                    self._sigma, self._relative, estimates, more, strict=True
                )
            ]
        if self._late is not None:
            written += self._latest
        return [*written, self._word] if self._sigma else written

    def _widening(self, lost: tuple[int, ...]) -> list[float]:
        """Standard error of every estimate that comes of doing without some sensors."""
        estimator, variances = self._estimator, []
        for each in (without_readings(estimator, lost), estimator):
            space, (P, G) = each.state_space(self._period), each.steady(self._period)
            filtered = P - G @ (space.H @ P)
            variances.append(np.sum((space.C @ filtered) * space.C, axis=1))
        return np.sqrt(np.maximum(variances[0] - variances[1], 0.0)).tolist()

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        parts = [None if part is None else part.state() for part in (self._late, self._test)]
        return [*parts, self._latest, self._late_ticks, self._test_ticks]

    def resume(self, values: list[Any]) -> None:
        """Go on from a state.

        Raises
        ------
        ValueError
            Not a state of this monitor.
        """
        for part, kept in zip((self._late, self._test), values, strict=False):
            if (part is None) != (kept is None):
                raise ValueError("not a state of this monitor")
            if part is not None:
                part.resume(kept)
        self._latest = [float(each) for each in values[2]]
        self._late_ticks, self._test_ticks = map(int, values[3:])
        self.alarm = self._test is not None and self._test.alarm
