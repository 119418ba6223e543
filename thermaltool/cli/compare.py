"""``thermaltool compare``: models side by side on a log."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import InputPath
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool check run.csv -o - | thermaltool compare lag.json model.json - "
    "--plot compare.png"
)
@click.argument("models", type=InputPath(), nargs=-1, required=True, metavar="MODEL...")
@click.argument("log", type=InputPath())
@shared.start_state_option
@shared.span_options("Judge from", "Judge up to")
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf: measured, each model, "
              "residuals.")  # fmt: skip
@shared.log_options
@shared.json_option
@shared.quiet_option
def command(
    models: tuple[str, ...],
    log: str,
    plot: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Models side by side on a LOG: errors of each, one figure.

    Every MODEL is run as ``simulate`` runs it, and its figures are those that ``simulate`` prints:
    RMSE as simulate counts from the first rows, RMSE with its mean taken off ("zero free"), fit in
    per cent. Outputs that all models have and that the log measures are compared.
    """
    from thermaltool import api
    from thermaltool.report.style import figure_format, write_figure

    shared.check_files(plot, *models, log)
    if plot is not None:
        figure_format(plot)
    progress = terminal_progress("compare")
    result = api.compare(models, log, **options, warn=warn)
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    if as_json:
        write_json(result.document(), "-")
    else:
        click.echo(result.table())
    for sentence in result.notes if not quiet else ():
        warn(sentence)
    if plot is not None:
        write_figure(result.draw, plot)
