"""Readings that are a sensor's fault: values that only a fault gives, and spikes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from thermaltool.errors import UnitError
from thermaltool.record import Array, Record
from thermaltool.units import ABSOLUTE_ZERO, parse_channel

# What becomes of faults: missing values, or what they are.
FAULT_POLICIES = ("omit", "keep")
# Quantities of sensors; heat, speed, voltage and the like are commanded: they may stand still, and
# leap for a row.
MEASURED = ("T", "dT", "d")
# What common temperature sensors give where they do not measure [degC]: data sheet of the DS18B20;
# Callendar and Van Dusen for the lowest and the highest code of a MAX31865 with a Pt100 at 430 ohm.
KNOWN_FAULTS = (
    (85.0, "a DS18B20 after power-on"),
    (-127.0, "a DS18B20 that does not answer"),
    (-242.02, "a MAX31865 with its sensor shorted"),
    (988.79, "a MAX31865 with its sensor open"),
)
# Readings are rounded, or come from another unit [K].
KNOWN_TO = 0.02
# A sensor has not leapt to such a value from within this [K], and is back within this share of the
# leap: a machine that has been there comes back on its own way.
MIN_LEAP, MAX_LEFT_SHARE = 1.0, 0.5
# A longer stretch is a fault where the leap is large [K] and the sensor back where it was.
MAX_SHORT_ROWS, MIN_LONG_LEAP, MAX_LONG_LEFT_SHARE = 5, 10.0, 0.1
# A channel that has more of its readings there has been there.
MAX_KNOWN_SHARE = 0.2
# No machine is so cold unless it is a cryostat, where other readings of the sensor are near [degC].
COLD, NOT_COLD = -100.0, -60.0
# A spike is at most so many rows long; the median of so many rows around a reading, itself in the
# middle, is what it stands out of.
MAX_SPIKE_ROWS, MEDIAN_ROWS = 3, 9
# It stands out by so many median steps from row to row, over the whole, near it and around it, and
# by so many times as much as nine tenths of the readings around it stand out of theirs.
MIN_SPIKE_STEPS, STEPS_NEAR, STEPS_AROUND = 10.0, 16, 51
MIN_STANDING_OUT = 6.0
# The two readings on either side of it are off by at most this share of it (what decays is no
# spike), or by the noise, which is this share of what a spike has at least.
MAX_BESIDE_SHARE, NOISE_SHARE = 0.2, 0.3
# What stands out in more of the rows is how the channel is, and so is what recurs: so many, four
# fifths of them at even intervals and of one size, within the range of the other readings.
MAX_SPIKE_SHARE = 0.1
MIN_RECURRING, MAX_UNEVEN = 8, 0.2
# A commanded channel that changes in at most this share of its rows, and both leaves its level and
# comes back so few rows before each end of a spike or at it, has made the spike.
MAX_CHANGES_SHARE, ROWS_BEFORE = 0.1, 2

Mask = NDArray[np.bool_]
AnyRecord = TypeVar("AnyRecord", bound=Record)


@dataclass(frozen=True)
class Fault:
    """Consecutive readings of a `channel` that are no measurement: `rows`, `values` and `why`.

    The `kind` is ``fault`` (a value that a sensor gives where it does not measure),
    ``implausible`` or ``spike``.
    """

    channel: str
    rows: NDArray[np.intp]
    values: Array
    kind: str
    why: str

    @property
    def message(self) -> str:
        """What `check` says of it."""
        what = f"spike: {self.values[0]:g}, {self.why} beyond its neighbours"
        if self.kind != "spike":
            what = f"{self.values.min():g} degC is {self.why}"
        return what if len(self.rows) == 1 else f"{what} in {len(self.rows)} rows"


def find_faults(record: Record) -> tuple[Fault, ...]:
    """Faults of the measured channels of a record, in order of channel, kind and row."""
    found: list[Fault] = []
    for name, values in record.columns.items():
        try:
            quantity = parse_channel(name).quantity
        except UnitError:
            continue
        if quantity not in MEASURED:
            continue
        present = np.flatnonzero(np.isfinite(values))
        bad = np.zeros(len(present), dtype=bool)
        for part, kind, why in _of_values(values[present], bad) if quantity == "T" else ():
            rows = present[part]
            found.append(Fault(name, rows, values[rows], kind, why))
        found += spikes(record, name, present[~bad])
    return tuple(found)


def without(record: AnyRecord, faults: Sequence[Fault]) -> AnyRecord:
    """The record with faults as missing values."""
    columns: dict[str, Array] = {}
    for fault in faults:
        if fault.channel not in columns:
            columns[fault.channel] = record.columns[fault.channel].copy()
        columns[fault.channel][fault.rows] = np.nan
    return record.with_columns(columns) if columns else record


def spikes(record: Record, channel: str, rows: NDArray[np.intp]) -> Iterator[Fault]:
    """Up to `MAX_SPIKE_ROWS` readings far from the median of those around them.

    A step or a slope stays on the median, so it is no spike; nor is what comes back slowly, or
    begins or ends a stretch between pauses.

    Parameters
    ----------
    record : Record
    channel : str
    rows : ndarray of int, shape (n,)
        Rows with readings, in order.
    """
    values = record.column(channel)
    typical = _typical_step(values[rows])
    found: list[Fault] = []
    sizes: list[float] = []
    others = values.copy()
    changes = _commanded_changes(record, channel)
    for part in record.segments:
        low, high = np.searchsorted(rows, (part.start, part.stop))
        inside = rows[low:high]
        for start, stop, size in _spikes(values[inside], MIN_SPIKE_STEPS * typical):
            run = inside[start:stop]
            if any(_makes(rows_of, run) for rows_of in changes):
                continue
            found.append(Fault(channel, run, values[run], "spike", f"{size:.3g}"))
            sizes.append(size)
            others[run] = np.nan
    others = others[rows]
    others = others[~np.isnan(others)]
    many = len(rows) - len(others) > MAX_SPIKE_SHARE * len(rows)
    starts = np.array([fault.rows[0] for fault in found])
    if found and not many and not _recur(np.array(sizes), starts, float(np.ptp(others))):
        yield from found


def _commanded_changes(record: Record, channel: str) -> list[NDArray[np.intp]]:
    """Of each channel that is commanded the rows in which it has another value than the last."""
    found = []
    for name, values in record.columns.items():
        try:
            commanded = name != channel and parse_channel(name).quantity not in MEASURED
        except UnitError:
            continue
        if commanded:
            # A hole is no change.
            there = np.flatnonzero(np.isfinite(values))
            rows = there[1:][np.diff(values[there]) != 0]
            if 0 < len(rows) <= MAX_CHANGES_SHARE * len(values):
                found.append(rows)
    return found


def _makes(changes: NDArray[np.intp], run: NDArray[np.intp]) -> bool:
    """Whether a channel that changes in these rows does so at both ends of a spike."""
    ends = (run[0], run[-1] + 1)
    near = (changes[(changes >= end - ROWS_BEFORE) & (changes <= end)] for end in ends)
    first, last = near
    # Two changes, not one that is near both ends.
    return bool(len(first) and len(last) and last.max() > first.min())


def _recur(sizes: Array, starts: NDArray[np.intp], reach: float) -> bool:
    """Whether spikes come and go as a machine's own doing, of those within its `reach`.

    Parameters
    ----------
    sizes : ndarray, shape (n,)
    starts : ndarray of int, shape (n,)
        Their first rows.
    reach : float
        Range of the other readings.
    """
    if len(sizes) < MIN_RECURRING or np.median(sizes) > reach:
        return False
    uneven = (np.abs(each / np.median(each) - 1) for each in (sizes, np.diff(starts)))
    return all(np.quantile(each, 0.8) <= MAX_UNEVEN for each in uneven)


def runs_of(mask: Mask) -> list[tuple[int, int]]:
    """Start and stop of each stretch where `mask` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _of_values(values: Array, bad: Mask) -> Iterator[tuple[slice, str, str]]:
    """Stretches, with kind and reason, of temperatures that are none; marks them as `bad`."""
    for value, who in KNOWN_FAULTS:
        for start, stop in _at(values, value, bad):
            bad[start:stop] = True
            yield slice(start, stop), "fault", who
    cold = (values < COLD) & ~bad
    if not ((values > NOT_COLD).any() or (cold.any() and np.ptp(values[cold]) == 0)):
        cold &= values < ABSOLUTE_ZERO
    for start, stop in runs_of(cold):
        bad[start:stop] = True
        below = values[start:stop].min() < ABSOLUTE_ZERO
        what = "below absolute zero" if below else "no temperature of a machine"
        yield slice(start, stop), "implausible", what


def _at(values: Array, value: float, bad: Mask) -> Iterator[tuple[int, int]]:
    """Stretches at `value` that the sensor has leapt to, and from which it leaps back."""
    if not (values.size and values.min() - KNOWN_TO <= value <= values.max() + KNOWN_TO):
        return
    here = abs(values - value) <= KNOWN_TO
    most = max(MAX_SHORT_ROWS, MAX_KNOWN_SHARE * len(here)) if value > COLD else len(here)
    if not 0 < here.sum() <= most:
        return
    others = np.flatnonzero(~here & ~bad)
    usual = _typical_step(values[others]) if len(others) > 1 else 0.0
    leap = max(MIN_LEAP, MIN_SPIKE_STEPS * usual)
    for start, stop in runs_of(here):
        k = int(np.searchsorted(others, start))
        beside = values[others[max(0, k - 1) : k + 1]] - value
        near = np.abs(beside).min(initial=np.inf) <= leap
        if _leaps(beside, stop - start, leap) if value > COLD else not near:
            yield start, stop


def _leaps(beside: Array, rows: int, leap: float) -> bool:
    """Whether a sensor cannot well have been where it was for some `rows`.

    Parameters
    ----------
    beside : ndarray, shape (0 to 2,) [K]
        What it reads before and after, relative to what it read there.
    rows : int
    leap : float [K]
    """
    if not beside.size or not (np.all(beside > leap) or np.all(beside < -leap)):
        return False
    if rows > MAX_SHORT_ROWS and (beside.size < 2 or np.abs(beside).min() < MIN_LONG_LEAP):
        return False
    left = MAX_LEFT_SHARE if rows <= MAX_SHORT_ROWS else MAX_LONG_LEFT_SHARE
    return bool(np.ptp(beside) <= left * np.abs(beside).min())


def _spikes(values: Array, limit: float) -> Iterator[tuple[int, int, float]]:
    """Start, stop and size of each spike of a stretch without pause, shape (n,)."""
    if values.size < MEDIAN_ROWS + 2:
        return
    # Only rows near a large step can be part of one.
    near = np.zeros(values.size, dtype=bool)
    leaps = np.flatnonzero(np.abs(np.diff(values)) > limit * (1 - MAX_BESIDE_SHARE))
    for after in range(1, MAX_SPIKE_ROWS + 1):
        near[np.minimum(leaps + after, values.size - 1)] = True
    median = _running_median(values, np.flatnonzero(near))
    beyond = np.abs(values - median)
    high = np.zeros(values.size, dtype=bool)
    for start, stop in runs_of(beyond > limit):
        # On a slope the median of the rows beside a spike is off, too.
        here = beyond[start:stop]
        high[start:stop] = here > MAX_BESIDE_SHARE * here.max()
    runs = [run for run in runs_of(high) if run[1] - run[0] <= MAX_SPIKE_ROWS]
    sound = np.ones(values.size, dtype=bool)
    for start, stop in runs:
        sound[start:stop] = False
    for start, stop in runs:
        if start < 2 or stop > values.size - 2:
            continue
        size = float(beyond[start:stop].min())
        level = float(np.median(median[start:stop]))
        low = max(0, start - MEDIAN_ROWS)
        beside = low + np.flatnonzero(sound[low : stop + MEDIAN_ROWS])
        k = int(np.searchsorted(beside, start))
        off = np.abs(values[beside[max(0, k - 2) : k + 2]] - level).max(initial=0.0)
        if off > max(MAX_BESIDE_SHARE * size, NOISE_SHARE * limit):
            continue
        if size > _liveliness(values, sound, start, stop):
            yield start, stop, size


def _liveliness(values: Array, sound: Mask, start: int, stop: int) -> float:
    """What sound readings around a stretch do, times how far a spike has to stand out of it."""
    lively = 0.0
    for rows in (STEPS_NEAR, STEPS_AROUND):
        part = slice(max(0, start - rows // 2), stop + rows // 2)
        around = values[part][sound[part]]
        if len(around) > 1:
            lively = max(lively, MIN_SPIKE_STEPS * float(np.median(np.abs(np.diff(around)))))
    if len(around) < MEDIAN_ROWS:
        return lively
    stand_out = np.abs(around - _running_median(around, np.arange(len(around))))
    return max(lively, MIN_STANDING_OUT * float(np.quantile(stand_out, 0.9)))


def _running_median(values: Array, rows: NDArray[np.intp]) -> Array:
    """The median of `MEDIAN_ROWS` values around some rows; elsewhere the values, shape (n,)."""
    padded = np.pad(values, MEDIAN_ROWS // 2, mode="reflect")
    median = values.copy()
    median[rows] = np.median(sliding_window_view(padded, MEDIAN_ROWS)[rows], axis=1)
    return median


def _typical_step(values: Array) -> float:
    """Median step from row to row; where rounding hides it, the resolution."""
    steps = np.abs(np.diff(values))
    if not steps.size:
        return np.inf
    return max(float(np.median(steps)), float(np.min(steps[steps > 0], initial=np.inf)))
