"""Whether the time of a line goes on from the line before, and at the period that is expected."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

from thermaltool.errors import LogError
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.messages import Report

# A step of more than so many periods is doubted until the next line confirms it.
DOUBTED_PERIODS = 5
# The period of lines whose clock is checked is the median of so many steps.
RECENT_STEPS = 9
# Lines that come by this factor more often or more seldom than expected are told.
OTHER_PERIOD = 3.0
# Lines that come at this part of their own pace, or more slowly, are not played from a log.
LIVE_PACE = 0.5
# A clock that was put back and then goes on for longer than this [s] is another's.
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
        A clock that stays put back for longer than this was set anew, and is followed.
    min_step : float [s]
        A smaller step, or one back, is refused.
    max_gap : float [s]
        A longer pause is reported.
    expected : float [s]
        Period that lines are expected to have; where they come more slowly, their own counts.
        A step ahead of many periods is refused until the next line goes on from there.
    period : PeriodCheck or None
        The period that is expected, where it matters.
    on_set : callable
        Gets by how much the clock was set [s], before it is followed.
    now : callable
        Seconds of the computer. Where lines come at its pace, a leap that it has not seen is a
        clock that was set.
    last : float [s] or None
        The last time that was accepted.
    known_pause : float [s]
        A pause that is known from elsewhere needs no confirmation.
    """

    report: Report
    hold: float = 0.0
    min_step: float = CLOCK_STEP / 2
    max_gap: float = math.inf
    expected: float = math.inf
    period: PeriodCheck | None = None
    on_set: Callable[[float], None] = lambda shift: None
    now: Callable[[], float] = monotonic
    last: float | None = field(default=None, init=False)
    known_pause: float = field(default=0.0, init=False)
    _refused: int = field(default=0, init=False)
    _refused_from: float = field(default=math.inf, init=False)
    _ahead: float = field(default=math.inf, init=False)
    _compared: bool = field(default=False, init=False)
    _recent: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT_STEPS), init=False)
    _arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT_STEPS), init=False)

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
            if not self.min_step < step <= self.plausible:
                self._refused += 1
                step = self._doubted(time, step, self.last)
                if step is None:
                    return None
            elif step > self.max_gap:
                self.report("", f"a pause of {step:g} s")
            if self._refused or self.known_pause:
                self.forget_doubts()
            self._learn(step)
        self.last = time
        return step

    def forget_doubts(self) -> None:
        """What was refused so far says nothing of what comes."""
        self._refused, self._refused_from, self._ahead = 0, math.inf, math.inf
        self.known_pause = 0.0

    @property
    def plausible(self) -> float:
        """The longest step that needs no confirmation [s]."""
        usual = sorted(self._recent)[len(self._recent) // 2] if self._recent else 0.0
        return DOUBTED_PERIODS * max(self.expected, usual) + self.known_pause

    def _learn(self, step: float) -> None:
        if self.expected < math.inf:
            self._recent.append(step)
            self._arrivals.append(self.now())
            if len(self._recent) == RECENT_STEPS and not self._compared:
                self._compared = True
                usual = sorted(self._recent)[RECENT_STEPS // 2]
                if not 1 / OTHER_PERIOD < usual / self.expected < OTHER_PERIOD:
                    self.report(
                        "", f"lines come each {usual:.6g} s, the design has {self.expected:.6g} s"
                    )

    def _doubted(self, time: float, step: float, last: float) -> float | None:
        """The same for a step that is too small or too large."""
        if step > self.min_step:
            return self._leap(time, step, last)
        if time < self._refused_from:
            self._refused_from = time
            self._report_refusal(time, last)
        elapsed = time - self._refused_from
        if elapsed >= DOUBTED_PAUSE:
            # A pause of a clock that was set back, or another one: it has to hold from here on.
            self._refused_from = time
        if not self.hold < elapsed < DOUBTED_PAUSE:
            return None
        self._follow(time, last, self._refused_from - last)
        return elapsed

    def _leap(self, time: float, step: float, last: float) -> float | None:
        """The same for a step ahead: one stamp may be garbled, two that agree are not."""
        after, self._ahead = time - self._ahead, time
        if not self.min_step < after <= max(self.plausible, step - after):
            self._report_refusal(time, last)
            return None
        self._learn(after)
        if step < LONGEST_PAUSE and not self._unseen(step):
            if step > self.max_gap:
                self.report("", f"a pause of {step:g} s")
            return step
        self._follow(time, last, step - after)
        return after

    def _unseen(self, step: float) -> bool:
        """Whether lines come at the computer's pace, and it has not seen such a pause."""
        if len(self._arrivals) < RECENT_STEPS:
            return False
        # What is learnt last is the line that confirms the leap.
        *_, before, _ = self._arrivals
        span, steps = before - self._arrivals[0], sum(list(self._recent)[1:-1])
        return span > LIVE_PACE * steps and self.now() - before < step / 2

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

    max_refused: int = 10

    def _doubted(self, time: float, step: float, last: float) -> float | None:
        """0 where the clock is followed: how long ago the last sample was, it does not say."""
        if self._refused == 1:
            self._report_refusal(time, last)
        if self._refused <= self.max_refused:
            return None
        self._follow(time, last, step)
        return 0.0
