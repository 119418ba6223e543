"""``thermaltool superpose``: the sum of several models."""

from __future__ import annotations

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import command_line
from thermaltool.cli.types import InputPath


@click.command(
    epilog="Example: thermaltool superpose causal.json stabilization.json | "
    "thermaltool simulate - run.csv"
)
@click.argument("models", type=InputPath(), nargs=-1, required=True)
@shared.output_option
def command(models: tuple[str, ...], output: str) -> None:
    """The sum of several MODELS: one for each heat source, found in a run of its own.

    An output that several models have is the sum of all terms, as linear errors are of the
    temperatures near their sources. What adds up is what it does above rest: where the models have
    its rest as a number, the sum rests at their mean. One drive on one output in two models is
    refused: it would count twice. So is a drive with a curve in one model and another, or none, in
    the next: superpose first, correct then.
    """
    from thermaltool.api.inputs import read_model, write_model
    from thermaltool.documents import source_name
    from thermaltool.model.combine import superposed

    shared.check_files(output, *models)
    parts, names = [read_model(path) for path in models], [source_name(path) for path in models]
    write_model(superposed(parts, names), output, command_line())
