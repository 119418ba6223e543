"""``thermaltool check``: what is in a log and what is wrong with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, warn
from thermaltool.cli.types import DURATION

# Columns that are left out are named, so many at most.
MAX_NAMED = 12


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
    type=DURATION,
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
    if output:
        shared.keep_inputs(output, log, *filter(None, (options["columns"], map_file)))
    if map_file is not None:
        if options["columns"] is not None or log == "-":
            raise click.UsageError("--write-map takes a file, and no --columns")
        shared.keep_inputs(map_file, log)
        draft = draft_map(log, options["from_format"])
        write_whole(draft.text.encode(), map_file)
        options["columns"] = map_file
        if draft.left_out:
            warn(f"{map_file} leaves out {_first_of(draft.left_out)}: to read one, give it a name "
                 "<quantity>_<place>_<unit> there")  # fmt: skip
    result = api.check(log, **options)
    report = to_json(result.document(), indent=2).rstrip() if as_json else result.table()
    click.echo(report, err=output == "-")
    if output:
        table = on_even_clock(result.log, resample) if resample else result.log
        write_table({"time_s": table.time, **table.columns}, output, to_format)
    if not result.passed:
        ctx.exit(DID_NOT_PASS)


def _first_of(several: Sequence[str]) -> str:
    more = len(several) - MAX_NAMED
    return ", ".join(several[:MAX_NAMED]) + (f" and {more} more" if more > 0 else "")
