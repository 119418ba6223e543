"""``thermaltool fit``: an AR or ARMA model of a series."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.series import column_of, model_options, series_options
from thermaltool.cli.types import PROPER_SHARE, Order

METHODS = (
    "ml", "burg", "yule-walker", "least-squares", "hannan-rissanen", "innovations"
)  # fmt: skip


@click.command(epilog="Example: sensors | thermaltool fit -C d_z_um --order 2,1 -o arma.json")
@shared.log_argument
@series_options
@click.option("--order", type=Order(), help="AR and MA order.  [default: the best by BIC]")
@click.option(
    "--method",
    type=click.Choice(METHODS),
    default="ml",
    help="ml is exact maximum likelihood; burg, yule-walker, least-squares take P,0.",
)
@click.option(
    "--long-order",
    type=click.IntRange(1),
    help="Order of the first stage of hannan-rissanen and innovations.  [default: by AIC, and "
    "10 log10 N]",
)
@click.option(
    "--regressions",
    type=click.Choice(["2", "3"]),
    default="3",
    help="Of hannan-rissanen: the third takes away bias; textbook examples stop after two.",
)
@click.option(
    "--level", type=PROPER_SHARE, default=0.95,
    help="Of the intervals.",
)  # fmt: skip
@model_options
@click.option("-o", "--output", metavar="FILE", help="Where the model goes.")
@shared.json_option
def command(log: str, order: tuple[int, int] | None, method: str, long_order: int | None,
            regressions: str, level: float, output: str | None, as_json: bool,
            **options: Any) -> None:  # fmt: skip
    """An AR or ARMA model of a series: coefficients, roots, natural frequencies.

    x_t - m = sum ar_i (x_{t-i} - m) + a_t + sum ma_j a_{t-j}: what others write as -theta is ma.
    The table goes to stdout, the model to -o. Likelihood and criteria are exact for every method.
    """
    from thermaltool import api
    from thermaltool.cli.messages import command_line, warn
    from thermaltool.cli.progress import terminal_progress
    from thermaltool.documents import write_json

    shared.check_files(output, log)
    progress = terminal_progress("fit")
    result = api.fit(
        log, column_of(options), order, method=method, long_order=long_order,
        correct=regressions == "3", level=level, command=command_line(), warn=warn, **options,
    )  # fmt: skip
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    if as_json:
        write_json(result.document(), "-")
    elif output != "-":
        click.echo(result.table())
    if output is not None:
        write_json(result.document(), output)
