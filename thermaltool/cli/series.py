"""What ``order``, ``fit`` and ``forecast`` share: one column of a log as a record."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli.messages import warn
from thermaltool.cli.options import NUMBER, POSITIVE, columns_option, from_option, gap_option

if TYPE_CHECKING:
    from thermaltool.logs.series import Series
    from thermaltool.timeseries.record import Record

DEGREES = {"mean": 0, "linear": 1, "none": -1}

column_option = click.option(
    "-C", "--column", metavar="NAME", help="The column; any name will do without --columns."
)
outliers_option = click.option(
    "--outliers",
    type=click.Choice(["omit", "keep"]),
    default="omit",
    help="Samples that stand alone count as missing, or are taken as they are.",
)
period_option = click.option(
    "--period",
    type=POSITIVE,
    metavar="S",
    help="Sample period [s].  [default: median step of the clock; 1 without a clock]",
)


def series_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Everything that reading a series takes."""
    for option in (
        gap_option,
        click.option("--stop", type=NUMBER, metavar="SECONDS", help="Up to this time [s]."),
        click.option("--start", type=NUMBER, metavar="SECONDS", help="From this time on [s]."),
        period_option,
        from_option,
        columns_option,
        column_option,
    ):
        function = option(function)
    return function


def model_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """How the series is prepared."""
    for option in (
        outliers_option,
        click.option(
            "--difference",
            type=click.IntRange(0, 3),
            help="Difference the series so often first.  [default: 0]",
        ),
        click.option(
            "--detrend",
            type=click.Choice(list(DEGREES)),
            help="What is estimated along.  [default: mean; none with --difference]",
        ),
    ):
        function = option(function)
    return function


def one_thread() -> None:
    """Long sums over few rows: threads would only wait. Read when numpy is loaded."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def load_series(log: str, options: dict[str, Any]) -> Series:
    """The series that the common options name (taken out of `options`)."""
    from thermaltool.logs.series import read_series

    names = ("columns", "from_format", "period", "max_gap", "start", "stop")
    column = options.pop("column")
    if column is None:
        raise click.UsageError("name the column with --column")
    given = {name: options.pop(name) for name in names}
    series = read_series(log, column, **given)
    if series.counted and given["period"] is None:
        warn(
            f"{series.name}: no clock (a column time_s or time_min, or ISO 8601 times in time): "
            "samples are counted, 1 s each (--period)"
        )
    return series


def without_outliers(record: Record, series: Series) -> Record:
    """The record without samples that stand alone; they are told."""
    from thermaltool.timeseries.screening import find_outliers

    place, rows = f"{series.name}: {series.channel}", find_outliers(record)
    for row in rows[:5].tolist():
        at = series.time[0] + record.places[row] * series.period
        warn(
            f"{place}: {record.values[row]:.6g} at {at:.10g} s stands alone: "
            "left out as missing (--outliers keep takes it)"
        )
    if rows.size > 5:
        warn(f"{place}: {rows.size - 5} more like this")
    return record.without(rows) if rows.size else record


def load_record(series: Series, options: dict[str, Any]) -> tuple[Record, int, int]:
    """The record without outliers, the degree of its trend, the difference (all told)."""
    from thermaltool.errors import FitError
    from thermaltool.timeseries.record import record_of
    from thermaltool.timeseries.screening import check_size, is_computed

    difference = options.pop("difference") or 0
    detrend = options.pop("detrend") or ("none" if difference else "mean")
    place = f"{series.name}: {series.channel}"
    try:
        record = record_of(series.values, series.segments, series.places)
        check_size(record)
        if is_computed(record):
            raise FitError(
                "each sample follows from those before it to rounding (a line, a sine, a period): "
                "there is no noise to model"
            )
        if options.pop("outliers") == "omit":
            record = without_outliers(record, series)
        record.difference(difference)
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    holes = len(record.runs) - 1
    if holes:
        warn(f"{place}: {holes} gaps; what is missing is integrated out of the likelihood")
    return record, DEGREES[detrend], difference
