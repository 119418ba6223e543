"""Which columns of a stream carry its clock and the model's sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thermaltool.errors import LogError
from thermaltool.runtime.clocks import ColumnClock, LineClock, PeriodClock, StampClock
from thermaltool.units import UNITS, clock_unit

if TYPE_CHECKING:
    from thermaltool.logs.columns import ColumnMap


@dataclass(frozen=True)
class Wanted:
    """What is looked for in a stream.

    Attributes
    ----------
    sensors : tuple of str
    mapping : ColumnMap or None
        Foreign names and their clock.
    clock : LineClock or None
        Of a stream that has none of its own, or whose own is not used.
    clock_advice : str
        What a user can do about a stream without a clock.
    """

    sensors: tuple[str, ...]
    mapping: ColumnMap | None = None
    clock: LineClock | None = None
    clock_advice: str = "--period gives one to a stream without"

    @property
    def merges(self) -> bool:
        """Whether lines of one time make one row, as in logs."""
        mapping = self.mapping
        if mapping is None or self.counts_lines:
            return False
        return mapping.duplicates in ("first", "mean")

    @property
    def counts_lines(self) -> bool:
        """Whether each line has a time of its own: it counts periods."""
        clock = self.mapping.clock if self.mapping else None
        if self.clock is not None:
            return isinstance(self.clock, PeriodClock)
        return clock is not None and clock.period is not None

    @property
    def time_name(self) -> str | None:
        """What the time is called where it is written; None where the first line shows it."""
        clock = self.mapping.clock if self.mapping else None
        if self.clock is not None or (clock is not None and clock.period is not None):
            return "time_s"
        if clock is not None and clock.column is not None:
            return "time" if clock.unit == "iso" else "time_s"
        return None


@dataclass(frozen=True)
class Sensed:
    """Where a sensor's reading is: ``scale * value + offset`` of the field at `key`.

    A field that is among `missing`, or outside `valid`, is no reading.
    """

    key: Any
    scale: float = 1.0
    offset: float = 0.0
    valid: tuple[float, float] = (-math.inf, math.inf)
    missing: tuple[float, ...] = ()

    @property
    def plain(self) -> bool:
        """Whether a field is the reading as it stands."""
        return self == Sensed(self.key)

    def of(self, value: float) -> float:
        """The reading, NaN where the field is none."""
        low, high = self.valid
        if value in self.missing or not low <= value <= high:
            return math.nan
        return self.scale * value + self.offset


@dataclass(frozen=True)
class Layout:
    """The clock, and one `Sensed` per sensor in the order of the model."""

    clock: LineClock
    sensors: tuple[Sensed, ...]


def find_layout(keys: Mapping[str, Any], wanted: Wanted, number: Callable[[Any], float]) -> Layout:
    """Find clock and sensors among the columns of a stream.

    Parameters
    ----------
    keys : mapping
        Name of each column to what finds its field in a split line.
    number : callable
        Reads a field.

    Raises
    ------
    LogError
        A sensor or the clock is not there; the message names the near ones.
    """
    found = _columns(keys, wanted.mapping)
    for sensor in wanted.sensors:
        if sensor not in found:
            raise LogError(f"no column {sensor}, which the estimator reads{_hint(sensor, found)}")
    return Layout(_clock(keys, wanted, number), tuple(found[name] for name in wanted.sensors))


def _columns(keys: Mapping[str, Any], mapping: ColumnMap | None) -> dict[str, Sensed]:
    if mapping is None:
        return {name: Sensed(key) for name, key in keys.items()}
    renames = {name: mapping.rename(name) for name in keys}
    return {
        rename.name: Sensed(keys[name], rename.scale, rename.offset, rename.valid, rename.missing)
        for name, rename in renames.items()
        if rename is not None
    }


def _clock(keys: Mapping[str, Any], wanted: Wanted, number: Callable[[Any], float]) -> LineClock:
    """What the user asks for, else what the map says, else the tool's own names."""
    if wanted.clock is not None:
        return wanted.clock
    mapped = wanted.mapping.clock if wanted.mapping else None
    if mapped is not None and mapped.period is not None:
        return PeriodClock(mapped.period)
    if mapped is not None and mapped.column is not None:
        if mapped.column not in keys:
            raise LogError(f"no column {mapped.column}{_hint(mapped.column, keys)}")
        if mapped.joined is not None:
            raise LogError(f"a stream has its time in one column, not two; {wanted.clock_advice}")
        if mapped.unit == "iso":
            return StampClock(keys[mapped.column], mapped.format)
        return ColumnClock(keys[mapped.column], number, UNITS[mapped.unit][1])
    unit = clock_unit(keys)
    if unit == "iso":
        return StampClock(keys["time"])
    if unit is not None:
        return ColumnClock(keys[f"time_{unit}"], number, UNITS[unit][1])
    raise LogError(
        f"no clock: no column time_s or time{_hint('time_s', keys)}; {wanted.clock_advice}"
    )


def _hint(name: str, known: Iterable[str]) -> str:
    # Imported for the message alone: the package reads whole logs, the stream starts without it.
    from thermaltool.record import hint

    return hint(name, known)
