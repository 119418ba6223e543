"""``thermaltool simulate``: a model's outputs for the drives in a log."""

from __future__ import annotations

import sys
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool plant frame --input duty | thermaltool simulate model.json - -q"
)
@shared.model_argument
@shared.log_argument
@shared.start_state_option
@shared.span_options("Judge from", "Judge up to")
@shared.rmse_option
@shared.log_options
@shared.output_option
@shared.to_option
@shared.json_option
@shared.quiet_option
def command(
    model: str,
    log: str,
    max_rmse: float | None,
    output: str,
    to_format: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Outputs of a model for the drives in a log.

    Where the log holds the measured output too, a column residual_... (measured minus simulated)
    is written beside it, and RMSE and fit go to stderr. The machine is taken to be at rest at the
    first row, unless most of what the model leaves is a start that decays, or its calibration did
    not begin at rest: the state is then estimated from the rows before --start, and a line says so.
    A displacement has no zero of its own: it counts from the median of measured minus simulated
    over the first rows, or with the state from what fits best, and "zero free" is the RMSE about
    the mean error. --start and --stop choose the rows that are judged, all rows drive the model.
    """
    from thermaltool import api
    from thermaltool.errors import LogError
    from thermaltool.logs import write_table

    shared.check_files(output, model, log)
    progress = terminal_progress("simulate")
    result = api.simulate(api.read_model(model), log, **options, warn=warn)
    progress("done\n")
    if max_rmse is not None and not result.judged:
        raise LogError("--max-rmse: no measured output to judge", result.log.name)
    # The file last: where anything before it fails, the old one stays.
    words = (result.table(), *result.notes) if result.agreements else ()
    if as_json:
        write_json(result.document(), "-")
    if output != "-" or not as_json:
        write_table(result.columns, output, to_format)
    for sentence in words if not as_json and not quiet else ():
        warn(sentence)
    if max_rmse is not None and result.exceeds(max_rmse):
        sys.exit(DID_NOT_PASS)
