"""``thermaltool forecast``: forecasts of a fitted model, in batch or as a stream."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared, streaming
from thermaltool.cli.series import outliers_option, series_options
from thermaltool.cli.types import DURATION, FORGETTING, PROPER_SHARE
from thermaltool.logs.formats import FORMATS

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.process import Process
    from thermaltool.timeseries.model import ArmaModel

# What the forecast of a log takes; the rest is for --stream.
BATCH_OPTIONS = (
    "column", "columns", "from_format", "level", "max_gap", "outliers", "period", "start", "steps",
    "stop",
)  # fmt: skip


@click.command(
    epilog="Example: logger | thermaltool forecast arma.json --stream --steps 10 > ahead.csv"
)
@shared.model_argument
@shared.log_argument
@series_options
@outliers_option
@click.option("--steps", type=click.IntRange(1, 1_000_000), default=1, help="Samples ahead.")
@click.option("--level", type=PROPER_SHARE, default=0.95,
              help="Of the intervals.")  # fmt: skip
@click.option("--stream", is_flag=True, help="Answer each line at once with the sample ahead.")
@click.option("--forgetting", type=FORGETTING, default=0.999,
              help="With --stream: weight of the past per sample; the model follows the signal."
)  # fmt: skip
@click.option("--timeout", type=DURATION, metavar="S",
              help="With --stream: a longer silence is told [s].")  # fmt: skip
@streaming.to_option
@streaming.text_options
@shared.output_option
@shared.quiet_option
def command(model: str, log: str, stream: bool, output: str, quiet: int, **options: Any) -> None:
    """Forecasts of a fitted model with intervals, in batch or as a stream.

    In batch: the samples 1 to --steps beyond the end of the log, as time, forecast, low and high;
    samples that stand alone count as missing, as in ``fit``.
    With --stream each line of LOG is answered by the forecast of the sample --steps ahead, from a
    model that starts as fitted and learns on (recursive least squares); with --period LOG has no
    clock. A pause above --max-gap makes it forget the samples before.
    """
    from thermaltool.documents import read_text
    from thermaltool.timeseries.model import loads

    shared.check_files(output, model, log)
    fitted = loads(*read_text(model))
    options["column"] = options["column"] or fitted.channel
    if stream:
        if output != "-":
            raise click.UsageError("--stream writes to stdout")
        if options["start"] is not None or options["stop"] is not None:
            raise click.UsageError("--start and --stop are for logs, not for --stream")
        _stream(fitted, log, quiet, options)
    elif options["to_format"] not in (None, *FORMATS):
        raise click.UsageError(f"--to {options['to_format']} goes with --stream")
    elif options["no_header"] or options["template"] is not None:
        raise click.UsageError("--no-header and --template go with --stream")
    else:
        _batch(fitted, log, output, options)


def _batch(model: ArmaModel, log: str, output: str, options: dict[str, Any]) -> None:
    from thermaltool import api
    from thermaltool.cli.messages import warn
    from thermaltool.logs import write_table

    given = {name: options[name] for name in BATCH_OPTIONS}
    result = api.forecast(model, log, warn=warn, **given)
    write_table(result.columns(), output, options["to_format"])


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
        gate = GATE if options["outliers"] == "omit" else math.inf
        arma = RecursiveArma(*orders, bool(model.trend), options["forgetting"], gate)
        arma.begin(model, model.entry.size)
        steps, level = options["steps"], options["level"]
        return Forecasts(options["column"], arma, settings, messages, steps, level)

    streaming.run("forecast", log, quiet, settings, process)
