"""One column of a log as an even series, whatever its name; a clock is used where there is one."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import LogError
from thermaltool.logs.clock import segments
from thermaltool.logs.columns import Clock, ColumnMap
from thermaltool.logs.opening import open_source
from thermaltool.logs.reader import read_log
from thermaltool.logs.table import MAX_TIME, Kind, beyond_range
from thermaltool.logs.time_stamps import iso_clock
from thermaltool.record import Array, Record, hint
from thermaltool.units import UNITS, clock_unit

if TYPE_CHECKING:
    from thermaltool.logs.columns import Columns
    from thermaltool.logs.reader import Data, TableSource

# Share of the period by which a step may differ from a whole number of periods: jitter, and the
# rounding of printed times.
MAX_UNEVENNESS = 0.25


def read_series(
    data: Data,
    column: str,
    *,
    columns: Columns | None = None,
    from_format: str | None = None,
    period: float | None = None,
    max_gap: float | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> tuple[Record, bool]:
    """One column of a log on an even clock: a row for every period of a segment.

    Without a map any name will do, and a log without a clock (``time_s``, another time unit, ISO
    8601 ``time``) is counted.

    Parameters
    ----------
    data, columns, from_format, max_gap
        As for `read_log`.
    column : str
    period : float, optional
        Sample period [s]; the median step, or 1 where there is no clock.
    start, stop : float, optional
        First and last time taken [s].

    Returns
    -------
    record : Record
        Of one channel, NaN where a sample is missing. Its clock is that of the log, and where a
        period is given the even one that ends with it.
    counted : bool
        Whether there is no clock, so that samples are counted.

    Raises
    ------
    LogError
        As `read_log`; uneven sampling; no row left.
    """
    if isinstance(data, Record):
        name, digest, lines = data.name, data.digest, np.arange(1, len(data) + 1)
        time, values, counted = data.time, data.column(column), False
    elif columns is not None:
        log = read_log(data, columns=columns, from_format=from_format, max_gap=max_gap)
        name, digest, lines = log.name, log.digest, log.lines
        time, values, counted = log.time, log.column(column), False
    else:
        name, digest, lines, found, values = _lenient(data, column, from_format)
        counted = found is None
        time = (period or 1.0) * np.arange(float(values.size)) if found is None else found
    rows = np.ones(time.size, dtype=bool)
    rows &= True if start is None else time >= start
    rows &= True if stop is None else time <= stop
    if not rows.any():
        raise LogError("no row is left" if time.size else "no rows", name)
    time, values, lines = time[rows], values[rows], lines[rows]
    beyond = beyond_range(name, None, time, lines, MAX_TIME)
    for error in beyond or beyond_range(name, column, values, lines):
        raise error
    steps = np.diff(time)
    for k in np.flatnonzero(~(steps > 0.0))[:1]:
        message = f"the clock does not increase: {time[k + 1]:.15g} s"
        raise LogError(message, name, int(lines[k + 1]))
    step = period
    if step is None:
        step = 1.0 if counted or not steps.size else float(np.median(steps))
    whole = np.rint(steps / step)
    uneven = (np.abs(steps / step - whole) > MAX_UNEVENNESS) | (whole < 1.0)
    parts = segments(time, max_gap)
    # A pause that parts the record may have any length.
    uneven[[part.start - 1 for part in parts[1:]]] = False
    for k in np.flatnonzero(uneven)[:1]:
        raise LogError(
            f"a step of {steps[k]:.6g} s is no whole number of periods of {step:.6g} s: an even "
            "clock is needed (--period)",
            name,
            int(lines[k + 1]),
        )
    places = np.concatenate(([0.0], np.cumsum(np.maximum(whole, 1.0))))
    if period is not None:
        time = time[-1] - step * (places[-1] - places)
    return _filled(name, column, digest, time, values, places, parts), counted


def _filled(
    name: str,
    column: str,
    digest: str,
    time: Array,
    values: Array,
    places: Array,
    parts: tuple[slice, ...],
) -> Record:
    """The record with a row for every place [periods] inside a segment."""
    clocks, filled = [], []
    for part in parts:
        row = (places[part] - places[part.start]).astype(np.intp)
        every = np.arange(row[-1] + 1)
        clocks.append(np.interp(every, row, time[part]))
        filled.append(np.full(every.size, np.nan))
        filled[-1][row] = values[part]
    edges = np.cumsum([0, *(len(clock) for clock in clocks)]).tolist()
    cut = tuple(slice(a, b) for a, b in pairwise(edges))
    return Record(np.concatenate(clocks), {column: np.concatenate(filled)}, cut, digest, name)


def _lenient(
    source: TableSource, column: str, from_format: str | None
) -> tuple[str, str, NDArray[np.intp], Array | None, Array]:
    name, digest, table = open_source(source, from_format, ColumnMap())
    if column not in table.names:
        raise LogError(f"no column {column}{hint(column, table.names)}", name)
    clock, unit = _clock(table.names)
    for k in (table.names.index(column), clock):
        if k is not None and table.names.count(table.names[k]) > 1:
            raise LogError("this name is there twice", name, table.header_line, table.names[k])
    kinds: list[Kind] = [None] * len(table.names)
    kinds[table.names.index(column)] = "number"
    if clock is not None:
        kinds[clock] = "text" if unit == "iso" else "number"
    cells = table.cells(kinds)
    if cells.problems:
        raise cells.problems[0]
    values = cast(Array, cells.values[table.names.index(column)])
    if clock is None:
        return name, digest, cells.lines, None, values
    if unit != "iso":
        time: Array | None = cast(Array, cells.values[clock]) * UNITS[unit][1]
    else:
        time = _stamps(name, cast(list[str | None], cells.values[clock]), cells.lines)
    if time is not None and np.isnan(time).any():
        raise LogError("missing time", name, int(cells.lines[np.argmax(np.isnan(time))]))
    return name, digest, cells.lines, time, values


def _clock(names: list[str]) -> tuple[int | None, str]:
    unit = clock_unit(names)
    if unit is None:
        return None, ""
    return names.index("time" if unit == "iso" else f"time_{unit}"), unit


def _stamps(file: str, stamps: list[str | None], lines: NDArray[np.intp]) -> Array | None:
    """Seconds of ISO 8601 stamps; None where ``time`` holds plain numbers (years, an index)."""
    first = next((stamp for stamp in stamps if stamp), None)
    if first is None or first.strip().lstrip("+-").replace(".", "", 1).isdigit():
        return None
    time, _, faults = iso_clock(file, Clock("time", "iso"), stamps, lines.tolist())
    if faults:
        raise faults[0]
    return time
