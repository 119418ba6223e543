"""``thermaltool plot``: a figure of any log or result."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import InputPath
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool estimate model.json log.csv -q | "
    "thermaltool plot - --against log.csv -o estimate.png"
)
@click.argument("files", type=InputPath(), nargs=-1, metavar="[FILE]...")
@click.option(
    "--against", type=InputPath(), metavar="LOG", help="What was measured: shows the error of FILE."
)
@click.option(
    "--channel", "channels", multiple=True, metavar="NAME", help="Only this one; repeat for more."
)
@shared.reading_options
@shared.nan_option
@shared.faults_option("keep")
@shared.output_option
@shared.json_option
@click.pass_context
def command(
    ctx: click.Context,
    files: tuple[str, ...],
    against: str | None,
    channels: tuple[str, ...],
    output: str,
    as_json: bool,
    **options: Any,
) -> None:
    """Figure of any log or result, PNG, SVG or PDF by the suffix of -o; stdout is PNG.

    FILE is recognized by its content: a log; a model (step and frequency response with 95 % bands,
    poles and zeros) or one of fit (spectrum, roots); a controller (a step held and not held, powers
    with their limits); what noise -o writes, what diagnose, order and
    regularize --json report; a table of invert, simulate, estimate, compensate, forecast or
    laplace. A model and a log show measured, simulated and residual with tests of its whiteness and
    independence, several models and a log what compare shows; a forecast and its log the history
    before it; a model beside a kernel or a trade-off names its parts. Stdin is a JSON document
    where it starts with {, else a log as --from says.
    """
    from thermaltool.api.inputs import refuse_unread
    from thermaltool.api.pauses import placed_in_pauses
    from thermaltool.cli.messages import warn
    from thermaltool.errors import LogError
    from thermaltool.logs import Log
    from thermaltool.report.content import Content, is_document, read_document, read_table
    from thermaltool.report.figure import draw
    from thermaltool.report.style import figure_format, write_figure

    if as_json and output == "-":
        raise click.UsageError("--json reports on stdout: give the figure a file with -o")
    if output == "-" and sys.stdout.isatty():
        raise click.UsageError("stdout is a terminal: name a figure with -o FIG.png, .svg or .pdf")
    if output != "-":
        figure_format(output)
    shared.keep_inputs(output, *files)
    sources = files or (InputPath().convert("-", None, ctx),)
    if [*sources, against].count("-") > 1:
        raise click.UsageError("stdin can be only one of the files")
    progress = terminal_progress("plot")
    documents = {name for name in sources if is_document(name, options["from_format"])}
    contents = [read_document(name) for name in sources if name in documents]
    need = [d.channel for c in contents if c.kind == "model" for d in c.data.drives]
    # With --against the map is that log's: what is judged was written under mapped names.
    own = options if against is None else {**options, "columns": None}
    contents += [read_table(n, own, need) for n in sources if n not in documents]
    if against is not None:
        reference = read_table(against, options)
        if not isinstance(reference.data, Log):
            raise LogError(f"--against takes a log (taken as: {reference.kind})", reference.name)
        contents.append(Content("reference", reference.name, reference.data))
    refuse_unread([each.data for each in contents if isinstance(each.data, Log)], (), warn)
    outputs = [o.channel for c in contents if c.kind == "model" for o in c.data.outputs]
    contents = [
        replace(c, data=placed_in_pauses(c.data, need, outputs, warn))
        if c.kind == "log" and need
        else c
        for c in contents
    ]
    write_figure(lambda: draw(contents, channels), output)
    progress("done\n")
    if as_json:
        drawn = [{"file": content.name, "kind": content.kind} for content in contents]
        write_json({"figure": output, "drawn": drawn}, "-")
