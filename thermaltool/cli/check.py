"""``thermaltool check``: what is in a log and what is wrong with it."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS
from thermaltool.cli.types import POSITIVE


@click.command(
    "check",
    epilog="Example: thermaltool plant frame --input step | thermaltool check --json - | jq .rows",
)
@shared.log_argument
@shared.table_options
@shared.json_option
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="Write the log under its mapped names, time in s; with -o - the report goes to stderr.",
)
@shared.to_option
@click.option(
    "--resample",
    type=POSITIVE,
    metavar="SECONDS",
    help="Put the log that -o writes on an even clock of this period [s]; gaps stay gaps.",
)
@click.option(
    "--write-map",
    "map_file",
    metavar="MAP.toml",
    help="Draft a column map from what the log looks like, and check the log with it.",
)
@click.pass_context
def command(
    ctx: click.Context,
    log: str,
    as_json: bool,
    output: str | None,
    to_format: str | None,
    resample: float | None,
    map_file: str | None,
    **options: Any,
) -> None:
    """What is in LOG (rows, clock, channels) and what is wrong with it, one line each.

    Exits with 3 when something is wrong. --write-map writes a map for a foreign log, with a comment
    on each guess: look at them, change what is wrong, and give the file to --columns.
    """
    from thermaltool import api
    from thermaltool.documents import to_json, write_whole
    from thermaltool.logs import draft_map, write_table
    from thermaltool.logs import resample as on_even_clock

    if resample and not output:
        raise click.UsageError("--resample needs -o: where to write the resampled log")
    if map_file is not None:
        if options["columns"] is not None or log == "-":
            raise click.UsageError("--write-map takes a file, and no --columns")
        shared.keep_inputs(map_file, log)
        write_whole(draft_map(log, options["from_format"]).encode(), map_file)
        options["columns"] = map_file
    result = api.check(log, **options)
    report = to_json(result.document(), indent=2).rstrip() if as_json else result.table()
    click.echo(report, err=output == "-")
    if output:
        table = on_even_clock(result.log, resample) if resample else result.log
        write_table({"time_s": table.time, **table.columns}, output, to_format)
    if not result.passed:
        ctx.exit(DID_NOT_PASS)
