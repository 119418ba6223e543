"""Reading a log: bytes to table, names to channels, a clock to seconds."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from thermaltool.documents import MAX_NUMBER
from thermaltool.errors import LogError, UnitError
from thermaltool.logs.clock import segments
from thermaltool.logs.columns import Clock, ColumnMap, Columns, Rename, read_map
from thermaltool.logs.duplicates import merged
from thermaltool.logs.faults import FAULT_POLICIES, find_faults, without
from thermaltool.logs.log import Log
from thermaltool.logs.opening import open_mapped
from thermaltool.logs.table import (
    MAX_TIME,
    Cells,
    Kind,
    Table,
    beyond_range,
    first_faults,
)
from thermaltool.logs.time_stamps import iso_clock, joined_stamps
from thermaltool.logs.unread import spared_cells, with_cure
from thermaltool.record import Array, Record, hint
from thermaltool.status import WORDS
from thermaltool.units import UNITS, clock_unit, names, parse_channel

if TYPE_CHECKING:
    from thermaltool.logs.opening import TableSource

    Data: TypeAlias = TableSource | Record

# What to do about a time stamp that repeats.
REPEATS_CURE = "; --duplicates first, mean or spread says what such rows become"
# What a missing value in a needed channel does.
NAN_POLICIES = ("raise", "omit", "hold")


def read_log(
    data: Data,
    *,
    columns: Columns | None = None,
    from_format: str | None = None,
    nan_policy: str = "raise",
    max_gap: float | None = None,
    duplicates: str | None = None,
    faults: str = "keep",
    keep_spikes: Sequence[str] = (),
    need: str | Sequence[str] = (),
    outputs: Sequence[str] = (),
    unread: bool = False,
    strict: bool = True,
) -> Log:
    """A log, from a file, a data frame or a record.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
        A file (of a format in `thermaltool.logs.formats.READABLE`; ``-`` is stdin), or a frame
        with columns named as in logs (``T_spindle_degC``) and a clock: a column ``time_s`` or
        ``time``, or a `DatetimeIndex`.
    columns : str, path or dict, optional
        A column map for foreign names: a file (TOML), or names by foreign names
        (``{"Temp 1": "T_spindle_degC", "t": "time_s", "comment": False}``).
    from_format : str, optional
        Format of the file. Default: by its suffix, else by its content, else CSV.
    nan_policy : {"raise", "omit", "hold"}
        What a missing value in a channel of `need` does: raise, leave the row out, or take the
        channel's last value. Other channels keep NaN.
    max_gap : float, optional
        A pause above this [s] starts a new segment. Default: ten median periods, or ten pauses
        where the log is sampled in bursts; the segments of a record stay.
    duplicates : {"first", "mean", "spread"}, optional
        What rows of one time stamp become: one row (the first readings, or their means; readings
        that are missing count as none, so that messages of several sensors make one row), or as
        many, spread up to the next stamp. Default: what the column map says, else an error.
    faults : {"omit", "keep"}
        Whether readings of temperatures and displacements that are a sensor's fault
        (`thermaltool.logs.faults`) become missing values. Where one is in a channel of `need`, the
        row is left out (or the last value held, with ``hold``). Stages that fit, judge or estimate
        take ``omit`` by default.
    keep_spikes : sequence of str
        Channels whose spikes stay, for a stage that finds them itself.
    need : str or sequence of str
        Channels that must be there.
    outputs : sequence of str
        Further channels that must be there. A row in which they alone are missing stays under
        ``omit``, and where the reading is a fault.
    unread : bool
        Whether a cell that is no number is a missing value in every channel, for a stage that
        learns from the log which it needs. So it is in channels beside `need` and `outputs` where
        these are given. `Log.unread` has the first of each channel.
    strict : bool
        True raises at the first fault. False reads around faults and lists them in
        `Log.problems`: a bad cell is NaN, a ragged line is left out, a clock is kept as it is. A
        record is always read strictly.

    Returns
    -------
    Log
        Zero rows where the input has a header only.

    Raises
    ------
    LogError
        With file, line and column: unreadable, empty, truncated, ragged, text or infinity in a
        number, a number too large to square, unknown unit, column missing or there twice, clock
        absent, backward or repeated,
        a missing value under ``raise``.
    UnitError
        A column of a record whose name has no known unit.

    Examples
    --------
    >>> import pandas as pd, thermaltool as tt
    >>> frame = pd.DataFrame({"time_s": [0.0, 10.0, 20.0], "T_spindle_degC": [20.0, 20.4, 20.7]})
    >>> tt.read_log(frame)
    <frame>: 3 rows, 20 s, 1 segment
    period 10 s
    channel                  min           max  unit   missing
    T_spindle_degC            20          20.7  degC   0 %
    """
    need = names(need)
    if isinstance(data, Record):
        if columns is not None or from_format is not None:
            raise ValueError("columns and from_format say how a file or a frame is read")
        log = _of_record(data, max_gap, duplicates, need, outputs, nan_policy)
        return _left_out(log, faults, keep_spikes, need, outputs, nan_policy)
    mapping = ColumnMap() if columns is None else read_map(columns)
    asked = mapping
    name, digest, table, mapping = open_mapped(data, from_format, asked)
    plan = _plan(name, table, mapping)
    cells = table.cells(plan.kinds)
    names_of = {table.names[i]: rename.name for i, rename in plan.renames.items()}
    spare = spared_cells(cells.problems, names_of, mapping, (*need, *outputs))
    if strict and not (unread or need or outputs):
        spare = {}
    problems = [*plan.problems, *(p for p in cells.problems if not strict or p.column not in spare)]
    if strict and problems:
        raise with_cure(problems[0])
    time, epoch, disorder = _clock(name, table, plan, cells)
    log = Log(
        name=name,
        time=time,
        columns={
            rename.name: rename.of(cast(Array, cells.values[i]))
            for i, rename in plan.renames.items()
        },
        digest=digest,
        epoch=epoch,
        lines=cells.lines,
        unread={names_of[column]: each for column, each in spare.items()},
        spared_map=asked.file if mapping is not asked else None,
    )
    log, beyond = _within_range(_with_computed(log, mapping), plan.clock.column)
    if strict and beyond:
        raise beyond[0]
    problems += beyond
    log = merged(log, duplicates or mapping.duplicates, plan.clock.within)
    log = _without_gaps(log, need, nan_policy, outputs)
    missing = _missing_times(log, plan.clock.column, [*problems, *disorder])
    of_clock = disorder, missing, _disorder(log, plan.clock.column)
    if strict and (wrong := [fault for each in of_clock for fault in each]):
        raise wrong[0]
    if cells.unfinished:
        problems.append(cells.unfinished)
    for each in of_clock:
        problems += first_faults(each)
    log = replace(log, segments=segments(log.time, max_gap), problems=tuple(problems))
    return _left_out(log, faults, keep_spikes, need, outputs, nan_policy)


def _of_record(
    record: Record,
    max_gap: float | None,
    duplicates: str | None,
    need: Sequence[str],
    outputs: Sequence[str],
    nan_policy: str,
) -> Log:
    """A record as a log; it keeps its lines in a file, and its segments but for a `max_gap`."""
    if not isinstance(record, Log):
        own = {each.name: getattr(record, each.name) for each in fields(Record)}
        for name in record.columns:
            parse_channel(name)
        record = Log(**own, lines=np.arange(1, len(record) + 1))
        if not record.digest:
            record = replace(record, digest=_samples_digest(record))
    if faults := _within_range(record, "time_s")[1]:
        raise faults[0]
    log = _without_gaps(merged(record, duplicates), need, nan_policy, outputs)
    if faults := [*_missing_times(log, "time_s"), *_disorder(log, "time_s")]:
        raise faults[0]
    return log if max_gap is None else replace(log, segments=segments(log.time, max_gap))


def _samples_digest(record: Record) -> str:
    """SHA-256 of names, clock and values: identifies a record that was not read from a file."""
    digest = hashlib.sha256(record.time.tobytes())
    for name, values in record.columns.items():
        digest.update(name.encode() + b"\0" + values.tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Plan:
    """Which column of the table becomes what."""

    clock: Clock
    kinds: list[Kind]
    renames: dict[int, Rename]
    problems: list[LogError]


def _plan(file: str, table: Table, mapping: ColumnMap) -> _Plan:
    """Give every column its kind, name and channel; what does not fit is a problem."""
    clock = mapping.clock or _own_clock(file, table)
    kinds: list[Kind] = [None] * len(table.names)
    renames: dict[int, Rename] = {}
    problems: list[LogError] = []
    # Tables of some ten thousand columns: no search through those before.
    seen, taken = set[str](), set[str]()

    def fault(message: str, name: str | None) -> None:
        problems.append(LogError(message, file, table.header_line, name))

    for i, name in enumerate(table.names):
        own = name in clock.columns
        rename = None if own else mapping.rename(name)
        if not own and (rename is None or rename.name in WORDS):
            continue
        if name in seen:
            fault("this name is there twice", name)
            continue
        seen.add(name)
        if rename is None:
            kinds[i] = "text" if clock.unit == "iso" else "number"
            continue
        if rename.name == "time_s":
            fault(f"time_s is the name of the clock, which is {clock.column or 'none'} here: "
                  "[time] in a map names it, and false leaves a column out", name)  # fmt: skip
            continue
        if rename.name in taken:
            fault(f"two columns are mapped to {rename.name}", name)
            continue
        if not name:
            fault(f"column {i + 1} has no name ('\"\" = false' in a map leaves it out)", None)
            continue
        try:
            parse_channel(rename.name)
        except UnitError as error:
            fault(str(error).removeprefix(f"{rename.name}: "), name)
        kinds[i], renames[i] = "number", rename
        taken.add(rename.name)
    return _Plan(clock, kinds, renames, problems)


def _own_clock(file: str, table: Table) -> Clock:
    """The clock by the tool's own names: ``time_s``, another time unit, or ISO 8601 ``time``."""
    unit = clock_unit(table.names)
    if unit is not None:
        return Clock("time" if unit == "iso" else f"time_{unit}", unit)
    raise LogError(
        f"no clock: no column time_s or time{hint('time_s', table.names)}; a map for --columns "
        "names another one, or a period for logs without (check --write-map drafts one)",
        file,
        table.header_line,
    )


def _clock(
    file: str, table: Table, plan: _Plan, cells: Cells
) -> tuple[Array, str | None, list[LogError]]:
    """The clock [s], its epoch, and what is wrong with its cells."""
    clock = plan.clock
    if clock.column is None:
        return (clock.period or 1.0) * np.arange(len(cells.lines), dtype=np.float64), None, []
    values = cells.values[table.names.index(clock.column)]
    if clock.unit == "iso":
        stamps = cast(list[str | None], values)
        if clock.joined is not None:
            second = cells.values[table.names.index(clock.joined)]
            stamps = joined_stamps(stamps, cast(list[str | None], second))
        return iso_clock(file, clock, stamps, cells.lines.tolist())
    return cast(Array, values) * UNITS[clock.unit][1], None, []


def _with_computed(log: Log, mapping: ColumnMap) -> Log:
    """The columns that a map computes, beside what was read."""
    for each in mapping.computed:
        if each.name in log.columns:
            raise LogError(f"{each.name}: {log.name} has this column", mapping.file)
        values = each.of(*(log.column(name) for name in each.inputs))
        log = log.with_columns({each.name: values})
    return log


def _within_range(log: Log, clock: str | None) -> tuple[Log, list[LogError]]:
    """The log, NaN where a number is too large to be worked with, and where that is."""
    faults = first_faults(beyond_range(log.name, clock, log.time, log.lines, MAX_TIME))
    if faults:
        log = replace(log, time=np.where(np.abs(log.time) > MAX_TIME, np.nan, log.time))
    kept = {}
    for name, values in log.columns.items():
        if found := beyond_range(log.name, name, values, log.lines):
            kept[name] = np.where(np.abs(values) > MAX_NUMBER, np.nan, values)
            faults += first_faults(found)
    return log.with_columns(kept) if kept else log, faults


def _left_out(
    log: Log,
    faults: str,
    keep_spikes: Sequence[str],
    need: Sequence[str],
    outputs: Sequence[str],
    nan_policy: str,
) -> Log:
    """The log without a sensor's faults, in what is needed by the policy for missing values."""
    if faults not in FAULT_POLICIES:
        raise ValueError(f"faults {faults!r}: one of {', '.join(FAULT_POLICIES)}")
    found = tuple(
        each
        for each in (find_faults(log) if faults == "omit" else ())
        if each.kind != "spike" or each.channel not in keep_spikes
    )
    if not found:
        return log
    log = replace(without(log, found), faults=found)
    for name in (*need, *outputs):
        first = next((each for each in found if each.channel == name), None)
        if first and np.isnan(log.columns[name]).all():
            raise LogError(f"no reading but faults: {first.message}", log.name, None, name)
    return _without_gaps(log, need, "hold" if nan_policy == "hold" else "omit")


def _without_gaps(log: Log, need: Sequence[str], policy: str, outputs: Sequence[str] = ()) -> Log:
    """Apply the policy for missing values to what is needed."""
    if policy not in NAN_POLICIES:
        raise ValueError(f"nan_policy {policy!r}: one of {', '.join(NAN_POLICIES)}")
    needed = {name: log.column(name) for name in (*need, *outputs)}
    for name, values in needed.items():
        # A fit divides by squares, which would be 0.
        if 0 < np.fmax.reduce(np.abs(values), initial=0.0) < 1 / MAX_NUMBER:
            raise LogError(f"too small, none above {1 / MAX_NUMBER:g}", log.name, None, name)
    if policy == "omit":
        bad = np.any([np.isnan(each) for each in (log.time, *(needed[n] for n in need))], axis=0)
        return log.where(~bad) if bad.any() else log
    for name, values in needed.items():
        missing = np.isnan(values)
        if not missing.any():
            continue
        if missing.all():
            raise LogError("no reading at all", log.name, None, name)
        row = int(np.argmax(missing))
        if policy == "raise":
            message = f"missing value ({missing.sum()} in all): see --nan-policy"
            raise LogError(message, log.name, int(log.lines[row]), name)
        if missing[0]:
            message = "missing value and none before it to hold"
            raise LogError(message, log.name, int(log.lines[0]), name)
        last = np.maximum.accumulate(np.where(missing, 0, np.arange(len(values))))
        log = log.with_columns({name: values[last]})
    return log


def _missing_times(log: Log, clock: str | None, told: Sequence[LogError] = ()) -> list[LogError]:
    """Rows without a time, but for those whose cell is a fault already, and those counted there."""
    of_clock = [each.line for each in told if each.column == clock]
    if None in of_clock:
        return []
    lines = (int(log.lines[k]) for k in np.flatnonzero(np.isnan(log.time)))
    return [LogError("missing time", log.name, k, clock) for k in lines if k not in of_clock]


def _disorder(log: Log, clock: str | None) -> list[LogError]:
    """Where the clock does not increase."""
    rows = np.flatnonzero(~np.isnan(log.time))
    time = log.time[rows]
    faults = []
    for k in np.flatnonzero(np.diff(time) <= 0):
        what = "repeats" if time[k + 1] == time[k] else "goes backward"
        message = f"the clock {what}: {time[k + 1]:.15g} s after {time[k]:.15g} s"
        if what == "repeats":
            message += REPEATS_CURE
        faults.append(LogError(message, log.name, int(log.lines[rows[k + 1]]), clock))
    return faults
