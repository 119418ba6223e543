"""``thermaltool order``: which AR or ARMA order a series has."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.series import column_of, model_options, series_options
from thermaltool.cli.types import POSITIVE


@click.command(
    epilog="Example: sensors | thermaltool order -C d_z_um --max-p 20 --figure orders.png"
)
@shared.log_argument
@series_options
@click.option("--max-p", type=click.IntRange(0, 200), default=10, help="Largest AR order.")
@click.option("--max-q", type=click.IntRange(0, 50), default=10, help="Largest MA order.")
@click.option(
    "--criterion",
    default="aic,aicc,bic",
    metavar="LIST",
    help="Of aic, aicc, bic, gao: what the best is chosen by. gao is N ln[RSS/(N - r)] + 2r with "
    "r = p + q + 1.",
)
@click.option(
    "--effort",
    type=POSITIVE,
    default=1.0,
    help="Factor on the likelihoods that the search may take: more time, perhaps a better order.",
)
@model_options
@click.option("--figure", metavar="FILE", help="Curves of the criteria, .png, .svg or .pdf.")
@shared.json_option
def command(log: str, max_p: int, max_q: int, criterion: str, effort: float,
            figure: str | None, as_json: bool, **options: Any) -> None:  # fmt: skip
    """Which AR or ARMA order a series has, by AIC, AICc and BIC.

    Every order up to --max-p, --max-q at once: all from one regression (marked ~), the promising
    ones by exact maximum likelihood. Gaps are respected. AIC prefers large models, in the whole
    grid often ones with nearly cancelling roots that describe a narrow line of the noise; BIC finds
    the order of a process more often.
    """
    from thermaltool import api
    from thermaltool.cli.messages import warn
    from thermaltool.cli.progress import terminal_progress
    from thermaltool.documents import write_json
    from thermaltool.report.style import figure_format, write_figure
    from thermaltool.timeseries.criteria import criteria_named

    with shared.usage_errors():
        criteria = criteria_named(criterion.split(","))
    if figure is not None:
        figure_format(figure)
        shared.check_files(figure, log)
    progress = terminal_progress("order")
    result = api.order(
        log, column_of(options), max_p=max_p, max_q=max_q, criteria=criteria, effort=effort,
        warn=warn, **options,
    )  # fmt: skip
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    if as_json:
        write_json(result.document(), "-")
    else:
        click.echo(result.table())
    if figure is not None:
        write_figure(result.draw, figure)
