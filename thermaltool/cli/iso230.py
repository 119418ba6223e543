"""``thermaltool iso230``: thermal tests of machine tools by ISO 230-3."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DURATION


@click.command(
    epilog="Example: thermaltool iso230 spindle.csv --probe d_x1_um=X:50mm "
    "--probe d_x2_um=X:150mm --noise noise.json --plot spindle.png"
)
@shared.log_argument
@shared.table_options
@click.option("--test", type=click.Choice(["etve", "spindle", "axis"]),
              help="Environmental temperature variation, rotating spindle, or moving axis.  "
              "[default: spindle where the log has a speed, else etve]")  # fmt: skip
@click.option("--probe", "probes", multiple=True, metavar="CHANNEL=AXIS[:DISTANCE]",
              help="Axis of a displacement, and where its probe is: from the spindle nose, of an "
              "axis along it (X:50mm). Two along one axis give a tilt or an expansion.  [default: "
              "d_x..., d_y..., d_z...]")  # fmt: skip
@click.option("--speed", metavar="CHANNEL",
              help="Each of its speeds is a run.  [default: the only speed in the log]"
)  # fmt: skip
@click.option("--noise", type=click.Path(exists=True, dir_okay=False), metavar="FILE",
              help="Noise and drift of the probes from thermaltool noise, for the intervals."
)  # fmt: skip
@click.option("--average", type=DURATION, default=60.0, metavar="S",
              help="Readings are averaged over so long [s].")  # fmt: skip
@shared.span_options("Evaluate from", "Evaluate up to")
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.json_option
@shared.quiet_option
def command(
    log: str, probes: tuple[str, ...], plot: str | None, as_json: bool, quiet: int, **options: Any
) -> None:
    """Thermal tests of ISO 230-3 from LOG: ranges over the prescribed times, with intervals.

    Of each probe, and of each tilt between two of them, the range: with a rotating spindle or a
    moving axis over the first 15 min, the first 60 min and the whole run, one run for each speed;
    of the environment over all, and the largest within one hour and one day. Noise widens a range,
    which is taken off; 95 % intervals hold noise, and with --noise the drift of the probes.
    """
    from thermaltool import api
    from thermaltool.documents import to_json, write_whole
    from thermaltool.report.style import figure_format, render

    if plot is not None:
        shared.keep_inputs(plot, log)
        figure_format(plot)
    pairs = [shared.pair_of(each, "--probe") for each in probes]
    if len(dict(pairs)) < len(pairs):
        raise click.UsageError("--probe: a channel is there twice")
    progress = terminal_progress("iso230")
    with shared.usage_errors():
        result = api.iso230(log, probes=dict(pairs), warn=warn, **options)
    figure = None if plot is None else render(result.draw, figure_format(plot))
    progress("done\n")
    click.echo(to_json(result.document(), indent=2).rstrip() if as_json else result.table())
    for note in result.notes:
        if not quiet:
            warn(f"thermaltool iso230: {note}")
    if plot is not None and figure is not None:
        write_whole(figure, plot)
