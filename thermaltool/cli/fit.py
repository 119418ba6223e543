"""``thermaltool fit``: an AR or ARMA model of a series."""

from __future__ import annotations

import sys
from typing import Any

import click

from thermaltool.cli.options import json_option, log_argument
from thermaltool.cli.series import model_options, one_thread, series_options

METHODS = (
    "ml", "burg", "yule-walker", "least-squares", "hannan-rissanen", "innovations"
)  # fmt: skip


# As `order` goes.
LARGEST = 200


class Order(click.ParamType):
    name = "P,Q"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        p, comma, q = value.partition(",")
        if value.isascii() and p.strip().isdigit() and (q.strip().isdigit() or not comma):
            if max(int(p), int(q or 0)) > LARGEST:
                self.fail(f"{value!r}: orders go up to {LARGEST}", param, ctx)
            return int(p), int(q or 0)
        self.fail(f"{value!r} is not {self.name}", param, ctx)


@click.command(epilog="Example: sensors | thermaltool fit -C d_z_um --order 2,1 -o arma.json")
@log_argument
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
    "--level", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=0.95,
    help="Of the intervals.",
)  # fmt: skip
@model_options
@click.option("-o", "--output", metavar="FILE", help="Where the model goes.")
@json_option
def command(log: str, order: tuple[int, int] | None, method: str, long_order: int | None,
            regressions: str, level: float, output: str | None, as_json: bool,
            **options: Any) -> None:  # fmt: skip
    """An AR or ARMA model of a series: coefficients, roots, natural frequencies.

    x_t - m = sum ar_i (x_{t-i} - m) + a_t + sum ma_j a_{t-j}: what others write as -theta is ma.
    The table goes to stdout, the model to -o. Likelihood and criteria are exact for every method.
    """
    one_thread()
    from thermaltool.cli.messages import warn
    from thermaltool.cli.options import keep_inputs
    from thermaltool.cli.series import load_series, place_of, screened_series
    from thermaltool.documents import atomic_output, write_json
    from thermaltool.errors import FitError
    from thermaltool.report.orders import fit_table, fit_warnings
    from thermaltool.timeseries.fit import fit_arma
    from thermaltool.timeseries.model import dumps, to_document
    from thermaltool.timeseries.order import select_order
    from thermaltool.timeseries.runs import difference

    if output is not None:
        keep_inputs(output, log)
    series, period = load_series(log, options)
    record, degree, differences = screened_series(series, options)
    place, changed, begin = place_of(record), difference(record, differences), None
    try:
        if order is None:
            largest = 0 if method in METHODS[1:4] else 10
            table = select_order(changed, 10, largest, degree, ("bic",))
            best = table.best("bic")
            order, begin = (best.p, best.q), table.fits[best.p, best.q]
            warn(f"{place}: order {best.p},{best.q} chosen by BIC")
        model = fit_arma(
            record,
            *order,
            method=method,
            degree=degree,
            difference=differences,
            period_s=period,
            long_order=long_order,
            correct=regressions == "3",
            begin=begin,
            provenance={
                "logs": [{"name": record.name, "sha256": record.digest}],
                "command": "thermaltool " + " ".join(sys.argv[1:]),
            },
        )
    except FitError as error:
        raise FitError(f"{place}: {error}") from error
    for message in fit_warnings(model, changed, degree):
        warn(f"{place}: {message}")
    if output is not None:
        with atomic_output(output) as stream:
            stream.write(dumps(model).encode())
    if as_json:
        write_json(to_document(model), "-")
    elif output != "-":
        click.echo(fit_table(model, level))
