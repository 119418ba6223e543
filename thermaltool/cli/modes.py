"""``thermaltool modes``: thermal modes of a finite-element model, or of measured logs."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line, warn
from thermaltool.cli.progress import terminal_progress

# Options that only logs take.
_OF_LOGS = ("drives", "sensors", "initial", "start", "stop")


@click.command(
    epilog="Example: thermaltool modes rod.toml --plot modes.png, or "
    "thermaltool modes run.csv --drive n_spindle_rpm --sensor T_front_degC -o modes.json"
)
@shared.logs_argument
@click.option("--drive", "drives", multiple=True, metavar="CHANNEL",
              help="Of logs: what heats, a power, a speed, a temperature; repeatable.")  # fmt: skip
@click.option("--sensor", "sensors", multiple=True, metavar="CHANNEL",
              help="Of logs: a temperature or deflection that follows; repeatable.")  # fmt: skip
@click.option("--count", type=click.IntRange(1, 1000), metavar="N",
              help="Number of modes.  [default: of a body all of a small mesh, else 20; of logs by "
              "evidence, up to 6]")  # fmt: skip
@click.option("--initial", type=click.Choice(["auto", "rest", "free"]),
              help="Of logs: state at the first row, settled or unknown.  [default: auto]",
              )  # fmt: skip
@shared.span_options("Of logs: rows from", "Of logs: rows up to")
@shared.log_options
@click.option("-o", "document_file", metavar="FILE.json", help="All of it as JSON.")
@click.option("--model", "model_file", metavar="FILE",
              help="Of a body: model file of every heat into every point and deflection, for "
              "simulate and others.")  # fmt: skip
@click.option("--plot", metavar="FILE", help="Figure, .png, .svg or .pdf.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    count: int | None,
    document_file: str | None,
    model_file: str | None,
    plot: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Thermal modes: time constants, shapes, and the weight of each for every heat.

    A body is one TOML file: mesh (rod, block or a mesh file), materials, convection, heat, points
    and deflections. Logs take --drive and --sensor: time constants that all sensors share, from
    heating and cooling together, with intervals (95 %).
    """
    from thermaltool import api
    from thermaltool.documents import write_json, write_whole
    from thermaltool.report.style import figure_format, render

    body = shared.is_body(logs, (*_OF_LOGS, *shared.LOG_PARAMETERS))
    given = {name: options.pop(name) for name in _OF_LOGS}
    if not body and model_file is not None:
        raise click.UsageError(
            "--model is of a body: identify --structure network makes one of logs"
        )
    if not body and not (given["drives"] and given["sensors"]):
        raise click.UsageError("logs need --drive and --sensor (a body is one .toml file)")
    kind = None if plot is None else figure_format(plot)
    for k, each in enumerate(files := [document_file, model_file, plot]):
        if each is not None and each in files[:k]:
            raise click.UsageError(f"{each}: two results cannot go to one file")
        shared.check_files(each, *logs, as_json=as_json)
    progress = terminal_progress("modes")
    found: Any
    if body:
        found = api.thermal_modes(logs[0], count=count)
    else:
        drives, sensors = given.pop("drives"), given.pop("sensors")
        given["initial"] = given["initial"] or "auto"
        with shared.usage_errors():
            found = api.identify_modes(logs, drives, sensors, count=count, warn=warn, **given,
                                       **options)  # fmt: skip
    document = found.document() if as_json or document_file is not None else {}
    figure = None if kind is None else render(found.draw, kind)
    model = None if model_file is None else found.model
    progress("done\n")
    # The files last: where anything before them fails, the old ones stay.
    if as_json:
        write_json(document, "-")
    elif "-" not in (document_file, model_file):
        click.echo(found.table())
    if plot is not None and figure is not None:
        write_whole(figure, plot)
    if document_file is not None:
        write_json(document, document_file)
    if model_file is not None:
        api.write_model(model, model_file, command_line())
    notes = (*found.notes, *(found.model_notes if model is not None else ()))
    for message in notes if not quiet else ():
        warn(message)
