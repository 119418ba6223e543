"""What ``order``, ``fit`` and ``forecast`` share: one column of a log as a record."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli.messages import warn
from thermaltool.cli.options import NUMBER, POSITIVE, columns_option, from_option, gap_option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from thermaltool.record import Record

    Index = NDArray[np.intp]

# Degree of the polynomial that is estimated along.
DEGREES = {"mean": 0, "linear": 1, "none": -1}
# Outliers that are named one by one.
MAX_OUTLIER_LINES = 5

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


def load_series(log: str, options: dict[str, Any]) -> tuple[Record, float]:
    """The even record that the common options name (taken out of `options`), and its period [s]."""
    from thermaltool.logs.series import read_series

    names = ("columns", "from_format", "period", "max_gap", "start", "stop")
    column = options.pop("column")
    if column is None:
        raise click.UsageError("name the column with --column")
    given = {name: options.pop(name) for name in names}
    record, counted = read_series(log, column, **given)
    if counted and given["period"] is None:
        warn(
            f"{record.name}: no clock (a column time_s or time_min, or ISO 8601 times in time): "
            "samples are counted, 1 s each (--period)"
        )
    return record, given["period"] or record.period


def place_of(record: Record) -> str:
    """File and column, for messages."""
    return f"{record.name}: {', '.join(record.columns)}"


def warn_outliers(record: Record, rows: Index) -> None:
    """Say which samples stand alone."""
    (values,), place = record.columns.values(), place_of(record)
    for row in rows[:MAX_OUTLIER_LINES].tolist():
        warn(
            f"{place}: {values[row]:.6g} at {record.time[row]:.10g} s stands alone: "
            "left out as missing (--outliers keep takes it)"
        )
    if rows.size > MAX_OUTLIER_LINES:
        warn(f"{place}: {rows.size - MAX_OUTLIER_LINES} more like this")


def screened_series(record: Record, options: dict[str, Any]) -> tuple[Record, int, int]:
    """The record without outliers, the degree of its trend, and the difference to be taken."""
    from thermaltool.errors import FitError
    from thermaltool.timeseries.runs import runs
    from thermaltool.timeseries.screening import screened

    order = options.pop("difference") or 0
    detrend = options.pop("detrend") or ("none" if order else "mean")
    place = place_of(record)
    try:
        good, outliers = screened(record, options.pop("outliers") == "omit", order)
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    warn_outliers(record, outliers)
    holes = len(runs(good)) - 1
    if holes:
        warn(f"{place}: {holes} gaps; what is missing is integrated out of the likelihood")
    return good, DEGREES[detrend], order
