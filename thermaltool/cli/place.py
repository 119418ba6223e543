"""``thermaltool place``: which temperature sensors to keep, or where on a body they belong."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DURATION, POSITIVE

# Options that only logs take.
_OF_LOGS = ("time_constants", "static", "noise", "start", "stop", *shared.LOG_PARAMETERS)


@click.command(
    epilog="Example: thermaltool place day1.csv day2.csv --output d_z_um --sensors 4 "
    "--plot place.png, or thermaltool place column.toml --forbid foot"
)
@shared.logs_argument
@click.option("--output", "outputs", multiple=True, metavar="CHANNEL",
              help="Deflection that is to be predicted; repeatable.  [default of a body: all]"
)  # fmt: skip
@click.option("--candidate", "candidates", multiple=True, metavar="CHANNEL",
              help="Sensor that may be kept, or point of a body; repeatable.  [default: all "
              "temperatures; the nodes of a body's surface]")  # fmt: skip
@click.option("--sensors", type=click.IntRange(1), metavar="K",
              help="How many at most.  [default: 6, or as many as there are]")  # fmt: skip
@click.option("--criterion", type=click.Choice(["held-out", "I", "A", "D", "modes"]),
              help="What a regression misses of rows held out (of logs); what the noise of the "
              "sensors leaves unknown of the deflections (I) or of all temperatures (A), or what "
              "readings tell (D); extremes of the dominant modes near the heat (of a body).  "
              "[default: held-out; I of a body]")  # fmt: skip
@click.option("--time-constant", "time_constants", type=DURATION, multiple=True, metavar="S",
              help="Low-pass states beside each sensor [s]; repeatable.  [default: none, one or "
              "two, whichever predicts best]")  # fmt: skip
@click.option("--static", is_flag=True, help="No low-pass states.")
@click.option("--noise", type=click.Path(exists=True, dir_okay=False), metavar="FILE",
              help="Noise of each sensor from thermaltool noise, for I, A and D.  [default: white "
              "noise of the logs]")  # fmt: skip
@click.option("--reading-noise", type=POSITIVE, metavar="K",
              help="Of a body: standard deviation of a reading [K].  [default: 0.1]")  # fmt: skip
@click.option("--cost", "costs", multiple=True, metavar="CHANNEL=VALUE",
              help="What a sensor costs, where others cost 1, for I, A and D; of a body at a point "
              "or on a boundary; repeatable."
)  # fmt: skip
@click.option("--forbid", multiple=True, metavar="CHANNEL",
              help="Candidate that cannot be taken, and is not read; point or boundary of a body; "
              "repeatable.")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    outputs: tuple[str, ...],
    criterion: Any,
    reading_noise: float | None,
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
    selection and exchange (with --criterion among all sets, where these are few); each log is a
    duty cycle in which it has to do. The table says what is missed, and what the next sensor
    gains; and which candidates say the same.

    A body (one TOML file as for modes) in place of LOGS: where on it sensors belong, each of its
    heats switched at random, slowly and quickly.
    """
    from thermaltool import api
    from thermaltool.documents import write_json, write_whole
    from thermaltool.report.style import figure_format, render

    body = shared.is_body(logs, _OF_LOGS)
    taus = shared.low_pass_of(static, time_constants)
    shared.check_files(None, *logs)
    if plot is not None:
        for log in logs:
            shared.keep_inputs(plot, log)
        figure_format(plot)
    pairs = [shared.pair_of(each, "--cost") for each in costs]
    price = {name: shared.number_of(value, "--cost") for name, value in pairs}
    progress = terminal_progress("place")
    found: Any
    with shared.usage_errors():
        if body:
            own = {name: options[name] for name in ("candidates", "sensors", "forbid")}
            found = api.place_on_body(
                logs[0], outputs, criterion=criterion or "I", costs=price,
                reading_noise=reading_noise or 0.1, **own,
            )  # fmt: skip
        else:
            if not outputs:
                raise click.UsageError("logs need --output: which deflection is to be predicted?")
            if criterion == "modes" or reading_noise is not None:
                option = "--reading-noise" if reading_noise is not None else "--criterion modes"
                raise click.UsageError(f"{option} is of a body, one .toml file")
            found = api.place(logs, outputs, criterion=criterion or "held-out", costs=price,
                              time_constants=taus, warn=warn, **options)  # fmt: skip
    figure = None if plot is None else render(found.draw, figure_format(plot))
    progress("done\n")
    if as_json:
        write_json(found.document(), "-")
    else:
        click.echo(found.table())
    for note in found.notes if not quiet else ():
        warn(note)
    if plot is not None and figure is not None:
        write_whole(figure, plot)
