"""``thermaltool simulate``: a model's outputs for the drives in a log."""

from __future__ import annotations

import sys

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import warn, warn_excursions, warn_pauses
from thermaltool.cli.options import (
    NUMBER,
    Source,
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
from thermaltool.record import Record
from thermaltool.report.text import aligned


@click.command(
    epilog="Example: thermaltool plant frame --input duty | thermaltool simulate model.json - -q"
)
@model_argument
@click.argument("log", type=Source(), default="-")
@click.option("--start", type=NUMBER, metavar="SECONDS", help="Judge from this time on [s].")
@click.option("--stop", type=NUMBER, metavar="SECONDS", help="Judge up to this time [s].")
@click.option(
    "--max-rmse",
    type=NUMBER,
    metavar="VALUE",
    help="Exit 3 when an output's RMSE is above this [unit of the output].",
)
@log_options
@output_option
@to_option
@json_option
@quiet_option
def command(
    model: str,
    log: str,
    start: float | None,
    stop: float | None,
    max_rmse: float | None,
    columns: str | None,
    from_format: str | None,
    nan_policy: str,
    max_gap: float | None,
    output: str,
    to_format: str | None,
    as_json: bool,
    quiet: int,
) -> None:
    """Outputs of a model for the drives in a log.

    Where the log holds the measured output too, a column residual_... (measured minus simulated)
    is written beside it, and RMSE and fit go to stderr. The machine is taken to be at rest at the
    first row; --start and --stop choose the rows that are judged, all rows drive the model.
    """
    import numpy as np

    from thermaltool.errors import LogError
    from thermaltool.logs import read_log, write_table
    from thermaltool.model import relative
    from thermaltool.signals.agreement import agreement

    one_stdin(model, log)
    keep_inputs(output, model, log)
    document = read_model(model)
    need = document.needs()
    data = read_log(log, columns=columns, from_format=from_format, nan_policy=nan_policy,
                    max_gap=max_gap, need=need)  # fmt: skip
    warn_excursions(document, data)
    warn_pauses(data, "the drive is taken as held over it")
    inputs = {name: data.column(name) for name in need}
    simulated = document.simulate(Record(data.time, inputs, digest=data.digest))
    result, report = {"time_s": data.time}, {}
    low, high = (-np.inf if start is None else start), (np.inf if stop is None else stop)
    judged = (data.time >= low) & (data.time <= high)
    for out in document.outputs:
        level = simulated[out.channel]
        result[out.channel] = level if out.offset == "first" else level + out.offset
        if out.channel in data.columns:
            measured = relative(data.columns[out.channel], out.offset)
            result[f"residual_{out.channel}"] = measured - level
            report[out.channel] = agreement(measured[judged], level[judged])
    if output != "-" or not as_json:
        write_table(result, output, to_format)
    if as_json:
        write_json({name: each.document() for name, each in report.items()}, "-")
    elif not quiet and report:
        rows = [["output", "rmse", "fit %", "max", "mean", "rows"]]
        for name, a in report.items():
            rows.append([name, f"{a.rmse:.4g}", f"{a.fit_percent:.2f}", f"{a.max_error:.4g}",
                         f"{a.mean:.3g}", str(a.rows)])  # fmt: skip
        warn(aligned(rows))
    if max_rmse is not None:
        if not any(a.rows for a in report.values()):
            raise LogError("--max-rmse: no measured output to judge", data.name)
        if any(a.rmse > max_rmse for a in report.values()):
            sys.exit(3)
