"""Forecasts as a stream: a line in, the forecast of a later sample out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from thermaltool.errors import LogError
from thermaltool.runtime.clocks import Rate
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.pipe import LinePipe
from thermaltool.runtime.records import Row, open_records
from thermaltool.runtime.stream import BYTE_ORDER_MARK, Writer
from thermaltool.timeseries.recursive.arma import LARGEST, KnownModel, RecursiveArma

COLUMNS = ("forecast", "low", "high")
# The clock's period is the median of so many intervals, where the user does not say.
INTERVALS = 5
# Intervals of less than half a period repeat a sample, those of more than one and a half lack one.
HALF = 0.5


@dataclass(frozen=True)
class ForecastSettings:
    """What the user may choose.

    Attributes
    ----------
    channel : str
        The column that is forecast.
    p, q : int
    steps : int
        Which sample ahead is written.
    level : float
        Of the interval, for normal errors.
    intercept : bool
    forgetting : float
    gate : float
        Readings whose error is above so many standard deviations are told and count as missing.
    hold : int
        So many missing samples in a row are bridged by their own forecasts; after more the lags
        are forgotten, and forecasts come again when p good samples have.
    start : KnownModel or None
        A fitted model to start from; None learns from the first line on.
    fitted : int
        Samples that it was fitted to.
    period : float [s] or None
        Sample period; None takes it from the clock. An input without a clock needs it.
    has_clock : bool
        False where `period` stands in for a clock that the input does not have.
    timeout : float [s]
        Silence of the source that is told; inf never.
    columns : str or None
        File of a column map.
    from_format, to_format : "csv" or "ndjson"
    """

    channel: str
    p: int
    q: int = 0
    steps: int = 1
    level: float = 0.95
    intercept: bool = True
    forgetting: float = 0.999
    gate: float = 10.0
    hold: int = 10
    start: KnownModel | None = None
    fitted: int = 100
    period: float | None = None
    has_clock: bool = True
    timeout: float = math.inf
    columns: str | None = None
    from_format: Literal["csv", "ndjson"] = "csv"
    to_format: Literal["csv", "ndjson"] = "csv"


def run_forecasts(
    source: int,
    sink: int,
    settings: ForecastSettings,
    emit: Callable[[str], None],
    name: str = "<stdin>",
) -> int:
    """Answer lines until the source ends or a signal comes; returns the signal, or 0.

    Each good line gives one line: the time of the sample `steps` ahead, its forecast, and the ends
    of its interval. Lines give none until there is a forecast, nor where their time is refused.

    Parameters
    ----------
    source, sink : int
        File descriptors.
    settings : ForecastSettings
    emit : callable
        Gets each message, one line.
    name : str
        What messages call the source.

    Raises
    ------
    LogError
        No such column, no clock, an input without lines, or at another period.
    ValueError
        Orders, level or steps out of range.
    OutputError, BrokenPipeError
    """
    return _Forecasts(LinePipe(source, sink), settings, Messages(emit, name)).run()


@dataclass
class _Forecasts:
    pipe: LinePipe
    settings: ForecastSettings
    messages: Messages
    time: float | None = field(default=None, init=False)
    period: float | None = field(default=None, init=False)
    _missed: int = field(default=0, init=False)
    _refused: int = field(default=0, init=False)
    _intervals: list[float] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        # Imported here: other commands of the stream need no normal distribution.
        from statistics import NormalDist

        settings = self.settings
        if settings.steps < 1:
            raise ValueError(f"no forecast {settings.steps} steps ahead")
        if not 0 < settings.level < 1:
            raise ValueError(f"level {settings.level:g} is not between 0 and 1")
        self._width = NormalDist().inv_cdf((1 + settings.level) / 2)
        self.model = RecursiveArma(
            settings.p, settings.q, settings.intercept, settings.forgetting, settings.gate
        )
        if settings.start is not None:
            self.model.begin(settings.start, settings.fitted)
        self.period = settings.period
        self._rate = Rate(settings.period, self.messages.source) if settings.period else None
        self._last: float | None = None
        period = None if settings.has_clock else settings.period
        self.records = open_records(
            settings.from_format, (settings.channel,), settings.columns, period
        )
        # As in a batch.
        names = [f"{column}_{settings.channel}" for column in COLUMNS]
        self.writer = Writer(settings.to_format, names)

    def run(self) -> int:
        with self.pipe:
            self.pipe.write(self.writer.header)
            self._loop()
            self.messages.close()
        return self.pipe.signal

    def _loop(self) -> None:
        timeout = self.settings.timeout
        patience = timeout if timeout < math.inf else None
        while not self.pipe.signal:
            if not self.pipe.wait(patience):
                if not self.pipe.signal and patience is not None:
                    self.messages("", f"no line for {timeout:.3g} s")
                    patience = None
                continue
            patience = timeout if timeout < math.inf else None
            lines = self.pipe.read()
            if lines is None:
                self._end()
                return
            self.pipe.write(b"".join([self._answer(line) for line in lines]))

    def _end(self) -> None:
        if self.pipe.torn:
            self.messages.line += 1
            self.messages("", "the last line has no end, it may be cut: not used")
        if self.records.clock is None:
            raise LogError(
                "empty: a stream begins with a line that names its columns", self.messages.source
            )

    def _answer(self, line: bytes) -> bytes:
        """The forecast line for a line; nothing for names, comments and blank lines."""
        self.messages.line += 1
        line = line.rstrip(b"\r")
        if self.messages.line == 1:
            line = line.removeprefix(BYTE_ORDER_MARK)
        start = line.lstrip()
        if not start or start.startswith(b"#"):
            return b""
        if self.records.clock is None:
            opened = self.records.open(line, self.messages.source, self.messages.line)
            if not opened:
                return b""
        return self._forecast(self.records.record(line))

    def _forecast(self, record: Row) -> bytes:
        if record.time is None:
            self.messages("", "no time on this line: ignored")
            return b""
        if not self._advance(record.time):
            return b""
        self._take(record)
        if not (self.model.ready and self.period):
            return b""
        steps = self.settings.steps
        mean, variance = self.model.forecast(steps)
        centre, half = mean[-1], self._width * math.sqrt(variance[-1])
        if not math.isfinite(centre) or not math.isfinite(half):
            self.model.forget_lags()
            self.messages(self.settings.channel, "the forecast is not finite: lags forgotten")
            return b""
        time = round(record.time + steps * self.period, 9)
        return self.writer.line(time, (centre, centre - half, centre + half))

    def _advance(self, time: float) -> bool:
        """Whether the clock has gone on; bridges or forgets where samples are lacking."""
        last, period = self.time, self.period
        if self._rate is not None and self._last is not None:
            self._rate.take(time - self._last)
        self._last = time
        if last is not None:
            step = time - last
            if step <= (HALF * period if period else 0.0):
                return self._refuse(time, last)
            if period is None:
                self._intervals.append(step)
                if len(self._intervals) == INTERVALS:
                    self.period = sorted(self._intervals)[INTERVALS // 2]
            elif step > (1 + HALF) * period:
                self._pause(step, period)
        self._refused = 0
        self.time = time
        return True

    def _refuse(self, time: float, last: float) -> bool:
        """Ignore a time that does not go on; follow it when it stays: the clock was set."""
        self._refused += 1
        if self._refused == 1:
            self.messages("", f"time {time:.15g} s after {last:.15g} s: line ignored")
        if self._refused <= self.settings.hold:
            return False
        self.messages("", f"the clock was set from {last:.15g} s to {time:.15g} s: followed")
        self.model.forget_lags()
        self._refused = 0
        self.time = time
        return True

    def _pause(self, step: float, period: float) -> None:
        lacking = step / period - 1
        if lacking <= self.settings.hold - self._missed:
            for _ in range(round(lacking)):
                self.model.miss()
        else:
            self.messages("", f"a pause of {step:g} s: lags forgotten")
            self.model.forget_lags()

    def _take(self, record: Row) -> None:
        x = record.readings[0]
        if -LARGEST < x < LARGEST:
            before = self.model.refused
            error = self.model.update(x)
            if self.model.refused > before:
                self._miss(f"{x:g} is {abs(error):.3g} from its forecast: taken for an outlier")
            elif self._missed:
                self._missed = 0
                self.messages(self.settings.channel, "good again")
            return
        self.model.miss()
        self._miss(record.faults[0] or ("too large" if math.isfinite(x) else "not finite"))

    def _miss(self, fault: str) -> None:
        self._missed += 1
        if self._missed == 1:
            self.messages(self.settings.channel, f"{fault}: its forecast stands in")
        if self._missed == self.settings.hold + 1:
            self.messages(self.settings.channel, f"{fault}: lags forgotten")
        if self._missed > self.settings.hold:
            self.model.forget_lags()
