"""``thermaltool forecast``: forecasts of a fitted model, in batch or as a stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import streaming
from thermaltool.cli.options import (
    POSITIVE,
    log_argument,
    model_argument,
    output_option,
    quiet_option,
)
from thermaltool.cli.series import one_thread, outliers_option, series_options
from thermaltool.logs.formats import FORMATS

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.process import Process
    from thermaltool.timeseries.model import ArmaModel

# A log's period may differ from the model's by this share.
SAME_PERIOD = 0.05


@click.command(
    epilog="Example: logger | thermaltool forecast arma.json --stream --steps 10 > ahead.csv"
)
@model_argument
@log_argument
@series_options
@outliers_option
@click.option("--steps", type=click.IntRange(1, 1_000_000), default=1, help="Samples ahead.")
@click.option("--level", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=0.95,
              help="Of the intervals.")  # fmt: skip
@click.option("--stream", is_flag=True, help="Answer each line at once with the sample ahead.")
@click.option("--forgetting", type=click.FloatRange(0, 1, min_open=True), default=0.999,
              help="With --stream: weight of the past per sample; the model follows the signal."
)  # fmt: skip
@click.option("--timeout", type=POSITIVE, metavar="S",
              help="With --stream: a longer silence is told [s].")  # fmt: skip
@streaming.to_option
@output_option
@quiet_option
def command(model: str, log: str, stream: bool, output: str, quiet: int, **options: Any) -> None:
    """Forecasts of a fitted model with intervals, in batch or as a stream.

    In batch: the samples 1 to --steps beyond the end of the log, as time, forecast, low and high;
    samples that stand alone count as missing, as in ``fit``.
    With --stream each line of LOG is answered by the forecast of the sample --steps ahead, from a
    model that starts as fitted and learns on (recursive least squares); with --period LOG has no
    clock.
    """
    one_thread()
    from thermaltool.cli.options import keep_inputs, one_stdin
    from thermaltool.documents import read_text
    from thermaltool.timeseries.model import loads

    one_stdin(model, log)
    keep_inputs(output, model, log)
    fitted = loads(read_text(model), "<stdin>" if model == "-" else model)
    options["column"] = options["column"] or fitted.channel
    if stream:
        if output != "-":
            raise click.UsageError("--stream writes to stdout")
        if options["start"] is not None or options["stop"] is not None:
            raise click.UsageError("--start and --stop are for logs, not for --stream")
        _stream(fitted, log, quiet, options)
    elif options["to_format"] not in (None, *FORMATS):
        raise click.UsageError(f"--to {options['to_format']} goes with --stream")
    else:
        _batch(fitted, log, output, options)


def _batch(model: ArmaModel, log: str, output: str, options: dict[str, Any]) -> None:
    import numpy as np

    from thermaltool.cli.messages import warn
    from thermaltool.cli.series import load_series, place_of, warn_outliers
    from thermaltool.errors import LogError
    from thermaltool.logs import write_table
    from thermaltool.timeseries.forecast import forecast
    from thermaltool.timeseries.runs import runs, without
    from thermaltool.timeseries.screening import find_outliers

    record, period = load_series(log, options)
    if abs(period / model.period_s - 1.0) > SAME_PERIOD:
        raise LogError(
            f"the model has a period of {model.period_s:g} s, the log {period:g} s", record.name
        )
    if options["outliers"] == "omit":
        outliers = find_outliers(record)
        warn_outliers(record, outliers)
        record = without(record, outliers)
    behind = len(record) - runs(record)[-1].stop
    if behind:
        warn(f"{place_of(record)}: the last {behind} samples are missing: forecast")
    (channel,), steps = record.columns, options["steps"]
    ahead = forecast(model, record, behind + steps, options["level"])
    time = np.round(record.time[-1] + period * np.arange(1, steps + 1), 9)
    columns = {"time_s": time, f"forecast_{channel}": ahead.value[behind:],
               f"low_{channel}": ahead.low[behind:],
               f"high_{channel}": ahead.high[behind:]}  # fmt: skip
    write_table(columns, output, options["to_format"])


def _stream(model: ArmaModel, log: str, quiet: int, options: dict[str, Any]) -> None:
    from thermaltool.logs.formats import format_of
    from thermaltool.runtime.forecasts import GATE, Forecasts
    from thermaltool.timeseries.recursive.arma import RecursiveArma

    if model.difference or len(model.trend) > 1:
        raise click.UsageError("--stream takes models without --difference and linear trend")
    settings = streaming.settings_of(
        options,
        from_format=format_of(log, options["from_format"]),
        period=options["period"] or model.period_s,
        clock="count" if options["period"] else "column",
    )

    def process(messages: Messages) -> Process:
        orders = model.ar.size, model.ma.size
        arma = RecursiveArma(*orders, bool(model.trend), options["forgetting"], GATE)
        arma.begin(model, model.entry.size)
        steps, level = options["steps"], options["level"]
        return Forecasts(options["column"], arma, settings, messages, steps, level)

    streaming.run("forecast", log, quiet, settings, process)
