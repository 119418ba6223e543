"""Whether the time of a line goes on from the line before, and at the period that is expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from thermaltool.errors import LogError
from thermaltool.responses.modes import CLOCK_STEP
from thermaltool.runtime.messages import Report

# A clock that jumps ahead by more than this [s] is doubted, as one that goes back: nothing that is
# controlled is left alone for two hours.
DOUBTED_PAUSE = 7200.0
# A pause beyond this [s], four months, is none: the clock was set.
LONGEST_PAUSE = 1e7
# The period of lines is the median of so many steps: a few pauses among them do no harm.
PERIOD_STEPS = 20
# It may differ from the expected one by this share, more than the jitter of any logger.
PERIOD_TOLERANCE = 0.1


@dataclass
class PeriodCheck:
    """Whether lines come at the period that a control or a model was made for.

    Attributes
    ----------
    period : float [s]
    name : str
        What messages call the source.
    """

    period: float
    name: str
    _steps: list[float] = field(default_factory=list, init=False)
    _last: float | None = field(default=None, init=False)

    def take(self, time: float) -> None:
        """The time of a line [s]; raises LogError where the median step is another period."""
        step, self._last = 0.0 if self._last is None else time - self._last, time
        if len(self._steps) == PERIOD_STEPS or step <= 0:
            return
        self._steps.append(step)
        if len(self._steps) == PERIOD_STEPS:
            median = sorted(self._steps)[PERIOD_STEPS // 2]
            if abs(median / self.period - 1.0) > PERIOD_TOLERANCE:
                raise LogError(
                    f"lines come each {median:.6g} s, the period is {self.period:.6g} s", self.name
                )


@dataclass
class ClockCheck:
    """Refuses times that do not go on, and follows a clock that was set.

    Attributes
    ----------
    report : callable
        Gets (channel, message).
    hold : float [s]
        A clock that stays refused for longer than this was set anew, and is followed.
    min_step : float [s]
        A smaller step, or one back, is refused.
    max_step : float [s]
        A larger step is refused too; inf for none.
    max_gap : float [s]
        A longer pause is reported.
    period : PeriodCheck or None
        The period that is expected, where it matters.
    on_set : callable
        Gets by how much the clock was set [s], before it is followed.
    last : float [s] or None
        The last time that was accepted.
    """

    report: Report
    hold: float = 0.0
    min_step: float = CLOCK_STEP / 2
    max_step: float = DOUBTED_PAUSE
    max_gap: float = math.inf
    period: PeriodCheck | None = None
    on_set: Callable[[float], None] = lambda shift: None
    last: float | None = field(default=None, init=False)
    _refused: int = field(default=0, init=False)
    _refused_from: float = field(default=math.inf, init=False)

    def take(self, time: float) -> float | None:
        """Seconds since the last accepted time, 0 for the first; None where it is refused.

        Raises
        ------
        LogError
            Lines come at another period than expected.
        """
        if self.period is not None:
            self.period.take(time)
        step: float | None = 0.0
        if self.last is not None:
            step = time - self.last
            if not self.min_step < step < self.max_step:
                self._refused += 1
                step = self._doubted(time, step, self.last)
                if step is None:
                    return None
            elif step > self.max_gap:
                self.report("", f"a pause of {step:g} s")
            if self._refused:
                self._refused, self._refused_from = 0, math.inf
        self.last = time
        return step

    def _doubted(self, time: float, step: float, last: float) -> float | None:
        """The same for a step that is too small or too large."""
        if time < self._refused_from:
            self._refused_from = time
            self._report_refusal(time, last)
        elapsed = time - self._refused_from
        if not self.hold < elapsed < DOUBTED_PAUSE:
            return None
        if self.min_step < step < LONGEST_PAUSE:
            self.report("", f"a pause of {step:g} s")
            return step
        self._follow(time, last, self._refused_from - last)
        return elapsed

    def _report_refusal(self, time: float, last: float) -> None:
        self.report("", f"time {time:.15g} s after {last:.15g} s: line ignored")

    def _follow(self, time: float, last: float, shift: float) -> None:
        self.report("", f"the clock was set from {last:.15g} s to {time:.15g} s: followed")
        self.on_set(shift)


@dataclass
class SampleClockCheck(ClockCheck):
    """The same for samples that count one by one, however long a pause is between them.

    Attributes
    ----------
    max_refused : int
        After more refused lines in a row the clock was set anew, and is followed.
    """

    max_step: float = math.inf
    max_refused: int = 10

    def _doubted(self, time: float, step: float, last: float) -> float | None:
        """0 where the clock is followed: how long ago the last sample was, it does not say."""
        if self._refused == 1:
            self._report_refusal(time, last)
        if self._refused <= self.max_refused:
            return None
        self._follow(time, last, step)
        return 0.0
