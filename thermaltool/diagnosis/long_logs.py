"""Logs of very many rows: causes are sought on averages, what they are worth is told of all rows.

A search keeps some kilobytes a row. Where the logs have more rows than `averaging.MAX_ROWS`, it
works on averages over consecutive rows, as a calibration does: drives along straight lines, outputs
as means of their readings, whose noise and number are known. What is told of the written model
comes from the readings, one run of `simulate` after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.diagnosis.no_signature import after_a_switch
from thermaltool.effects.effect import Float
from thermaltool.fitting import averaging
from thermaltool.fitting.averaging import (
    Averages,
    averaged_rows,
    averages_of,
    integral_of,
    row_noise,
)
from thermaltool.model import Drive, Model, drive_rests
from thermaltool.record import Record
from thermaltool.responses.modes import Hold
from thermaltool.signals.resolution import resolution_step
from thermaltool.units import hold_of

Logs = tuple[Record, ...]

# Averages of all logs together. A likelihood weighs 3000 means of them
# (`thermaltool.signals.row_groups`); a search of so many takes about a minute.
MAX_AVERAGES = 40_000
# Rows of averages and of steps of the drives together, over that.
MAX_TIMES_AVERAGES = 3
# Readings jump within a stretch where its mean is so many times its noise from both neighbours, and
# these are so many times as far apart as the next ones; asked of so many means at least.
MIN_JUMP, MIN_ROWS = 5.0, 20


def rows_of(logs: Sequence[Record]) -> list[int]:
    """Number of consecutive rows that make one row of a search, for each log; 1 where all count.

    Parameters
    ----------
    logs : sequence of Record
    """
    if sum(map(len, logs)) <= averaging.MAX_ROWS:
        return [1] * len(logs)
    return averaged_rows(logs, min(MAX_AVERAGES, averaging.MAX_ROWS))


def averaged_logs(model: Model, groups: Sequence[Logs]) -> tuple[Model, list[Logs]]:
    """Averages of logs, and the model as it runs on them: its drives go along straight lines.

    Parameters
    ----------
    model : Model
    groups : sequence of tuple of Record
        Each is averaged for itself, so that it has no more than so many rows.

    Returns
    -------
    Model
    list of tuple of Averages
    """
    found = [_averages(model, logs) for logs in groups]
    every = [log for logs in groups for log in logs]
    return replace(model, drives=tuple(_along_lines(d, model, every) for d in model.drives)), found


def _along_lines(drive: Drive, model: Model, logs: Sequence[Record]) -> Drive:
    """A drive whose averages go along straight lines.

    The first value of a commanded one is exact: where it is the same in all logs it stays so.
    """
    if drive.hold == "zero" and drive.reference == "first" and drive.rest is None:
        levels = {drive_rests(replace(model, drives=(drive,)), log)[drive.channel] for log in logs}
        if len(levels) == 1:
            return replace(drive, hold="first", reference=levels.pop())
    return replace(drive, hold="first")


def _averages(model: Model, logs: Logs) -> Logs:
    found = tuple(_averaged(model, *each) for each in zip(logs, rows_of(logs), strict=True))
    # Drives that step all the time have so many rows of their own between the averages.
    most = min(MAX_AVERAGES, averaging.MAX_ROWS)
    if sum(map(len, found)) > MAX_TIMES_AVERAGES * most and max(rows_of(logs)) > 1:
        fewer = averaged_rows(logs, most // averaging.PARTS)
        found = tuple(_averaged(model, *each) for each in zip(logs, fewer, strict=True))
    return found


def _averaged(model: Model, log: Record, rows: int) -> Averages:
    """Averages of every channel of a log, in the units of the log."""
    outputs = [o.channel for o in model.outputs if o.channel in log.columns]
    averages = averages_of(log, rows, model.drives, outputs)
    columns = dict(averages.columns)
    for channel, rest in drive_rests(model, log).items():
        columns[channel] = columns[channel] + rest
    for channel, values in log.columns.items():
        if channel not in columns:
            columns[channel] = _course(
                log.time, values, averages.time, hold_of(channel), averages.stretch
            )
    switched = after_a_switch(model, averages)
    for output in outputs:
        columns[output] = _without_jumps(columns[output], row_noise(averages, output), switched)
    steps = {o: resolution_step(log.columns[o]) or 0.0 for o in outputs}
    return replace(averages, columns={c: columns[c] for c in log.columns}, steps=steps)


def _without_jumps(values: Float, noise: float, switched: NDArray[np.bool_]) -> Float:
    """Means of an output, NaN where readings jump within one; shape (n,).

    The mean of both levels would be taken for a lag of a part of a stretch. After a switch of a
    drive an output may be as fast as that.
    """
    there = np.flatnonzero(np.isfinite(values))
    if len(there) < MIN_ROWS:
        return values
    rises = np.diff(values[there])
    first, before, after, last = rises[:-3], rises[1:-2], rises[2:-1], rises[3:]
    between = np.minimum(after * np.sign(before), np.abs(before)) > MIN_JUMP * noise
    # What an output does over some stretches goes on to one side.
    around = np.maximum(np.abs(first), np.abs(last))
    sudden = np.abs(before + after) > MIN_JUMP * around
    at = there[2:-2]
    kept = values.copy()
    kept[at[between & sudden & ~switched[at]]] = np.nan
    return kept


def _course(time: Float, values: Float, moments: Float, hold: Hold, stretch: float) -> Float:
    """A channel beside the model at other moments, shape (m,); NaN where it has no value.

    One that is held has its mean up to the next moment, any other one its mean over the stretch [s]
    around each.
    """
    there = np.isfinite(values)
    if not there.any():
        return np.full(len(moments), np.nan)
    rows = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, len(time) - 1)
    if hold == "zero":
        low, high = moments, np.append(moments[1:], moments[-1])
        last = np.maximum.accumulate(np.where(there, np.arange(len(values)), there.argmax()))
        known = values[last]
    else:
        low, high = moments - stretch / 2, moments + stretch / 2
        known = np.interp(time, time[there], values[there])
    low, high = (np.clip(edges, time[0], time[-1]) for edges in (low, high))
    integral = integral_of(time, known, hold)
    found, own = known[rows], high > low
    sums = np.interp(high, time, integral) - np.interp(low, time, integral)
    found[own] = sums[own] / (high - low)[own]
    found[~there[rows]] = np.nan
    return found
