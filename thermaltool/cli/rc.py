"""``thermaltool rc``: declared networks of heat capacities fitted to measured logs."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import PROPER_SHARE, InputPath
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool rc run.csv --network one.toml --network two.toml -o model.json"
)
@shared.logs_argument
@click.option("--network", "networks", type=click.Path(exists=True, dir_okay=False),
              multiple=True, required=True, metavar="NET.toml",
              help="Nodes, links, heat and sensors; repeatable: nested networks are "
              "tested against each other.")  # fmt: skip
@click.option("--initial", type=click.Choice(["free", "rest"]), default="free",
              help="State at the first row: unknown, or settled without heat, as simulate "
              "takes it.")  # fmt: skip
@click.option("--split", type=PROPER_SHARE,
              metavar="SHARE", help="Fit on this first share of the rows, validate on the "
              "rest.")  # fmt: skip
@click.option("--validate", type=InputPath(), metavar="LOG",
              help="Validate on another log.")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("-o", "model_file", metavar="FILE", help="Model file of the sufficient network.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    networks: tuple[str, ...],
    model_file: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Grey box: networks of heat capacities [J/K] and conductances [W/K], from measured logs.

    Process noise of each node and noise of each sensor are estimated with them, by the likelihood
    of a Kalman filter on the log's own clock. Missing readings are left out one by one; a pause
    parts the record. Fits "simulated" are those of free runs of the model file from rest.
    """
    from thermaltool import api

    shared.check_files(model_file, *logs, options["validate"], as_json=as_json)
    if model_file is not None:
        shared.keep_inputs(model_file, *networks)
    progress = terminal_progress("rc")
    with shared.usage_errors():
        found = api.rc(logs, networks, warn=warn, **options)
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    if as_json:
        write_json(found.document(), "-")
    elif model_file != "-":
        click.echo(found.table())
    if model_file is not None:
        api.write_model(found, model_file, command_line())
    for message in found.notes if not quiet else ():
        warn(message)
