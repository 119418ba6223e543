"""``thermaltool order``: which AR or ARMA order a series has."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli.options import POSITIVE, json_option, log_argument
from thermaltool.cli.series import model_options, one_thread, series_options


@click.command(
    epilog="Example: sensors | thermaltool order -C d_z_um --max-p 20 --figure orders.png"
)
@log_argument
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
@json_option
def command(log: str, max_p: int, max_q: int, criterion: str, effort: float,
            figure: str | None, as_json: bool, **options: Any) -> None:  # fmt: skip
    """Which AR or ARMA order a series has, by AIC, AICc and BIC.

    Every order up to --max-p, --max-q at once: all from one regression (marked ~), the promising
    ones by exact maximum likelihood. Gaps are respected. AIC prefers large models, in the whole
    grid often ones with nearly cancelling roots that describe a narrow line of the noise; BIC finds
    the order of a process more often.
    """
    one_thread()
    from thermaltool.cli.messages import warn
    from thermaltool.cli.options import keep_inputs
    from thermaltool.cli.series import load_series, place_of, screened_series
    from thermaltool.documents import atomic_output, write_json
    from thermaltool.errors import FitError
    from thermaltool.report.orders import draw_orders, order_document, order_table, order_warnings
    from thermaltool.report.style import figure_format, render
    from thermaltool.timeseries.criteria import criteria_named
    from thermaltool.timeseries.order import BUDGET, select_order
    from thermaltool.timeseries.runs import difference

    try:
        names = criteria_named(criterion.split(","))
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    kind = figure_format(figure) if figure is not None else None
    if figure is not None:
        keep_inputs(figure, log)
    series, _ = load_series(log, options)
    record, degree, order = screened_series(series, options)
    changed, place = difference(record, order), place_of(record)
    try:
        table = select_order(changed, max_p, max_q, degree, names, max(round(effort * BUDGET), 1))
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    for message in order_warnings(table, names, changed, degree, order):
        warn(f"{place}: {message}")
    if figure is not None and kind is not None:
        title = f"{', '.join(record.columns)}, {record.name}"
        picture = render(lambda: draw_orders(title, table, names), kind)
        with atomic_output(figure) as stream:
            stream.write(picture)
    if as_json:
        write_json(order_document(table, names), "-")
    else:
        click.echo(order_table(table, names))
