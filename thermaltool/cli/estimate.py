"""``thermaltool estimate``: heat and deflection from measured temperatures, whole log at once."""

from __future__ import annotations

import click

from thermaltool.cli.documents import (
    keep_inputs,
    one_stdin,
    read_model,
    table,
    warn,
    warn_excursion,
    warn_excursions,
    warn_pauses,
    warn_row,
    write_json,
)
from thermaltool.cli.options import (
    Source,
    initial_option,
    json_option,
    log_options,
    model_argument,
    output_option,
    quiet_option,
    to_option,
)


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

    The numbers are those that thermaltool compensate gives line by line. Where the log holds the
    true heat or deflection too, the error is judged on stderr: band is its largest minus its
    smallest value, steady its mean over the last tenth.
    """
    import numpy as np

    from thermaltool.inverse.estimator import load_estimator, run_estimator
    from thermaltool.logs import read_log, write_table
    from thermaltool.model import NOT_AT_REST, away_from_rest, extrapolated, relative
    from thermaltool.signals.agreement import agreement

    one_stdin(model, log)
    keep_inputs(output, model, log)
    document = read_model(model)
    estimator = load_estimator(dict(document.estimator_design()))
    data = read_log(log, columns=columns, from_format=from_format, nan_policy=nan_policy,
                    max_gap=max_gap, need=estimator.sensors)  # fmt: skip
    warn_excursions(document, data)
    warn_pauses(data, "the heat is taken to wander on over it")
    rests = {o.channel: o.offset for o in document.outputs}
    readings = np.column_stack(
        [relative(data.column(name), rests[name]) for name in estimator.sensors]
    )
    settled = initial == "settled"
    ranges = {o.channel: o.range for o in document.sensors}
    for name, reading in zip(estimator.sensors, readings[:1].ravel(), strict=len(data) > 0):
        if not settled and away_from_rest(reading, ranges[name]):
            warn_row(data, 0, f"{name}: {reading:.4g} at the start {NOT_AT_REST}")
    estimates = run_estimator(estimator, data.time, readings, settled)
    result = {"time_s": data.time}
    result |= dict(zip(estimator.estimates, estimates.T, strict=True))
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
        warn(table(rows))
