"""The column map: foreign names, clocks and scales made the tool's own, in a small TOML file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from thermaltool.documents import finite
from thermaltool.errors import LogError, ModelError, UnitError
from thermaltool.logs.computed import Angle, Computed, Difference, Power, difference_fits
from thermaltool.logs.foreign_units import to_unit
from thermaltool.logs.table import equals_any
from thermaltool.parsing import is_time_pattern, parse_toml
from thermaltool.record import Array, hint
from thermaltool.sources import read_input
from thermaltool.units import UNITS, clock_unit, parse_channel

# Where a column map is: in a file, or the entries of its table ``[columns]``, the clock among them.
Columns: TypeAlias = str | os.PathLike[str] | Mapping[Any, Any]
# What rows of one time become: the first of them, their mean, or rows spread up to the next time.
DUPLICATES = ("first", "mean", "spread")


@dataclass(frozen=True)
class Clock:
    """Where the time comes from: a column of a `unit` (or ``iso``), or an even `period` [s].

    `format` is a `strptime` pattern for time stamps that are not ISO 8601. `joined` is a second
    column of the stamp, the time of day behind the date; a blank stands between them. Rows
    `within` [s] of the first of them count as of one time.
    """

    column: str | None = None
    unit: str = "s"
    period: float | None = None
    format: str | None = None
    joined: str | None = None
    within: float = 0.0

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that the stamp is made of."""
        return tuple(name for name in (self.column, self.joined) if name is not None)


@dataclass(frozen=True)
class Rename:
    """``name = scale * value + offset``

    A value that is among `missing`, or outside `valid`, as it stands in the log, is none. A log may
    lack an `optional` column.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    valid: tuple[float, float] = (-math.inf, math.inf)
    missing: tuple[float, ...] = ()
    optional: bool = False

    def of(self, values: Array) -> Array:
        """The channel, shape (n,), in the unit of its name; NaN where there is no value.

        Parameters
        ----------
        values : ndarray, shape (n,)
            As they stand in the log.
        """
        if self.missing or self.valid != (-math.inf, math.inf):
            bad = (
                equals_any(values, self.missing)
                | (values < self.valid[0])
                | (values > self.valid[1])
            )
            values = np.where(bad, np.nan, values)
        if self.scale == 1.0 and self.offset == 0.0:
            return values
        with np.errstate(over="ignore"):  # what overflows is refused with what is too large
            return np.asarray(self.scale * values + self.offset)


@dataclass(frozen=True)
class Dialect:
    """How a foreign CSV file is written.

    `skip` lines stand before the names and `skip_after_names` behind them (units).
    """

    separator: str = ","
    decimal: str = "."
    missing: tuple[str, ...] = ()
    encoding: str = "utf-8"
    skip: int = 0
    skip_after_names: int = 0


@dataclass(frozen=True)
class SensorMessages:
    """JSON messages of one sensor each: the keys of its `name` and of its `value`."""

    name: str
    value: str


@dataclass(frozen=True)
class ColumnMap:
    """What a map file says; the default changes nothing.

    `columns` gives None for a column that is left out; `unmapped` is ``keep`` or ``drop``.
    `computed` columns come from mapped ones. `duplicates` is what rows of one time become. `table`
    is a sheet of a workbook, a group of a TDMS file, or a variable of a MATLAB file.
    """

    file: str | None = None
    clock: Clock | None = None
    columns: Mapping[str, Rename | None] = field(default_factory=dict)
    unmapped: str = "keep"
    dialect: Dialect = Dialect()
    computed: tuple[Computed, ...] = ()
    duplicates: str | None = None
    table: str | None = None
    messages: SensorMessages | None = None

    def rename(self, name: str) -> Rename | None:
        """What becomes of column `name`; None leaves it out."""
        return self.columns.get(name, Rename(name) if self.unmapped == "keep" else None)

    def named_already(self, names: Iterable[str]) -> bool:
        """Whether columns have the names that the map gives, and a clock, and not those it reads.

        Parameters
        ----------
        names : iterable of str
        """
        names, needed = {*names}, [*self._needed()]
        renames = {k: r.name for k in needed if (r := self.columns[k])}
        clock = {*self.clock.columns} if self.clock else set()
        if names >= {*needed} | clock:
            return False
        given = {*renames.values(), *(each.name for each in self.computed)}
        read = {k for k, own in renames.items() if k != own} - given
        return bool(given) and given <= names and clock_unit(names) is not None and not read & names

    def check(self, names: Sequence[str], log: str) -> None:
        """Raise LogError where the map names a column that the log `names` does not have."""
        clock = self.clock.columns if self.clock else ()
        for wanted in [*clock, *self._needed()]:
            if wanted not in names:
                cure = "" if wanted in clock else "; optional = true in the map, where some lack it"
                lacking = f"{log} has no column {wanted}{hint(wanted, names)}{cure}"
                raise LogError(lacking, self.file)

    def _needed(self) -> Iterator[str]:
        """Columns that every log has."""
        return (name for name, own in self.columns.items() if own is None or not own.optional)


def read_map(source: Columns) -> ColumnMap:
    """A column map, from its file or from names by foreign names, that of the clock among them.

    Raises
    ------
    LogError
        Not TOML, an unknown key, a value of the wrong type, or a name without a known unit.
    TypeError
        `source` is neither.
    """
    if isinstance(source, Mapping):
        path = "<columns>"
        columns = {str(name): entry for name, entry in source.items()}
        document: dict[str, Any] = {"columns": columns}
        for name, entry in columns.items():
            if isinstance(entry, str) and (unit := clock_unit([entry])):
                document = {
                    "time": {"column": name, "unit": unit},
                    "columns": {other: columns[other] for other in columns if other != name},
                }
    elif isinstance(source, str | os.PathLike):
        path = os.fspath(source)
        document = _toml(path)
    else:
        raise TypeError(f"columns: a file, or a dict of names to names, not {source!r:.60}")
    try:
        _keys("the map", document, _KEYS)
        columns = _typed("columns", document.get("columns", {}), dict)
        return ColumnMap(
            file=path,
            clock=_clock(document["time"]) if "time" in document else None,
            columns={name: _rename(name, entry) for name, entry in columns.items()},
            unmapped=_choice("unmapped", document.get("unmapped", "keep"), ("keep", "drop")),
            dialect=_dialect(document),
            computed=tuple(
                make(name, entry)
                for key, make in (("angles", _angle), ("computed", _computed))
                for name, entry in _typed(key, document.get(key, {}), dict).items()
            ),
            duplicates=_duplicates(document),
            table=_typed("table", document["table"], str) if "table" in document else None,
            messages=_messages(document["messages"]) if "messages" in document else None,
        )
    except (UnitError, _MapError) as error:
        raise LogError(str(error), path) from error


def _duplicates(document: Mapping[str, Any]) -> str | None:
    """What rows of one time become; messages of one sensor each are no rows but together."""
    if "duplicates" in document:
        return _choice("duplicates", document["duplicates"], DUPLICATES)
    return "first" if "messages" in document else None


def _toml(path: str) -> dict[str, Any]:
    try:
        return parse_toml(read_input(path), path)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror or error}", path) from error
    except ModelError as error:
        raise LogError(str(error).removeprefix(f"{path}: "), path) from error


_KEYS = (
    *("time", "columns", "unmapped", "angles", "computed", "duplicates", "table", "messages"),
    *Dialect.__dataclass_fields__,
)


class _MapError(Exception):
    """Something in the map is not as it must be; `read_map` adds the file."""


def _clock(entry: Any) -> Clock:
    known = ("column", "unit", "period", "format", "within")
    _keys("[time]", _typed("[time]", entry, dict), known)
    if ("column" in entry) == ("period" in entry):
        raise _MapError("[time] takes either a column or a period")
    if "period" in entry:
        period = _number("time.period", entry["period"])
        if not period > 0:
            raise _MapError("time.period must be above 0 s")
        return Clock(period=period)
    pattern = entry.get("format")
    if pattern is not None:
        _typed("time.format", pattern, str)
    times = [unit for unit, (dimension, _) in UNITS.items() if dimension == "time"]
    unit = _choice("time.unit", entry.get("unit", "iso" if pattern else "s"), [*times, "iso"])
    if pattern and unit != "iso":
        raise _MapError("time.format goes with time.unit = 'iso'")
    if pattern and not is_time_pattern(pattern):
        raise _MapError(f"time.format: {pattern!r} is none, or says one part twice")
    names = entry["column"] if isinstance(entry["column"], list) else [entry["column"]]
    if not 1 <= len(names) <= 2 or (len(names) == 2 and unit != "iso"):
        raise _MapError("time.column is a name, or two (date and time of day) with unit = 'iso'")
    names = [_typed("time.column", name, str) for name in names]
    within = _number("time.within", entry.get("within", 0.0))
    if not within >= 0:
        raise _MapError("time.within must not be below 0 s")
    return Clock(names[0], unit, None, pattern, names[1] if names[1:] else None, within)


def _rename(name: str, entry: Any) -> Rename | None:
    if entry is False:
        return None
    if isinstance(entry, str):
        return Rename(parse_channel(entry).name)
    if not isinstance(entry, dict):
        raise _MapError(f"columns.{name} must be a name, a table with a name, or false")
    known = ("name", "scale", "offset", "unit", "valid", "missing", "optional")
    _keys(f"columns.{name}", entry, known)
    # A column with limits alone keeps its name.
    own = entry.get("name", name if {"valid", "missing", "optional"} & set(entry) else None)
    channel = parse_channel(_typed(f"columns.{name}.name", own, str))
    scale, offset = (
        _number(f"columns.{name}.{key}", entry.get(key, default))
        for key, default in (("scale", 1.0), ("offset", 0.0))
    )
    if "unit" in entry:
        written = _typed(f"columns.{name}.unit", entry["unit"], str)
        linear = to_unit(written, channel.unit)
        if linear is None:
            raise _MapError(f"columns.{name}.unit: {written!r} does not become {channel.unit}")
        # As the file has it: scale and offset are in the written unit.
        scale, offset = linear[0] * scale, linear[0] * offset + linear[1]
    missing = _numbers(f"columns.{name}.missing", entry.get("missing", []))
    valid = _valid(f"columns.{name}.valid", entry)
    optional = entry.get("optional", False)
    if not isinstance(optional, bool):
        raise _MapError(f"columns.{name}.optional is true or false")
    return Rename(channel.name, scale, offset, valid, missing, optional)


def _valid(place: str, entry: Mapping[str, Any]) -> tuple[float, float]:
    if "valid" not in entry:
        return -math.inf, math.inf
    ends = _numbers(place, entry["valid"])
    if len(ends) != 2 or ends[0] > ends[1]:
        raise _MapError(f"{place} is [lowest, highest]")
    return ends[0], ends[1]


def _numbers(place: str, value: Any) -> tuple[float, ...]:
    return tuple(_number(place, each) for each in _typed(place, value, list))


def _angle(name: str, entry: Any) -> Angle:
    place = f"angles.{name}"
    if parse_channel(name).dimension != "angle":
        raise _MapError(f"{place} is no angle by its name: it ends with _urad or _rad")
    _keys(place, _typed(place, entry, dict), ("probes", "distance_mm"))
    probes = _typed(f"{place}.probes", entry.get("probes"), list)
    if len(probes) != 2 or probes[0] == probes[1]:
        raise _MapError(f"{place}.probes names two columns")
    for probe in probes:
        if parse_channel(_typed(f"{place}.probes", probe, str)).dimension != "length":
            raise _MapError(f"{place}: {probe} is no displacement")
    distance = _number(f"{place}.distance_mm", entry.get("distance_mm"))
    if not distance > 0:
        raise _MapError(f"{place}.distance_mm must be above 0")
    return Angle(name, (probes[0], probes[1]), distance)


def _computed(name: str, entry: Any) -> Computed:
    place = f"computed.{name}"
    own = parse_channel(name).dimension
    _keys(place, _typed(place, entry, dict), ("power", "difference"))
    if len(entry) != 1:
        raise _MapError(f"{place} is either a power or a difference")
    ((kind, names),) = entry.items()
    if len(_typed(f"{place}.{kind}", names, list)) != 2:
        raise _MapError(f"{place}.{kind} names two columns")
    first, second = (_typed(f"{place}.{kind}", each, str) for each in names)
    if kind == "difference":
        if not difference_fits(name, (first, second)):
            raise _MapError(f"{place}: {first} less {second} is not what the name says")
        return Difference(name, (first, second))
    factors = {parse_channel(each).dimension for each in (first, second)}
    if own != "power" or factors != {"voltage", "current"}:
        raise _MapError(f"{place}: a power in W, mW or kW from a voltage and a current")
    return Power(name, (first, second))


def _messages(entry: Any) -> SensorMessages:
    _keys("[messages]", _typed("[messages]", entry, dict), ("name", "value"))
    return SensorMessages(
        *(_typed(f"messages.{key}", entry.get(key), str) for key in ("name", "value"))
    )


def _dialect(document: Mapping[str, Any]) -> Dialect:
    missing = _typed("missing", document.get("missing", []), list)
    encoding = _typed("encoding", document.get("encoding", "utf-8"), str)
    try:
        "".encode(encoding)  # of text: hex and the like are none
    except LookupError as error:
        raise _MapError(f"encoding: {encoding!r} is none, like 'cp1252' or 'utf-16'") from error
    return Dialect(
        encoding=encoding,
        skip=_count("skip", document),
        skip_after_names=_count("skip_after_names", document),
        separator=_choice("separator", document.get("separator", ","), (",", ";", "\t", "|")),
        decimal=_choice("decimal", document.get("decimal", "."), (".", ",")),
        missing=tuple(_typed("missing", word, str) for word in missing),
    )


def _count(key: str, document: Mapping[str, Any]) -> int:
    number = int(_typed(key, document.get(key, 0), int))
    if number < 0:
        raise _MapError(f"{key} is a number of lines, not {number}")
    return number


def _keys(place: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            raise _MapError(f"{place} knows no {key!r}{hint(key, known)}")


def _typed(place: str, value: Any, kind: Any) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise _MapError(f"{place} cannot be {value!r}")
    return value


def _number(place: str, value: Any) -> float:
    try:
        return finite(value)
    except ModelError as error:
        raise _MapError(f"{place}: {error}") from error


def _choice(place: str, value: Any, known: Sequence[str]) -> str:
    if value not in known:
        raise _MapError(f"{place} is one of {', '.join(map(repr, known))}, not {value!r}")
    return str(value)
