"""``thermaltool superpose``: the sum of several models."""

from __future__ import annotations

import click

from thermaltool.cli.options import Source, output_option


@click.command(
    epilog="Example: thermaltool superpose causal.json stabilization.json | "
    "thermaltool simulate - run.csv"
)
@click.argument("models", type=Source(), nargs=-1, required=True)
@output_option
def command(models: tuple[str, ...], output: str) -> None:
    """The sum of several MODELS: one for each heat source, found in a run of its own.

    An output that several models have is the sum of all terms, as linear errors are of the
    temperatures near their sources. What adds up is what it does above rest: where the models have
    its rest as a number, the sum rests at their mean. One drive on one output in two models is
    refused: it would count twice. So is a drive with a curve in one model and another, or none, in
    the next: superpose first, correct then.
    """
    from thermaltool.cli.documents import write_combined
    from thermaltool.model.combine import superposed

    write_combined(superposed, models, output)
