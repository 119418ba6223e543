"""``thermaltool schedule``: several models by level."""

from __future__ import annotations

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line
from thermaltool.cli.types import InputPath, Levels


@click.command(
    epilog="Example: thermaltool schedule at20.json at40.json at60.json --by Q_heater_W "
    "-o scheduled.json"
)
@click.argument("models", type=InputPath(), nargs=-1, required=True)
@click.option("--by", required=True, metavar="CHANNEL",
              help="What chooses: the drive, or another channel of the log.")  # fmt: skip
@click.option("--levels", type=Levels(),
              help="Size of the channel at which each model was found.  "
              "[default: the largest in its logs]")  # fmt: skip
@shared.output_option
def command(
    models: tuple[str, ...], by: str, levels: tuple[float, ...] | None, output: str
) -> None:
    """Several MODELS of the same drives and outputs by level, switched without a bump.

    Each response takes its share of the drive: all of it at its own level, falling straight to none
    at the neighbours'; beyond the ends the outermost one takes all. What a response has stored goes
    on decaying in its own way, so that no output jumps. Where the models have the rest of an output
    as a number, the schedule rests at their mean. The result simulates and streams as any
    other model, where the drive and the channel are measured.
    """
    from thermaltool.api.inputs import read_model, write_model
    from thermaltool.documents import source_name
    from thermaltool.model.combine import scheduled

    shared.check_files(output, *models)
    parts, names = [read_model(path) for path in models], [source_name(path) for path in models]
    write_model(scheduled(parts, by, levels, names), output, command_line())
