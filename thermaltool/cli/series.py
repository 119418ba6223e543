"""Options of ``order``, ``fit`` and ``forecast``."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.api.series import TRENDS
from thermaltool.cli import shared
from thermaltool.cli.types import DURATION

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
    type=DURATION,
    metavar="S",
    help="Sample period [s].  [default: median step of the clock; 1 without a clock]",
)
# Everything that reading a series takes.
series_options = shared.together(
    column_option,
    shared.columns_option,
    shared.from_option,
    period_option,
    shared.span_options("From", "Up to"),
    shared.gap_option,
)
# How the series is prepared.
model_options = shared.together(
    click.option(
        "--detrend",
        type=click.Choice(list(TRENDS)),
        help="What is estimated along.  [default: mean; none with --difference]",
    ),
    click.option(
        "--difference",
        type=click.IntRange(0, 3),
        help="Difference the series so often first.  [default: 0]",
    ),
    outliers_option,
)


def column_of(options: dict[str, Any]) -> str:
    """The column, taken out of the options; it has to be named."""
    column: str | None = options.pop("column")
    if column is None:
        raise click.UsageError("name the column with --column")
    return column
