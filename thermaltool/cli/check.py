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
@click.pass_context
def command(
    ctx: click.Context,
    log: str,
    as_json: bool,
    output: str | None,
    to_format: str | None,
    resample: float | None,
    **options: Any,
) -> None:
    """What is in LOG (rows, clock, channels) and what is wrong with it, one line each.

    Exits with 3 when something is wrong.
    """
    from thermaltool import api
    from thermaltool.documents import to_json
    from thermaltool.logs import resample as on_even_clock
    from thermaltool.logs import write_table

    if resample and not output:
        raise click.UsageError("--resample needs -o: where to write the resampled log")
    result = api.check(log, **options)
    report = to_json(result.document(), indent=2).rstrip() if as_json else result.table()
    click.echo(report, err=output == "-")
    if output:
        table = on_even_clock(result.log, resample) if resample else result.log
        write_table({"time_s": table.time, **table.columns}, output, to_format)
    if not result.passed:
        ctx.exit(DID_NOT_PASS)
