"""Forecasts as a stream: a line in, the forecast of a later sample out."""

from __future__ import annotations

import math

from thermaltool.runtime.clock_check import PeriodCheck, SampleClockCheck
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.process import Process, Reply
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings
from thermaltool.timeseries.recursive.arma import MAX_READING, RecursiveArma

COLUMNS = ("forecast", "low", "high")
# Readings whose error is above so many standard deviations are reported and count as missing.
GATE = 10.0
# So many missing samples in a row are bridged by their own forecasts, where nothing is said; after
# more the lags are forgotten, and forecasts come again when p good samples have.
HOLD_SAMPLES = 10
# The clock's period is the median of so many steps, where the user does not say.
PERIOD_STEPS = 5
# Steps of less than half a period repeat a sample, those of more than one and a half lack one.
HALF = 0.5


class Forecasts(Process):
    """Each good row gives the time of the sample `steps` ahead, its forecast, and an interval.

    Rows give none until there is a forecast, nor where their time is refused.

    Parameters
    ----------
    channel : str
        The column that is forecast.
    model : RecursiveArma
        It learns on; at its start it may be a fitted one.
    settings : Settings
        `hold` counts in samples of `period`; without a period that is the clock's. After a pause
        above `max_gap` the lags are forgotten.
    messages : Messages
    steps : int
        Which sample ahead is written.
    level : float
        Of the interval, for normal errors.

    Raises
    ------
    ValueError
        Level or steps out of range.
    """

    clock: SampleClockCheck

    def __init__(
        self,
        channel: str,
        model: RecursiveArma,
        settings: Settings,
        messages: Messages,
        steps: int = 1,
        level: float = 0.95,
    ) -> None:
        # Imported here: other processes need no normal distribution.
        from statistics import NormalDist

        if steps < 1:
            raise ValueError(f"no forecast {steps} steps ahead")
        if not 0 < level < 1:
            raise ValueError(f"level {level:g} is not between 0 and 1")
        self._channel, self._model, self._steps = channel, model, steps
        self._width = NormalDist().inv_cdf((1 + level) / 2)
        self._settings, self.report = settings, messages
        self.columns = (channel,)
        # As in a batch.
        self.names = tuple(f"{column}_{channel}" for column in COLUMNS)
        self.clock = SampleClockCheck(messages, min_step=0.0, on_set=self._on_set)
        self._hold = self.clock.max_refused = HOLD_SAMPLES
        self._steps_seen: list[float] = []
        self._missed = 0
        self.period = None
        if settings.period is not None:
            self._expect(settings.period)
            self.clock.period = PeriodCheck(settings.period, messages.source)

    def _expect(self, period: float) -> None:
        """Take a sample period [s] for that of the rows."""
        self.period = period
        if self._settings.hold is not None:
            self._hold = self.clock.max_refused = round(self._settings.hold / period)
        self.clock.min_step = HALF * period

    def step(self, row: Row, seconds: float) -> Reply | None:
        """The forecast after a row; None where there is none yet."""
        self._pass(seconds)
        self._update(row)
        if not (self._model.ready and self.period):
            return None
        mean, variance = self._model.forecast(self._steps)
        # Adding zero turns -0.0 into 0.0.
        centre, half = mean[-1] + 0.0, self._width * math.sqrt(variance[-1])
        if not math.isfinite(centre) or not math.isfinite(half):
            self._model.forget_lags()
            self.report(self._channel, "the forecast is not finite: lags forgotten")
            return None
        assert row.time is not None
        time = round(row.time + self._steps * self.period, 9)
        return time, (centre, centre - half, centre + half)

    def _on_set(self, shift: float) -> None:
        """The clock was set: samples before are of another time."""
        self._model.forget_lags()

    def _pass(self, seconds: float) -> None:
        """Bridge or forget where samples are lacking; learn the period where nobody says it."""
        if self.period is None:
            self._steps_seen += [seconds] if seconds else []
            if len(self._steps_seen) == PERIOD_STEPS:
                self._expect(sorted(self._steps_seen)[PERIOD_STEPS // 2])
        elif seconds > (1 + HALF) * self.period:
            self._pause(seconds, self.period)

    def _pause(self, seconds: float, period: float) -> None:
        longest = self._settings.max_gap or (self._hold + 1) * period
        if seconds <= longest - self._missed * period:
            for _ in range(round(seconds / period - 1)):
                self._model.miss()
        else:
            self.report("", f"a pause of {seconds:g} s: lags forgotten")
            self._model.forget_lags()

    def _update(self, row: Row) -> None:
        x = row.readings[0]
        if -MAX_READING < x < MAX_READING:
            before = self._model.refused
            error = self._model.update(x)
            if self._model.refused > before:
                self._miss(f"{x:g} is {abs(error):.3g} from its forecast: taken for an outlier")
            elif self._missed:
                self._missed = 0
                self.report(self._channel, "good again")
            return
        self._model.miss()
        self._miss(row.faults[0] or ("too large" if math.isfinite(x) else "not finite"))

    def _miss(self, fault: str) -> None:
        self._missed += 1
        if self._missed == 1:
            self.report(self._channel, f"{fault}: its forecast stands in")
        if self._missed == self._hold + 1:
            self.report(self._channel, f"{fault}: lags forgotten")
        if self._missed > self._hold:
            self._model.forget_lags()
