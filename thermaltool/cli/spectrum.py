"""``thermaltool spectrum``: time constants, Foster and Cauer networks of a thermal transient."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import NUMBER, SECONDS


@click.command(
    epilog="Example: thermaltool spectrum transient.csv --input P_die_W --output T_die_degC "
    "--plot spectrum.png --model model.json"
)
@shared.log_argument
@click.option("--input", required=True, metavar="CHANNEL",
              help="A power that steps once or several times, held between rows.")  # fmt: skip
@click.option("--output", "channel", required=True, metavar="CHANNEL",
              help="A temperature that follows, or a difference of two.")  # fmt: skip
@click.option("--lines", type=click.IntRange(1, 10), metavar="N",
              help="Number of time constants.  [default: by evidence]")  # fmt: skip
@click.option("--before", type=NUMBER, metavar="VALUE",
              help="Input before the first row, where the log begins with the step or behind it "
              "[unit of the input].  [default: that of the first row; with --step-at 0]",
              )  # fmt: skip
@click.option("--step-at", type=SECONDS, metavar="SECONDS",
              help="When the input changed to what the next row says [s].  [default: in that row]",
              )  # fmt: skip
@click.option("--reference", metavar="first|NUMBER",
              help="What counts as no power in the model file.  [default: 0]")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("-o", "table_file", metavar="FILE",
              help="Lines and both networks as a table; .json for all, with the smooth spectrum "
              "and the structure function.")  # fmt: skip
@click.option("--model", "model_file", metavar="FILE", help="Model file, for simulate and others.")
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.json_option
@shared.quiet_option
def command(
    log: str,
    input: str,
    channel: str,
    reference: str | None,
    table_file: str | None,
    model_file: str | None,
    plot: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Time-constant spectrum of a thermal transient, Foster and Cauer networks, in K/W and J/K.

    The step response of a junction or heater, heating or cooling, on any clock: a logarithmic one
    too. All has to be settled when the log begins. Neighbours that the log does not tell apart
    are one line; intervals (95 %) hold whatever lies between the lines. The number of lines is
    that of the least BIC.
    """
    from thermaltool import api
    from thermaltool.documents import write_json, write_whole
    from thermaltool.logs import write_table
    from thermaltool.report.style import figure_format, render

    kind = None if plot is None else figure_format(plot)
    rest = shared.reference_of(reference)
    for k, each in enumerate(files := [table_file, model_file, plot]):
        if each is not None and each in files[:k]:
            raise click.UsageError(f"{each}: two results cannot go to one file")
        shared.check_files(each, log)
    progress = terminal_progress("spectrum")
    found = api.spectrum(log, input, channel, reference=rest, **options, warn=warn)
    whole = table_file is not None and table_file.endswith(".json")
    document = found.document() if as_json or whole else {}
    figure = None if kind is None else render(found.draw, kind)
    progress("done\n")
    # The files last: where anything before them fails, the old ones stay.
    if as_json:
        write_json(document, "-")
    elif "-" not in (table_file, model_file):
        click.echo(found.table())
    if plot is not None and figure is not None:
        write_whole(figure, plot)
    if table_file is not None and whole:
        write_json(document, table_file)
    elif table_file is not None:
        write_table(found.columns, table_file)
    if model_file is not None:
        api.write_model(found, model_file, command_line())
    for message in found.notes if not quiet else ():
        warn(message)
