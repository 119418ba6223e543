"""What a stream tells of its estimates beside them: late ones, standard errors, the alarm."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.fixed_lag import FixedLag
from thermaltool.estimation.innovation_test import InnovationTest
from thermaltool.estimation.running_error import RunningError
from thermaltool.estimation.start import Initial
from thermaltool.estimation.stream_bands import stream_bands
from thermaltool.runtime.messages import Report
from thermaltool.status import ALARM, NOT_POSSIBLE, PARTED, QUIET, UNTESTED

# Before the names of estimates: of their standard error, and of a late one.
SIGMA, LATE = "sigma_", "late_"


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
    level : sequence of float, one for each drive
        How large a heat may be at the first row [unit of the drive].
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
        level: Sequence[float] = (),
    ) -> None:
        self._report = report
        self._late = None if lag is None else FixedLag(estimator, lag, period)
        self._test: InnovationTest | None = None
        self._error: RunningError | None = None
        self._latest = [0.0] * len(estimator.estimates)
        # Clock steps that late estimates and standard errors, and that the test has not seen.
        self._late_ticks = self._test_ticks = 0
        names: list[str] = []
        if bands:
            if "bands" not in design:
                raise ModelError("the design has no standard errors: run regularize again")
            kept = stream_bands(design, len(estimator.estimates))
            self._relative, error, gain_error = kept
            self._error = RunningError(estimator, period, level)
            test = InnovationTest(estimator, period, error, gain_error, level)
            self._test = test if test.can_tell else None
            if test.blind_spot:
                report("", test.blind_spot)
            names += [SIGMA + name for name in estimator.estimates]
        if self._late is not None:
            names += [LATE + name for name in estimator.estimates]
        if bands:
            names.append(ALARM)
        self.names, self.alarm, self._tested = tuple(names), False, False
        self._begins = False

    def start(self, readings: Sequence[float], initial: Initial) -> None:
        """Begin at the first readings: at rest, settled at them, or of a warm machine."""
        first = np.array(readings)
        if self._late is not None:
            self._late.start(first, initial == "settled")
        if self._test is not None:
            self._test.start(first, initial)
        if self._error is not None:
            self._error.start(initial)
        self._latest = [0.0] * len(self._latest)
        self._late_ticks = self._test_ticks = 0
        self.alarm = self._tested = self._begins = False

    def step(
        self, ticks: int, readings: Sequence[float], good: bool, lost: Collection[int] = ()
    ) -> None:
        """Take the readings after a sample of `ticks` clock steps, but those of `lost` sensors.

        Where they are not `good` (held, or of a sensor that is left out) nothing is tested.
        """
        now = np.array(readings)
        self._late_ticks += ticks
        self._test_ticks += ticks
        self._tested = False
        if not np.isfinite(now).all():
            return
        if self._begins:
            self.start(readings, "free")
            return
        ticks, self._late_ticks = self._late_ticks, 0
        if self._error is not None:
            self._error.step(ticks, lost)
        if self._late is not None:
            self._late.step(ticks, now, lost)
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
        if self._error is not None:
            sigma = self._error.sigma.tolist()
            written += [
                math.hypot(own, relative * estimate)
                for own, relative, estimate in zip(sigma, self._relative, estimates, strict=True)
            ]
        if self._late is not None:
            written += self._latest
        return written if self._error is None else [*written, self._word]

    def state(self) -> list[Any]:
        """For `resume`, as JSON."""
        parts = [None if part is None else part.state() for part in self._parts]
        return [*parts, self._latest, self._late_ticks, self._test_ticks]

    @property
    def _parts(self) -> tuple[FixedLag | None, InnovationTest | None, RunningError | None]:
        return self._late, self._test, self._error

    def resume(self, values: list[Any] | None) -> None:
        """Go on from a state; begin anew, as on a warm machine, where it lacks what is told now.

        Raises
        ------
        ValueError
            Not a state of a monitor.
        """
        *parts, latest, late_ticks, test_ticks = values or [*[None] * len(self._parts), [], 0, 0]
        if len(parts) != len(self._parts):
            raise ValueError("not a state of this monitor")
        pairs = list(zip(self._parts, parts, strict=True))
        if any(part is not None and kept is None for part, kept in pairs):
            self._begins = True
            self._report("", "the kept state has no late estimates or standard errors: they begin "
                         "as those of a warm machine")  # fmt: skip
            return
        for part, kept in pairs:
            if part is not None:
                part.resume(kept)
        self._latest = [float(each) for each in latest]
        self._late_ticks, self._test_ticks = int(late_ticks), int(test_ticks)
        self.alarm = self._test is not None and self._test.alarm
