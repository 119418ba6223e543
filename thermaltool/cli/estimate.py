"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

from dataclasses import replace

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import warn, warn_excursion, warn_excursions, warn_pauses, warn_row
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
from thermaltool.errors import LogError
from thermaltool.report.text import aligned


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
    columns: str | None,
    from_format: str | None,
    nan_policy: str,
    max_gap: float | None,
    output: str,
    to_format: str | None,
    initial: str,
    as_json: bool,
    quiet: int,
) -> None:
    """Heat and deflection from measured temperatures.

    The numbers are those that thermaltool compensate gives line by line, the effects of the model
    included: readings are put right, what a column tells of other sources is added. Where the log
    holds the true heat or deflection too, the error is judged on stderr: band is its largest minus
    its smallest value, steady its mean over the last tenth.
    """
    import numpy as np

    from thermaltool.estimation.pipeline import EstimatorPipeline
    from thermaltool.logs import read_log, write_table
    from thermaltool.model import NOT_AT_REST, away_from_rest, extrapolated, relative
    from thermaltool.signals.agreement import agreement

    one_stdin(model, log)
    keep_inputs(output, model, log)
    document = read_model(model)
    pipeline = EstimatorPipeline.of(document)
    data = read_log(log, columns=columns, from_format=from_format, nan_policy=nan_policy,
                    max_gap=max_gap, need=pipeline.columns)  # fmt: skip
    truths = pipeline.true_values({name: data.column(name) for name in pipeline.columns})
    settled = initial == "settled"
    rests = {o.channel: o.offset for o in document.outputs}
    behind = dict(data.columns)
    # Sensors come first; of a scheduled drive the estimator takes more than its one column.
    for name, inlet, truth in zip(
        pipeline.estimator.sensors, pipeline.input_columns, truths.T, strict=False
    ):
        if len(none := np.flatnonzero(np.isnan(truth))):
            raise LogError(f"no truth gives this reading ({len(none)} rows)", data.name,
                           int(data.lines[none[0]]), inlet.column)  # fmt: skip
        if inlet.sensor and inlet.calibrated is not None:
            behind[name] = truth + (0.0 if rests[name] == "first" else rests[name])
            if not settled and len(truth) and away_from_rest(truth[0], inlet.calibrated):
                warn_row(data, 0, f"{inlet.column}: {truth[0]:.4g} at the start {NOT_AT_REST}")
    warn_excursions(document, replace(data, columns=behind))
    estimated = any(inlet.sensor for inlet in pipeline.input_columns)
    over = "the heat is taken to wander on" if estimated else "the drives are held or run on"
    warn_pauses(data, f"{over} over it")
    estimates = pipeline.run(data.time, truths, settled)
    result = {"time_s": data.time}
    result |= dict(zip(pipeline.estimator.estimates, estimates.T, strict=True))
    for e in extrapolated(document, result):
        warn_excursion(data, e)
    references = {d.channel: d.reference for d in document.drives} | rests
    report = {
        # What counts from its first value is compared from the first row on.
        name: agreement(
            relative(data.columns[name], references[name]),
            values - values[:1] if references[name] == "first" else values,
        )
        for name, values in list(result.items())[1:]
        if name in data.columns and len(data)
    }
    if output != "-" or not as_json:
        write_table(result, output, to_format)
    if as_json:
        write_json({name: each.document() for name, each in report.items()}, "-")
    elif not quiet and report:
        rows = [["estimate", "band", "steady", "rmse", "max", "rows"]]
        for name, a in report.items():
            rows.append([name, f"{a.band:.4g}", f"{a.steady:.3g}", f"{a.rmse:.4g}",
                         f"{a.max_error:.4g}", str(a.rows)])  # fmt: skip
        warn(aligned(rows))
