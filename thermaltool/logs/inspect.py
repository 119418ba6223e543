"""What is in a log and what is wrong with it: the findings behind ``check``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import LogError
from thermaltool.logs.clock import BURST_PERIODS, Sampling, far_from_neighbours, sampling
from thermaltool.logs.faults import MEASURED, Fault, find_faults, runs_of, spikes
from thermaltool.logs.log import Log
from thermaltool.logs.table import MAX_LISTED
from thermaltool.record import Array, ChannelSummary
from thermaltool.units import parse_channel, symbol

# Steps may differ by this share of the period before the clock counts as uneven.
MAX_JITTER_SHARE = 0.1
# Equal values in a row that are no chance, where noise moves the last digit at every sample.
MIN_FROZEN_ROWS = 20
# A step is a jump where it is so many times the next largest; rows on either side in which a drive
# may have made it.
LONE_STEP, NEAR_ROWS = 20.0, 3


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong: its `kind`, where it is, and a line of plain words."""

    kind: str
    message: str
    line: int | None = None
    column: str | None = None


@dataclass(frozen=True)
class Inspection:
    """What is in a log (`rows`, `duration` [s], `clock`, `channels`), its `findings` and `faults`.

    The faults of its sensors are among the findings, too.
    """

    rows: int
    duration: float
    segments: int
    clock: Sampling
    channels: tuple[ChannelSummary, ...]
    findings: tuple[Finding, ...]
    faults: tuple[Fault, ...] = ()


def inspect(log: Log) -> Inspection:
    """Look a log over, read with ``strict=False``.

    Findings come in the order: reading, clock, channels. Of one kind in one column the first few
    are listed and the rest is counted.
    """
    findings = [_reading(problem) for problem in log.problems]
    if not len(log):
        findings.append(Finding("empty", "no rows"))
    clock = sampling(log.time[np.isfinite(log.time)])
    findings += _capped(_gaps(log, clock))
    findings += _jitter(log, clock)
    channels = log.channel_summaries()
    faults = find_faults(log)
    for name, quantity in ((channel.name, channel.quantity) for channel in channels):
        values = log.columns[name]
        findings += _capped(_missing(log, name, values))
        present = np.flatnonzero(np.isfinite(values))
        if quantity in MEASURED:
            findings += _capped(standstill(log, name))
            own: Iterable[Fault] = (each for each in faults if each.channel == name)
        else:
            own = spikes(log, name, present)
        found = [_fault(log, each) for each in own]
        for kind in dict.fromkeys(each.kind for each in found):
            findings += _capped(each for each in found if each.kind == kind)
    finite = log.time[np.isfinite(log.time)]
    return Inspection(
        rows=len(log),
        duration=float(finite[-1] - finite[0]) if finite.size else 0.0,
        segments=len(log.segments),
        clock=clock,
        channels=channels,
        findings=tuple(findings),
        faults=faults,
    )


def _reading(problem: LogError) -> Finding:
    return Finding("reading", problem.message, problem.line, problem.column)


def _capped(findings: Iterable[Finding]) -> list[Finding]:
    """The first few findings, and how many more there are."""
    kept = list(findings)
    if len(kept) <= MAX_LISTED:
        return kept
    last = kept[-1]
    more = f"{len(kept) - MAX_LISTED} more like this, the last at line {last.line}"
    return [*kept[:MAX_LISTED], Finding(last.kind, more, None, last.column)]


def _gaps(log: Log, clock: Sampling) -> Iterator[Finding]:
    """Pauses between segments and, where the sampling is even, places where rows were lost."""
    steps = np.diff(log.time)
    cuts = {part.start for part in log.segments[1:] if steps[part.start - 1] > 0}
    long = np.flatnonzero(steps > BURST_PERIODS * clock.period)
    if clock.burst_rows is None:
        long = far_from_neighbours(steps, long, BURST_PERIODS)
    for k in sorted(cuts | set((long + 1).tolist())):
        if k in cuts:
            message = f"a gap of {steps[k - 1]:g} s: a new segment"
        elif clock.burst_rows is None:
            message = f"rows are lost: a step of {steps[k - 1]:g} s"
        else:
            continue
        yield Finding("gap", message, int(log.lines[k]))


def _jitter(log: Log, clock: Sampling) -> list[Finding]:
    # Time stamps of whole seconds may each be half a second off.
    whole = clock.period > 2 and np.array_equal(log.time, np.round(log.time))
    allowed = max(MAX_JITTER_SHARE * clock.period, 1.0 if whole else 0.0)
    if not clock.jitter > allowed:
        return []
    steps = np.diff(log.time)
    uneven = (np.abs(steps - clock.period) > allowed) & (steps > 0)
    uneven &= steps <= BURST_PERIODS * clock.period
    message = (
        f"uneven clock: steps up to {clock.jitter:.3g} s off the period of {clock.period:.6g} s "
        f"({100 * np.mean(uneven):.2g} % of the steps); --resample makes it even"
    )
    return [Finding("jitter", message, int(log.lines[np.argmax(uneven) + 1]))]


def _missing(log: Log, name: str, values: Array) -> Iterator[Finding]:
    # A cell that reading has already complained about is not listed again.
    column = log.unread[name].column if name in log.unread else name
    known = [problem.line for problem in log.problems if problem.column == column and problem.line]
    for start, stop in runs_of(np.isnan(values) & ~np.isin(log.lines, known)):
        count = stop - start
        message = "missing value" if count == 1 else f"{count} missing values in a row"
        yield Finding("missing", message, int(log.lines[start]), name)


def standstill(log: Log, name: str) -> Iterator[Finding]:
    """Stretches of equal values in a channel that otherwise moves at nearly every sample.

    A coarsely resolved channel stands still by nature, so it says nothing.

    Parameters
    ----------
    log : Log
    name : str
        The channel; missing readings are passed over.
    """
    present = np.flatnonzero(np.isfinite(log.columns[name]))
    lines, values = log.lines[present], log.columns[name][present]
    if len(values) < 2 * MIN_FROZEN_ROWS:
        return
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(values)]])
    runs = stops - starts
    if np.median(runs) > 1 or np.percentile(runs, 90) > 3:
        return
    low, high = values.min(), values.max()
    for k in np.flatnonzero(runs >= MIN_FROZEN_ROWS):
        value = values[starts[k]]
        rail = value in (low, high)
        kind, what = ("saturated", "at a rail") if rail else ("frozen", "frozen")
        message = f"{what}: {value:g} for {runs[k]} rows"
        yield Finding(kind, message, int(lines[starts[k]]), name)


def jump(log: Log, name: str, drives: Sequence[str]) -> Finding | None:
    """A step of a channel between two rows that dwarfs all others, while no drive moves so.

    A gauge that was set to zero again, or another unit from there on. Where a drive has such a step
    before it, or a large one next to it, the channel may follow that.

    Parameters
    ----------
    log : Log
    name : str
    drives : sequence of str
    """
    rows = np.flatnonzero(np.isfinite(log.columns[name]))
    steps = np.diff(log.columns[name][rows])
    if len(steps) < MIN_FROZEN_ROWS:
        return None
    k = _lone_step(steps)
    if k is None or not _second(steps) or np.diff(log.time[rows])[k] > BURST_PERIODS * log.period:
        return None
    near = slice(max(rows[k] - NEAR_ROWS, 0), rows[k + 1] + NEAR_ROWS)
    for drive in drives:
        moved = np.abs(np.nan_to_num(np.diff(log.columns[drive])))
        lone = _lone_step(moved)
        late = lone is not None and lone <= rows[k]
        if late or 2 * np.max(moved[near]) >= np.max(moved) > 0:
            return None
    size = f"{steps[k]:.4g} {symbol(parse_channel(name).unit)}".strip()
    times = f"{abs(steps[k]) / _second(steps):.0f} times the next largest step"
    return Finding(
        "jump", f"jumps by {size} in one row, {times}", int(log.lines[rows[k + 1]]), name
    )


def _lone_step(steps: Array) -> int | None:
    """Where the largest step dwarfs the next largest one."""
    if len(steps) < 2:
        return None
    k = int(np.argmax(np.abs(steps)))
    return k if abs(steps[k]) > LONE_STEP * _second(steps) else None


def _second(steps: Array) -> float:
    return float(np.partition(np.abs(steps), -2)[-2])


def _fault(log: Log, fault: Fault) -> Finding:
    return Finding(fault.kind, fault.message, int(log.lines[fault.rows[0]]), fault.channel)
