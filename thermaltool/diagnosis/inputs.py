"""Inputs that a user could run next, as synthetic logs, simplest first, each with its sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.limits import ExperimentLimits
from thermaltool.diagnosis.starts import begins_away
from thermaltool.effects.effect import Effect, Float
from thermaltool.record import Record
from thermaltool.units import hold_of, parse_channel, printed

# Rows of an experiment that are simulated at most (where it would have more, they are further
# apart), and means of rows that count.
MAX_ROWS, MAX_MEANS = 5000, 600
# A level at which a log spends less than this share of its rows is not among its levels.
MIN_SHARE_OF_ROWS = 0.03
# A fast experiment reads so many times as often.
FAST_READINGS = 5
# Drives that are moved at most.
MAX_DRIVES = 2


@dataclass(frozen=True)
class Experiment:
    """An input to run, and the log that it would make.

    Attributes
    ----------
    sentence : str
        What to do, for a user.
    record : Record
        Drives, channels beside them, and outputs (zeros: the model says what they would be).
    readings : float
        Readings that a row stands for.
    """

    sentence: str
    record: Record
    readings: float

    def means(self, series: Float) -> Float:
        """Means of rows, shape (m,) or (m, c).

        Parameters
        ----------
        series : ndarray, shape (n,) or (n, c)
        """
        return np.asarray(np.add.reduceat(series, self._first, axis=0).T / self.counts).T

    @property
    def counts(self) -> Float:
        """Rows of each mean, shape (m,)."""
        return np.diff(np.append(self._first, len(self.record.time))).astype(float)

    @property
    def _first(self) -> NDArray[np.int64]:
        rows = len(self.record.time)
        return np.arange(0, rows, -(-rows // MAX_MEANS))


@dataclass(frozen=True)
class ChannelLevels:
    """What a commanded channel may be, as logged.

    Attributes
    ----------
    channel : str
    start, low, high : float
        At rest (at the first row where a log does not begin there), and the extremes of the logs
        and of the calibration.
    unused : float
        The share of the way between them that is furthest from all that the logs hold.
    """

    channel: str
    start: float
    low: float
    high: float
    unused: float

    @property
    def third(self) -> float:
        """A round level between the extremes, far from all that the logs hold."""
        return self.at(self.unused)

    @property
    def furthest(self) -> float:
        """The extreme that lies further from the start."""
        return max(self.low, self.high, key=lambda v: abs(v - self.start))

    @property
    def nearest(self) -> float:
        """The extreme that lies nearer to the start."""
        return min(self.low, self.high, key=lambda v: abs(v - self.start))

    def say(self, value: float) -> str:
        """A value with the unit of the channel."""
        text = f"{value:.{max(_decimals(self.low, self.high) + 1, 0)}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        return f"{text} {printed(parse_channel(self.channel).unit)}".rstrip()

    def at(self, share: float) -> float:
        """A level between low (0) and high (1), as a user would set it."""
        value = self.low + share * (self.high - self.low)
        value = round(value, _decimals(self.low, self.high))
        return float(np.clip(value, self.low, self.high))


def _decimals(low: float, high: float) -> int:
    """Decimals of the second figure of a range."""
    return 1 - int(np.floor(np.log10((high - low) or abs(high) or 1.0)))


def levels_of(hypothesis: Hypothesis, channel: str) -> ChannelLevels:
    """Start, range and an unused level of a drive or a channel beside the drives.

    Parameters
    ----------
    hypothesis : Hypothesis
    channel : str
    """
    columns = [log.columns[channel] for log in hypothesis.logs]
    seen = np.concatenate([c[np.isfinite(c)] for c in columns])
    low, high = float(seen.min()), float(seen.max())
    start = float(columns[0][np.isfinite(columns[0])][0])
    for drive in hypothesis.model.drives:
        if drive.channel == channel:
            rest = start if drive.reference == "first" else drive.reference
            low, high = min(low, rest + drive.range[0]), max(high, rest + drive.range[1])
            if not begins_away(hypothesis.simulation):
                start = rest
    values, counts = np.unique(np.round((seen - low) / (high - low or 1.0), 3), return_counts=True)
    taken = np.append(
        values[counts > MIN_SHARE_OF_ROWS * len(seen)], (start - low) / (high - low or 1.0)
    )
    shares = np.array([0.5, 0.6, 0.4, 0.7, 0.3, 0.8, 0.2])
    distance = np.min(np.abs(shares[:, None] - taken[None, :]), axis=1)
    unused = float(shares[int(np.argmax(np.round(distance, 2)))])
    return ChannelLevels(channel, start, low, high, unused)


def duration_text(seconds: float, digits: int = 2) -> str:
    """A time in a handy unit; with two figures, as a user would set it.

    Parameters
    ----------
    seconds : float [s]
    digits : int
    """
    for unit, size, least in (("h", 3600.0, 3.0), ("min", 60.0, 3.0), ("s", 1.0, 0.0)):
        if seconds >= least * size:
            return f"{float(f'{seconds / size:.{digits}g}'):g} {unit}"
    raise ValueError(f"no duration: {seconds}")


def library(
    hypothesis: Hypothesis, causes: Sequence[Effect], limits: ExperimentLimits
) -> list[Experiment]:
    """Inputs that might tell `causes` from each other or from the model's own response.

    Parameters
    ----------
    hypothesis : Hypothesis
    causes : sequence of Effect
        With the channels that they need, which are moved apart from the drives.
    limits : ExperimentLimits
        None that asks for more.
    """
    period = min(log.period for log in hypothesis.logs)
    slowest = max(t.response.slowest() for t in hypothesis.model.terms)
    # Not slower than what the logs have shown, not faster than can be read.
    slow = float(np.clip(slowest, 10 * period, max(log.duration for log in hypothesis.logs)))
    run = limits.longest(max(log.duration for log in hypothesis.logs))
    drives = _relevant(hypothesis, causes)
    plans: list[_Course] = []
    for drive in drives:
        if limits.can_set(drive):
            plans += _plans(levels_of(hypothesis, drive), slow, period, run, limits.switch)
    extra = dict.fromkeys(c for e in causes for c in e.needs() if c not in drives)
    known = {d.channel for d in hypothesis.model.drives}
    for channel in extra:
        if channel not in known and limits.can_set(channel):
            with_drive = limits.can_set(drives[0])
            plans += _beside(
                levels_of(hypothesis, drives[0]), levels_of(hypothesis, channel), slow, period,
                run, with_drive,
            )  # fmt: skip
    able = {plan.sentence: plan for plan in plans if plan.shortest >= limits.switch}
    return [_experiment(hypothesis, plan, k) for k, plan in enumerate(able.values())]


def _relevant(hypothesis: Hypothesis, causes: Sequence[Effect]) -> list[str]:
    """Drives at which a cause acts, and the one that moves the outputs most."""
    reach: dict[str, float] = {}
    for term in hypothesis.model.terms:
        if term.output in hypothesis.evidence:
            level = hypothesis.simulation.level(term.drive)
            size = abs(term.response.dc_gain()) * level / hypothesis.evidence[term.output].white
            reach[term.drive] = max(reach.get(term.drive, 0.0), size)
    acting = [e.channel for e in causes if e.channel in reach]
    return list(dict.fromkeys([*acting, max(reach, key=lambda c: reach[c])]))[:MAX_DRIVES]


@dataclass(frozen=True)
class _Course:
    """A course for some channels: knots between which `course` runs."""

    sentence: str
    duration: float
    period: float
    courses: Mapping[str, Callable[[Float], Float]]
    shortest: float  # time between two changes [s]


def _held(start: float, pieces: Iterable[tuple[float, float]]) -> Callable[[Float], Float]:
    """`start` for a moment, then each (duration, value), then the last value."""
    spans, values = zip(*pieces, strict=True)
    edges = np.cumsum([0.0, *spans[:-1]])

    def course(time: Float) -> Float:
        at = np.searchsorted(edges, time, side="right") - 1
        return np.where(time > 0, np.array(values)[np.maximum(at, 0)], start)

    return course


def _plans(
    u: ChannelLevels, slow: float, period: float, run: float, switch: float
) -> Iterator[_Course]:
    """Courses of one drive, the others at rest, none longer than `run`."""
    a, b, c, name = u.start, u.furthest, u.third, u.channel
    hold, long = min(1.5 * slow, run / 6), min(4 * slow, run / 2)

    def plan(sentence: str, pieces: Sequence[tuple[float, float]], step: float = period) -> _Course:
        total = sum(span for span, _ in pieces)
        shortest = min(span for span, _ in pieces)
        return _Course(sentence, total, step, {name: _held(a, pieces)}, shortest)

    yield plan(
        f"bring {name} from {u.say(a)} to {u.say(b)} and hold it for {duration_text(long)}",
        [(long, b)],
    )
    yield plan(
        f"hold {name} at {u.say(b)} for {duration_text(hold)}, then go back to {u.say(a)} and "
        f"record the next {duration_text(long / 2)} too",
        [(hold, b), (long / 2, a)],
    )
    yield plan(
        f"hold {name} at a third level, e.g. {u.say(c)}, for {duration_text(hold)}, after as long "
        f"at {u.say(b)}",
        [(hold, b), (hold, c), (hold, u.nearest)],
    )
    stairs = [u.at(share) for share in (0.25, 0.5, 0.75)]
    yield plan(
        f"take {name} through a staircase of levels, {', '.join(u.say(v) for v in stairs)} and "
        f"{u.say(u.high)}, up and down again, {duration_text(hold / 2)} each",
        [(hold / 2, v) for v in (*stairs, u.high, *stairs[::-1], u.low)],
    )
    if u.low < 0 < u.high:
        yield plan(
            f"alternate the sign of {name}: {u.say(u.high)} and {u.say(u.low)} in turn, "
            f"{duration_text(hold)} each, at least twice",
            [(hold, u.high), (hold, u.low)] * 2,
        )
    pause = min(6 * hold, run / 4)
    yield plan(
        f"bring {name} to {u.say(b)} for {duration_text(hold)} and the same again after "
        f"{duration_text(pause)} at {u.say(a)}, in one log",
        [(hold, b), (pause, a), (hold, b)],
    )
    ramp = min(3 * slow, run / 4)
    yield _Course(
        f"ramp {name} slowly from {u.say(u.low)} to {u.say(u.high)} in {duration_text(ramp)} and "
        "back, twice",
        4 * ramp,
        period,
        {
            name: lambda t: np.where(
                t > 0, u.low + (u.high - u.low) * (1 - np.abs((t / ramp) % 2 - 1)), a
            )
        },
        ramp,
    )
    rest = 2 * long
    yield plan(f"record {duration_text(rest)} with {name} at {u.say(a)}", [(rest, a)])
    if hold_of(name) == "first":
        return  # a temperature of the machine is not switched
    half = max(4 * period, float(f"{np.sqrt(4 * period * hold):.2g}"))
    for span, step in ((half, period), (4 * period, period), (2 * period, period / FAST_READINGS)):
        span = max(span, switch)
        count = max(4, min(int(2 * slow / span), int(MAX_MEANS * step / span), int(run / span)))
        often = f", reading every {duration_text(step)}" if step < period else ""
        yield plan(
            f"switch {name} between {u.say(a)} and {u.say(b)} every {duration_text(span)}, for "
            f"{duration_text(count * span)}{often}",
            [(span, v) for v in (b, a) * (count // 2)],
            step,
        )
    swing = [u.low + s * (u.high - u.low) for s in (0.5, 0.3, 0.8, 0.5, 1.0, 0.7, 0.9, 0.4, 0.6)]
    yield plan(
        f"change {name} by small amounts up and down around several levels "
        f"({', '.join(u.say(v) for v in swing[:5])}, …), {duration_text(hold / 3)} each",
        [(hold / 3, v) for v in swing],
    )


def _beside(
    u: ChannelLevels, x: ChannelLevels, slow: float, period: float, run: float, with_drive: bool
) -> Iterator[_Course]:
    """Courses of a channel beside the drives and, `with_drive`, of both against each other."""
    hold = min(2 * slow, run / 6)
    span = duration_text(hold)
    if hold_of(x.channel) == "zero":
        said = f"switch {x.channel} to {x.say(x.furthest)} and back"
        alone = _held(x.start, [(hold, x.furthest), (hold, x.start)])
    else:
        said = f"bring {x.channel} from {x.say(x.start)} to {x.say(x.furthest)} and back"
        size = x.furthest - x.start

        def alone(time: Float) -> Float:
            return x.start + size * np.sin(np.pi * time / (2 * hold)) ** 2

    still = f" with {u.channel} at {u.say(u.start)}" if with_drive else ""
    yield _Course(f"{said}{still}, {span} each way", 2 * hold, period, {x.channel: alone}, hold)
    if not with_drive:
        return
    yield _Course(
        f"{said}, {span} each way, and {u.channel} to {u.say(u.furthest)} and back at other times",
        4 * hold,
        period,
        {
            x.channel: alone,
            u.channel: _held(
                u.start, [(0.5 * hold, u.start), (hold, u.furthest), (1.2 * hold, u.start),
                          (hold, u.furthest), (0.3 * hold, u.start)]
            ),
        },
        0.3 * hold,
    )  # fmt: skip


def _experiment(hypothesis: Hypothesis, plan: _Course, number: int) -> Experiment:
    """A plan as a log: every other channel stays at its first value."""
    readings = max(1.0, plan.duration / plan.period / MAX_ROWS)
    step = plan.period * readings
    time: Float = step * np.arange(int(plan.duration / step) + 2, dtype=np.float64)
    first = hypothesis.logs[0]
    columns = {}
    for name in first.columns:
        if name in hypothesis.groups:
            columns[name] = np.zeros(len(time))
        elif name in plan.courses:
            columns[name] = plan.courses[name](time)
        else:
            values = first.columns[name]
            there = values[np.isfinite(values)]
            columns[name] = np.full(len(time), there[0] if len(there) else 0.0)
    record = Record(time, columns, digest=f"experiment {number}")
    return Experiment(plan.sentence, record, readings)
