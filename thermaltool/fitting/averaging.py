"""Averages of consecutive rows: what a calibration fits in place of a log of very many rows.

A design of all rows takes some kilobytes a row. Thermal time constants are long beside the sample
period of such logs, so that means over equal stretches of time say as much. Drives and outputs pass
through the same moving average, which commutes with every linear response; of a drive the average
is the exact integral over the stretch, of an output the mean of its readings. A step becomes a ramp
of one stretch: the averaged drive goes on along straight lines, with a row more, without readings,
at each end of such a ramp, so that time constants of few stretches are found without bias.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermaltool.model import Drive, Output, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float, Hold
from thermaltool.signals.detrend import difference_sigma, find_outliers
from thermaltool.signals.resolution import reading_sigma

# Rows of all records together that are fitted one by one: at about 5 kB each, half a gigabyte.
MAX_ROWS = 100_000
# Between two segments there is a row more where it is farther from the next one than this share of
# a stretch.
MIN_APART = 0.5
# A reading stands for no more than so many usual steps to either side; a stretch has a mean where
# its readings stand for this share of it.
MAX_CELL, MIN_COVERED = 3.0, 0.9
# Where drives step more often than once in so many stretches, the ramps of single steps get no rows
# of their own; each stretch is cut into so many parts, at which the average is told.
STRETCHES_PER_STEP, PARTS = 2, 8
# Rows nearer than this share of a stretch are one.
SAME_ROW = 1e-3


# Moments [s], the stretches around them [s], which of them have readings, and the segments.
_Clock = tuple[Float, Float, NDArray[np.bool_], tuple[slice, ...]]


@dataclass(frozen=True, repr=False)
class Averages(Record):
    """A record of averages.

    Attributes
    ----------
    rows_each : int
        Rows that make one average.
    noise : mapping of output to float [unit of the output]
        White noise of one reading: differences of averages show the signal, too.
    stretch : float [s]
        Time over which readings are averaged; rows of the drives alone stand closer.
    steps : mapping of output to float [unit of the output]
        Resolution of a reading, where it was asked for.
    """

    rows_each: int = 1
    noise: Mapping[str, float] = field(default_factory=dict)
    stretch: float = 1.0
    steps: Mapping[str, float] = field(default_factory=dict)

    @property
    def row_readings(self) -> int:
        """Readings that a row stands for."""
        return self.rows_each

    @cached_property
    def period(self) -> float:
        """Usual time between averages [s]."""
        return self.stretch


def row_noise(record: Record, output: str) -> float:
    """White noise of one row of a record, which may be an average [unit of the output].

    Parameters
    ----------
    record : Record
    output : str
    """
    if isinstance(record, Averages):
        return record.noise[output] / math.sqrt(record.rows_each)
    return reading_sigma(record.column(output))


def known_noise(records: Sequence[Record], output: str) -> float | None:
    """White noise of one reading behind averages; None where all rows are readings.

    Parameters
    ----------
    records : sequence of Record
    output : str
    """
    known = (r.noise.get(output) for r in records if isinstance(r, Averages))
    return max((sigma for sigma in known if sigma is not None), default=None)


def averaged_rows(records: Sequence[Record], most: int | None = None) -> list[int]:
    """Number of consecutive rows that make one row of a fit, for each record; 1 where all count.

    Records of different sample periods are averaged over about the same time.

    Parameters
    ----------
    records : sequence of Record
    most : int, optional
        Rows of all records together that are taken one by one; `MAX_ROWS` by default.
    """
    most = MAX_ROWS if most is None else most
    counts = [len(record) for record in records]
    if sum(counts) <= most or min(counts, default=0) < 2:
        return [1] * len(counts)
    periods = [record.period for record in records]
    stretch = 0.0
    while True:
        stretch += min(periods)
        # A hair less: a whole number of periods stays one in rounding.
        rows = [
            min(max(math.ceil(stretch / period - 1e-6), 1), n)
            for n, period in zip(counts, periods, strict=True)
        ]
        if sum(-(-n // m) for n, m in zip(counts, rows, strict=True)) <= most or rows == counts:
            return rows


def average(
    records: Sequence[Record],
    drives: Sequence[Drive],
    outputs: Sequence[str],
    most: int | None = None,
) -> tuple[list[Averages], list[Drive]]:
    """Records of averages, and their drives, which count from zero along straight lines.

    Single readings of an output that stand alone take no part. A machine at rest before the first
    row is so before the first average: each record begins with a row without readings.

    Parameters
    ----------
    records : sequence of Record
        With the drives, without NaN, and the outputs, NaN where missing.
    drives : sequence of Drive
    outputs : sequence of str
    most : int, optional
        See `averaged_rows`.

    Returns
    -------
    list of Averages
    list of Drive
    """
    averages = [
        averages_of(record, rows, drives, outputs)
        for record, rows in zip(records, averaged_rows(records, most), strict=True)
    ]
    return averages, [replace(drive, hold="first", reference=0.0) for drive in drives]


def of_readings(output: Output, records: Sequence[Record], rows: Sequence[int]) -> Output:
    """An output that was fitted to averages, with figures of single readings.

    Parameters
    ----------
    output : Output
    records : sequence of Record
        As they were measured.
    rows : sequence of int
        What `averaged_rows` gives; an output all of whose rows count stays as it is.
    """
    if max(rows, default=1) == 1:
        return output
    measured = [record.column(output.channel) for record in records]
    noise = max(map(reading_sigma, measured))
    # What a mean does not show of its readings.
    hidden = noise * math.sqrt(1 - 1 / max(rows))
    figures = {
        "averaged_rows": list(rows),
        "rows": sum(int(np.isfinite(values).sum()) for values in measured),
        "noise": noise,
        "rmse": math.hypot(output.fit["rmse"], hidden),
        "discrepancy": {**output.fit["discrepancy"], "white_sigma": noise},
    }
    if "instants" in output.fit:
        own = output.fit["instants"]
        both = {key: math.hypot(own[key], hidden) for key in ("rmse", "rmse_without")}
        figures["instants"] = {**own, **both}
    return replace(output, fit={**output.fit, **figures})


def averages_of(
    record: Record, rows: int, drives: Sequence[Drive], outputs: Sequence[str]
) -> Averages:
    """One record of averages: drives relative to their references, and outputs.

    Parameters
    ----------
    record : Record
    rows : int
        That make one average; see `averaged_rows`.
    drives : sequence of Drive
    outputs : sequence of str
    """
    stretches = [_Stretches.of(record.time[part], record.period, rows) for part in record.segments]
    inputs = {
        drive: relative(record.column(drive.channel), drive.reference, drive.hold)
        for drive in drives
    }
    moments, widths, measured, parts = _with_ramps(_moments(stretches), _steps(record.time, inputs))
    columns = {}
    for drive, u in inputs.items():
        integral = integral_of(record.time, u, drive.hold)
        ends = (_at(record.time, integral, u, moments + half * widths) for half in (0.5, -0.5))
        columns[drive.channel] = np.subtract(*ends) / widths
    for output in outputs:
        readings = _without_outliers(record.column(output))
        means = [
            own.means(record.time[part], readings[part])
            for part, own in zip(record.segments, stretches, strict=True)
        ]
        columns[output] = np.full(len(moments), np.nan)
        columns[output][measured] = np.concatenate(means)
    noise = {output: reading_sigma(record.column(output)) for output in outputs}
    return Averages(moments, columns, parts, record.digest, record.name, record.at_rest,
                    record.origin, rows, noise, rows * record.period)  # fmt: skip


@dataclass(frozen=True)
class _Stretches:
    """Equal stretches of a segment, in which each row stands in the middle of its period.

    Attributes
    ----------
    ends : ndarray, shape (k + 1,) [s]
    """

    ends: Float

    @staticmethod
    def of(time: Float, period: float, rows: int) -> _Stretches:
        """Stretches of about so many rows each, all of one segment."""
        count = max(round(len(time) / rows), 1)
        return _Stretches(np.linspace(time[0] - period / 2, time[-1] + period / 2, count + 1))

    @property
    def middles(self) -> Float:
        """Middle of each, shape (k,) [s]."""
        return (self.ends[1:] + self.ends[:-1]) / 2

    @property
    def widths(self) -> Float:
        """Length of each, shape (k,) [s]."""
        return np.diff(self.ends)

    def means(self, time: Float, readings: Float) -> Float:
        """Mean reading of each stretch, shape (k,); NaN where readings cover too little of it.

        A reading stands for the times that are nearer to it than to others. Where these lie to one
        side of it, so does the mean: a line to the next one tells what it is in the middle.
        """
        there = np.isfinite(readings)
        at, values = time[there], readings[there]
        found = np.full(len(self.ends) - 1, np.nan)
        if len(at) < 2:
            return found
        steps = np.diff(at)
        usual = float(np.median(steps))
        half = np.concatenate([[usual / 2], np.minimum(steps / 2, MAX_CELL * usual), [usual / 2]])
        low, width = at - half[:-1], half[:-1] + half[1:]
        own = np.diff(np.searchsorted(at, self.ends)) > 0
        covered = self._sums(low, width, np.ones(len(at)))
        own &= covered > MIN_COVERED * self.widths
        if own.any():
            # Times from the first: large ones would round.
            middle = self._sums(low, width, at - at[0])[own] / covered[own]
            mean = self._sums(low, width, values)[own] / covered[own]
            found[own] = np.interp(self.middles[own] - at[0], middle, mean)
        return found

    def _sums(self, low: Float, width: Float, values: Float) -> Float:
        """Integral over each stretch of values that last so long each, shape (k,)."""
        before = np.append(0.0, np.cumsum(values * width))
        row = np.searchsorted(low, self.ends, side="right") - 1
        last = np.maximum(row, 0)
        reached = np.clip(self.ends - low[last], 0.0, width[last])
        return np.diff(before[last] + values[last] * reached)


def _steps(time: Float, inputs: Mapping[Drive, Float]) -> Float:
    """When drives step; that from rest to the first row is one of any drive [s]."""
    found = [
        time[np.flatnonzero(np.diff(u)) + 1] for drive, u in inputs.items() if drive.hold == "zero"
    ]
    return np.unique(np.concatenate([time[:1], *found]))


def _with_ramps(clock: _Clock, steps: Float) -> _Clock:
    """A clock with rows where averages of drives that step so bend, which have no readings."""
    moments, widths = clock[:2]
    if STRETCHES_PER_STEP * len(steps) > len(moments):
        lengths = np.diff(moments)
        whole = lengths < 1.5 * widths[1:]  # no pause
        parts = np.arange(1, PARTS) / PARTS
        return _with_rows(clock, (moments[:-1, None] + np.outer(lengths, parts))[whole].ravel())
    at = np.maximum(np.searchsorted(moments, steps) - 1, 0)
    ramps = np.concatenate([steps + half * widths[at] for half in (-0.5, 0.5)])
    return _with_rows(clock, np.sort(ramps[(ramps > moments[0]) & (ramps < moments[-1])]))


def _with_rows(clock: _Clock, rows: Float) -> _Clock:
    """A clock with more rows, in order and within it, where they are no others."""
    moments, widths, measured, parts = clock
    if not len(rows):
        return clock
    behind = np.searchsorted(moments, rows)
    near = SAME_ROW * widths[behind]
    apart = np.minimum(moments[behind] - rows, rows - moments[behind - 1]) > near
    apart[1:] &= np.diff(rows) > near[1:]
    rows, behind = rows[apart], behind[apart]
    starts = np.array([part.start for part in parts[1:]], dtype=np.int64)
    edges = [*(starts + np.searchsorted(behind, starts, side="right")).tolist()]
    return (
        np.insert(moments, behind, rows),
        np.insert(widths, behind, widths[behind]),
        np.insert(measured, behind, False),
        tuple(slice(a, b) for a, b in pairwise([0, *edges, len(moments) + len(rows)])),
    )


def _moments(segments: Sequence[_Stretches]) -> _Clock:
    """Middles of all stretches.

    One more stretch stands before each segment and behind it, where there is room: over a pause
    the averaged drive has left its last value only after half a stretch.
    """
    moments, widths, measured, parts = [], [], [], []
    last, rows = -np.inf, 0
    for k, each in enumerate(segments):
        following = segments[k + 1].middles[0] if k + 1 < len(segments) else -np.inf
        own, width, there = each.middles, each.widths, np.ones(len(each.middles), bool)
        before, behind = own[0] - width[0], own[-1] + width[-1]
        if behind < following - MIN_APART * width[-1]:
            own, width = np.append(own, behind), np.append(width, width[-1])
            there = np.append(there, False)
        if before > last + MIN_APART * width[0]:
            own, width = np.append(before, own), np.append(width[0], width)
            there = np.append(False, there)
        moments.append(own)
        widths.append(width)
        measured.append(there)
        parts.append(slice(rows, rows + len(own)))
        last, rows = float(own[-1]), rows + len(own)
    return np.concatenate(moments), np.concatenate(widths), np.concatenate(measured), tuple(parts)


def integral_of(time: Float, u: Float, hold: Hold) -> Float:
    """Integral of a channel from the first row to each, shape (n,) [unit s].

    Parameters
    ----------
    time, u : ndarray, shape (n,)
    hold : "zero" or "first"
        Between rows.
    """
    between = u[:-1] if hold == "zero" else (u[:-1] + u[1:]) / 2
    return np.append(0.0, np.cumsum(between * np.diff(time)))


def _at(time: Float, integral: Float, u: Float, moments: Float) -> Float:
    """The integral at any moments: of a drive that is zero before the first row and then held."""
    return np.interp(moments, time, integral) + u[-1] * np.maximum(moments - time[-1], 0.0)


def _without_outliers(values: Float) -> Float:
    """Readings, NaN in the place of those that stand alone, shape (n,)."""
    there = np.flatnonzero(np.isfinite(values))
    readings = values[there]
    alone = there[find_outliers(readings, difference_sigma(readings))]
    if not len(alone):
        return values
    kept = values.copy()
    kept[alone] = np.nan
    return kept
