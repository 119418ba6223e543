"""``thermaltool noise``: what each channel's noise is made of."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import SECONDS


@click.command(epilog="Example: thermaltool noise idle.csv -o noise.json --plot noise.png")
@shared.log_argument
@shared.table_options
@click.option(
    "--channel", "channels", multiple=True, metavar="NAME", help="Only this one; repeat for more."
)
@click.option(
    "--start", type=SECONDS, metavar="SECONDS", help="Take the log from this time on as idle [s]."
)
@click.option(
    "--stop", type=SECONDS, metavar="SECONDS", help="Take it as idle up to this time [s]."
)
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.output_option
@shared.json_option
def command(
    log: str,
    plot: str | None,
    output: str,
    as_json: bool,
    **options: Any,
) -> None:
    """Noise of every channel: resolution, white, drift, lines, outliers.

    White level and drift come from the longest stretch on which a channel stays level; --start and
    --stop name a stretch without signal instead. Where there is none, the drift is an upper bound.
    Missing readings are left out. -o takes the JSON for the next stage, stdout a table.
    """
    from thermaltool import api
    from thermaltool.documents import write_whole
    from thermaltool.report.noise import to_json
    from thermaltool.report.style import figure_format, render

    if plot is not None:
        figure_format(plot)
    shared.check_files(output, log)
    progress = terminal_progress("noise")
    result = api.noise(log, **options, warn=warn, progress=progress)
    document = to_json(result.document())
    # The files last: where anything before them fails, the old ones stay.
    figure = None if plot is None else render(result.draw, figure_format(plot))
    progress("done\n")
    if as_json:
        write_whole(document, "-")
    else:
        click.echo(result.table())
    if plot is not None and figure is not None:
        write_whole(figure, plot)
    if output != "-":
        write_whole(document, output)
