"""``thermaltool regress``: thermal errors as sums of temperatures."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DURATION, InputPath


@click.command(
    epilog="Example: thermaltool regress day1.csv --output d_z_um --sensor T_a_degC "
    "--sensor T_b_degC --validate day2.csv -o model.json"
)
@shared.logs_argument
@click.option("--output", "outputs", multiple=True, required=True, metavar="CHANNEL",
              help="Thermal error; repeatable.")  # fmt: skip
@click.option("--sensor", "sensors", multiple=True, metavar="CHANNEL",
              help="Temperature that it is a sum of; repeatable.  [default: all temperatures]"
)  # fmt: skip
@click.option("--position", metavar="CHANNEL",
              help="Position along an axis: weights go with powers of it.")  # fmt: skip
@click.option("--degree", type=click.IntRange(0, 3), metavar="N",
              help="Highest power of the position, all terms kept.  [default: terms up to the "
              "second, chosen by the evidence]")  # fmt: skip
@click.option("--time-constant", "time_constants", type=DURATION, multiple=True, metavar="S",
              help="Low-pass states beside each sensor [s]; repeatable.  [default: none, one or "
              "two, whichever predicts best; none along an axis]")  # fmt: skip
@click.option("--static", is_flag=True, help="No low-pass states.")
@click.option("--method", default="ridge",
              type=click.Choice(["least-squares", "ridge", "elastic-net", "pcr", "pls"]),
              help="Of the model; the table has all.")  # fmt: skip
@click.option("--condition", metavar="CHANNEL",
              help="Its values (speeds) are left out one after the other.")  # fmt: skip
@click.option("--validate", type=InputPath(), multiple=True, metavar="LOG",
              help="A log that judges alone; repeatable.")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("-o", "model_file", metavar="FILE", help="Model file, for simulate and others.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    outputs: tuple[str, ...],
    time_constants: tuple[float, ...],
    static: bool,
    model_file: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Thermal errors as sums of temperatures from LOGS, and how far they hold elsewhere.

    Least squares, a ridge by the evidence, an elastic net, principal components and partial least
    squares, on the sensors as they are and with low-pass states of them, are judged by rows that
    they were not fitted to: blocks, the second half of every log (time), the warmest rows (level),
    each condition left out, each log by the others, and logs of --validate. Time constants and
    terms are chosen on all rows of LOGS, those that judge among them; logs of --validate have no
    part in it. The model file has the raw sensors as drives.
    """
    from thermaltool import api
    from thermaltool.documents import write_json

    taus = shared.low_pass_of(static, time_constants)
    shared.check_files(model_file, *logs, *options["validate"], as_json=as_json)
    progress = terminal_progress("regress")
    with shared.usage_errors():
        found = api.regress(logs, outputs, time_constants=taus, warn=warn, **options)
    progress("done\n")
    if model_file is not None:
        # What has no model file is said before anything is written.
        _ = found.model
    if as_json:
        write_json(found.document(), "-")
    elif model_file != "-":
        click.echo(found.table())
    if model_file is not None:
        api.write_model(found, model_file, command_line())
    for note in found.notes if not quiet else ():
        warn(note)
