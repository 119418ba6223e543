"""Options of ``order``, ``fit`` and ``forecast``."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import click

from thermaltool.api.series import TRENDS
from thermaltool.cli.options import NUMBER, POSITIVE, columns_option, from_option, gap_option

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
            type=click.Choice(list(TRENDS)),
            help="What is estimated along.  [default: mean; none with --difference]",
        ),
    ):
        function = option(function)
    return function


def one_thread() -> None:
    """Long sums over few rows: threads would only wait. Read when numpy is loaded."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def column_of(options: dict[str, Any]) -> str:
    """The column, taken out of the options; it has to be named."""
    column: str | None = options.pop("column")
    if column is None:
        raise click.UsageError("name the column with --column")
    return column
