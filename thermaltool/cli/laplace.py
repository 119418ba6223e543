"""``thermaltool laplace``: invert an expression of s numerically."""

from __future__ import annotations

import json
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, warn
from thermaltool.cli.types import (
    DURATION,
    NOT_NEGATIVE,
    POSITIVE,
    Abscissa,
    Assignment,
    InputPath,
    TimeGrid,
)
from thermaltool.documents import write_whole

METHODS = ("auto", "hyperbola", "talbot", "euler", "dehoog", "stehfest")


@click.command(
    epilog="Example: thermaltool laplace 'exp(-r*sqrt(s/a))/s' -p r=0.1 -p a=1.2e-5 "
    "--times 1:1e4:200:log | thermaltool plot -"
)
@click.argument("expression")
@click.argument("file", type=InputPath(), required=False)
@click.option("--times", "grid", type=TimeGrid(), metavar="START:STOP:COUNT[:log]",
              help="Grid of times [s]; log for geometric.")  # fmt: skip
@click.option("--time", "single", type=DURATION, metavar="SECONDS", multiple=True,
              help="One time [s]; repeatable.")  # fmt: skip
@click.option("--method", type=click.Choice(METHODS), default="auto",
              help="auto: hyperbola, and dehoog where its error is above --tol.")  # fmt: skip
@click.option("--tol", type=POSITIVE, metavar="ERROR", default=1e-9,
              help="Absolute error wanted [unit of the result].")  # fmt: skip
@click.option("--rtol", type=NOT_NEGATIVE, metavar="PART", default=1e-9,
              help="The same, as a part of the largest result up to that time.")  # fmt: skip
@click.option("--abscissa", type=Abscissa(), metavar="RATE|auto", default="auto",
              help="Largest real part of the singularities [1/s]; auto finds it.")  # fmt: skip
@click.option("-p", "--parameter", type=Assignment(), multiple=True, help="Value of a name.")
@shared.json_option
@shared.output_option
@shared.to_option
@click.pass_context
def command(
    ctx: click.Context,
    expression: str,
    file: str | None,
    grid: tuple[float, float, int, bool] | None,
    single: tuple[float, ...],
    parameter: tuple[tuple[str, float], ...],
    as_json: bool,
    output: str,
    to_format: str | None,
    **options: Any,
) -> None:
    """Invert an EXPRESSION of s numerically, with an error estimate.

    Times come from --times, --time and the clock of FILE (a log, - for stdin; read by default
    where neither option is given). EXPRESSION: numbers, s, names given with -p, pi, e, + - * / **
    and sqrt exp log sin cos tan sinh cosh tanh j0 j1 i0 i1 k0 k1 jv iv kv erf erfc erfcx gamma;
    i0e(z) = exp(-z)*i0(z) and k0e(z) = exp(z)*k0(z) do not overflow.

    Writes time_s, value_1, error_1 (estimated absolute error). Where the error exceeds both
    --tol and --rtol the result is written all the same, a warning names the worst time, and the
    exit code is 3.
    """
    from thermaltool import api
    from thermaltool.laplace.expression import ExpressionError
    from thermaltool.logs import write_table

    times = _times(ctx, file, grid, single)
    try:
        result = api.invert_laplace(expression, times, parameters=dict(parameter), **options)
    except ExpressionError as error:
        raise click.BadParameter(str(error), param_hint="EXPRESSION") from error
    if as_json:
        text = json.dumps(result.document(), allow_nan=False)
        write_whole(f"{text}\n".encode(), output)
    else:
        write_table(result.columns, output, to_format)
    if message := result.warning():
        warn(f"thermaltool laplace: warning: {message}")
        ctx.exit(DID_NOT_PASS)


def _times(
    ctx: click.Context,
    file: str | None,
    grid: tuple[float, float, int, bool] | None,
    single: tuple[float, ...],
) -> Any:
    """All times asked for [s], in the order of options, then file."""
    import numpy as np

    from thermaltool.api import read_log
    from thermaltool.errors import LogError

    parts = [np.array(single, dtype=float)]
    if grid is not None:
        start, stop, count, is_log = grid
        parts.insert(0, (np.geomspace if is_log else np.linspace)(start, stop, count))
    elif not single and file is None:
        file = InputPath().convert("-", None, ctx)
    if file is not None:
        log = read_log(file)
        if (log.time <= 0).any():
            raise LogError("a time that is not above 0 s has no inverse", log.name, column="time_s")
        parts.append(log.time)
    return np.concatenate(parts)
