"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import warn, warn_excursion, warn_pauses, warn_row
from thermaltool.cli.options import (
    Source,
    initial_option,
    json_option,
    keep_inputs,
    log_options,
    model_argument,
    one_stdin,
    output_option,
    quiet_option,
    to_option,
)
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool plant frame --input duty | thermaltool estimate model.json - -q"
)
@model_argument
@click.argument("log", type=Source(), default="-")
@log_options
@output_option
@to_option
@initial_option
@json_option
@quiet_option
def command(
    model: str,
    log: str,
    output: str,
    to_format: str | None,
    initial: str,
    as_json: bool,
    quiet: int,
    **reading: Any,
) -> None:
    """Heat and deflection from measured temperatures.

    The numbers are those that thermaltool compensate gives line by line, the effects of the model
    included: readings are put right, what a column tells of other sources is added. Where the log
    holds the true heat or deflection too, the error is judged on stderr: band is its largest minus
    its smallest value, steady its mean over the last tenth.
    """
    from thermaltool.estimation.batch import estimate
    from thermaltool.estimation.pipeline import EstimatorPipeline
    from thermaltool.logs import read_log, write_table
    from thermaltool.model import NOT_AT_REST
    from thermaltool.report.simulation import estimate_table

    one_stdin(model, log)
    keep_inputs(output, model, log)
    document = read_model(model)
    pipeline = EstimatorPipeline.of(document)
    data = read_log(log, **reading, need=pipeline.columns)
    found = estimate(document, pipeline, data, initial == "settled")
    for column, value in found.not_at_rest.items():
        warn_row(data, 0, f"{column}: {value:.4g} at the start {NOT_AT_REST}")
    for excursion in found.excursions:
        warn_excursion(data, excursion)
    over = (
        "the heat is taken to wander on"
        if pipeline.estimates_drives
        else "the drives are held or run on"
    )
    warn_pauses(data, f"{over} over it")
    for excursion in found.extrapolated:
        warn_excursion(data, excursion)
    if output != "-" or not as_json:
        write_table(found.columns(), output, to_format)
    if as_json:
        write_json({name: each.document() for name, each in found.agreement.items()}, "-")
    elif not quiet and found.agreement:
        warn(estimate_table(found.agreement))
