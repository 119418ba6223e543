"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.types import POSITIVE, RateType
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
@click.option("--smooth", is_flag=True,
              help="Each estimate rests on the whole log, later readings included.")  # fmt: skip
@click.option("--lag", type=POSITIVE, metavar="SECONDS",
              help="Each estimate rests on the readings up to so long after it [s].")  # fmt: skip
@click.option("--walk", type=RateType(),
              help="How fast the heat changes: as this log tells it, as the design has it, or a "
              "rate [share of the level per √s].  [default: likelihood with --smooth, else design]"
)  # fmt: skip
@click.option("--bands", is_flag=True,
              help="Add a column sigma_... for each: its standard error.")  # fmt: skip
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

    --smooth and --lag look back: at a moment's estimate when later readings are there. They take
    the Kalman form (regularize --form kalman). With --smooth and --nan-policy hold a reading that
    is missing counts as none.
    """
    from thermaltool import api
    from thermaltool.logs import write_table

    if options["smooth"] and options["lag"] is not None:
        raise click.UsageError("--smooth and --lag are two: --smooth takes all later readings")
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
