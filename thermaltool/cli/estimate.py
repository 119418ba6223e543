"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool plant frame --input duty | thermaltool estimate model.json - -q"
)
@shared.model_argument
@shared.log_argument
@shared.log_options
@shared.output_option
@shared.to_option
@shared.initial_option
@shared.json_option
@shared.quiet_option
def command(
    model: str,
    log: str,
    output: str,
    to_format: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Heat and deflection from measured temperatures.

    The numbers are those that thermaltool compensate gives line by line, the effects of the model
    included: readings are put right, what a column tells of other sources is added. Where the log
    holds the true heat or deflection too, the error is judged on stderr: band is its largest minus
    its smallest value, steady its mean over the last tenth.
    """
    from thermaltool import api
    from thermaltool.logs import write_table

    shared.check_files(output, model, log)
    result = api.estimate(model, log, **options, warn=warn)
    # The file last: where anything before it fails, the old one stays.
    table = result.table() if result.agreements else ""
    if as_json:
        write_json(result.document(), "-")
    if output != "-" or not as_json:
        write_table(result.columns, output, to_format)
    if table and not as_json and not quiet:
        warn(table)
