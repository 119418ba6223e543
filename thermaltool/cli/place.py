"""``thermaltool place``: which temperature sensors to keep."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.types import POSITIVE


@click.command(
    epilog="Example: thermaltool place day1.csv day2.csv --output d_z_um --sensors 4 "
    "--plot place.png"
)
@shared.logs_argument
@click.option("--output", "outputs", multiple=True, required=True, metavar="CHANNEL",
              help="Deflection that is to be predicted; repeatable.")  # fmt: skip
@click.option("--candidate", "candidates", multiple=True, metavar="CHANNEL",
              help="Sensor that may be kept; repeatable.  [default: all temperatures]"
)  # fmt: skip
@click.option("--sensors", type=click.IntRange(1), metavar="K",
              help="How many at most.  [default: 6, or as many as there are]")  # fmt: skip
@click.option("--criterion", type=click.Choice(["held-out", "I", "A", "D"]), default="held-out",
              help="What a regression misses of rows held out; or what the noise of the sensors "
              "leaves unknown of the deflections (I) or of all temperatures (A), or what readings "
              "tell (D).")  # fmt: skip
@click.option("--time-constant", "time_constants", type=POSITIVE, multiple=True, metavar="S",
              help="Low-pass states beside each sensor [s]; repeatable.  [default: none, one or "
              "two, whichever predicts best]")  # fmt: skip
@click.option("--static", is_flag=True, help="No low-pass states.")
@click.option("--noise", type=click.Path(exists=True, dir_okay=False), metavar="FILE",
              help="Noise of each sensor from thermaltool noise, for I, A and D.  [default: white "
              "noise of the logs]")  # fmt: skip
@click.option("--cost", "costs", multiple=True, metavar="CHANNEL=VALUE",
              help="What a sensor costs, where others cost 1, for I, A and D; repeatable."
)  # fmt: skip
@click.option("--forbid", multiple=True, metavar="CHANNEL",
              help="Candidate that cannot be taken, and is not read; repeatable.")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    outputs: tuple[str, ...],
    time_constants: tuple[float, ...],
    static: bool,
    costs: tuple[str, ...],
    plot: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Which temperature sensors to keep, by LOGS in which all of them were read.

    For 1, 2, 3 … sensors the set that predicts the deflections best is searched, by forward
    selection and exchange; each log is a duty cycle in which it has to do. The table says what is
    missed, and what the next sensor gains; and which candidates say the same.
    """
    shared.one_thread()
    from thermaltool import api
    from thermaltool.documents import write_json, write_whole
    from thermaltool.report.style import figure_format, render

    taus = shared.low_pass_of(static, time_constants)
    shared.check_files(None, *logs)
    if plot is not None:
        for log in logs:
            shared.keep_inputs(plot, log)
        figure_format(plot)
    pairs = [shared.pair_of(each, "--cost") for each in costs]
    price = {name: shared.number_of(value, "--cost") for name, value in pairs}
    with shared.usage_errors():
        found = api.place(logs, outputs, costs=price, time_constants=taus, warn=warn, **options)
    figure = None if plot is None else render(found.draw, figure_format(plot))
    if as_json:
        write_json(found.document(), "-")
    else:
        click.echo(found.table())
    for note in found.notes if not quiet else ():
        warn(note)
    if plot is not None and figure is not None:
        write_whole(figure, plot)
