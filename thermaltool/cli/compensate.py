"""``thermaltool compensate``: sensor lines in, setpoint lines out."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from typing import Any

import click

from thermaltool.cli.options import (
    NOT_NEGATIVE,
    POSITIVE,
    columns_option,
    initial_option,
    json_lines_option,
    log_argument,
    model_argument,
    quiet_option,
)

FORMATS = click.Choice(["csv", "ndjson"])


class Interval(click.ParamType):
    """LOW:HIGH, or CHANNEL=LOW:HIGH; an end left empty is open."""

    def __init__(self, channel: bool = False) -> None:
        self.channel, self.name = channel, "CHANNEL=LOW:HIGH" if channel else "LOW:HIGH"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        channel, equals, interval = value.rpartition("=")
        low, colon, high = interval.partition(":")
        with contextlib.suppress(ValueError):
            ends = float(low or "-inf"), float(high or "inf")
            if colon and ends[0] <= ends[1] and bool(equals) == self.channel:
                return (channel, ends) if self.channel else ends
        self.fail(f"{value!r} is not {self.name}", param, ctx)


class Safe(click.ParamType):
    name = "hold|zero|VALUE"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        with contextlib.suppress(ValueError):
            number = 0.0 if value == "zero" else float(value)
            if abs(number) < float("inf"):
                return number
        return value if value == "hold" else self.fail(f"{value!r} is not {self.name}", param, ctx)


class Once(click.Option):
    """An option that is refused where it is given twice: else the last one would win."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        parser.add_option(obj=self, opts=self.opts, dest=self.name, action="append")

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> Any:
        given = opts.get(str(self.name), ())
        if len(given) > 1:
            raise click.BadParameter(f"{', '.join(given)}: there can be one only", ctx, self)
        return super().consume_value(ctx, {**opts, str(self.name): given[0]} if given else opts)


@click.command(epilog="Example: tail -n +1 -f temps.csv | thermaltool compensate model.json")
@model_argument
@log_argument
@columns_option
@click.option("--from", "from_format", type=FORMATS, default="csv", help="Format of the input.")
@click.option("--to", "to_format", type=FORMATS, default="csv", help="Format of the output.")
@click.option(
    "--period", type=POSITIVE, metavar="S", help="Period of an input without a clock [s]."
)
@click.option(
    "--clock",
    type=click.Choice(["column", "arrival"]),
    default="column",
    help="Time from the input, or of its arrival (to 1 ms).",
)
@click.option("--heater", cls=Once, metavar="CHANNEL",
              help="Set this drive, a heater, in place of offsets.")  # fmt: skip
@click.option("--target", metavar="OUTPUT",
              help="What the heater holds at zero.  [default: the only deflection]")  # fmt: skip
@click.option("--lead", type=POSITIVE, metavar="S", help="How far it is foretold for the heater, "
              "beyond its delay [s].  [default: 2 sample periods]")  # fmt: skip
@click.option(
    "--also",
    type=click.Choice(["estimates"]),
    help="Add columns: heat and deflections; the power wanted and the output.",
)
@click.option(
    "--sign",
    type=click.Choice(["-1", "1"]),
    default="-1",
    help="Setpoint over deflection: -1 for an offset that cancels it.",
)
@click.option(
    "--hold",
    type=POSITIVE,
    metavar="S",
    help="Bad readings are replaced by the last good one for this long [s]; then comes "
    "the safe setpoint.  [default: 10, at least 10 sample periods of the design]",
)
@click.option(
    "--frozen-after",
    type=POSITIVE,
    metavar="S",
    show_default="never",
    help="A reading identical for longer than this is bad [s]; commanded columns may stand still.",
)
@click.option(
    "--range",
    "ranges",
    type=Interval(channel=True),
    multiple=True,
    help="Readings outside are bad.  [default: calibrated range, widened by its width]",
)
@click.option(
    "--max-gap",
    type=POSITIVE,
    metavar="S",
    help="A longer pause is told, and counts as this long for --slew [s].  [default: as --hold, "
    "and 2 sample periods for --slew]",
)
@click.option(
    "--timeout",
    type=NOT_NEGATIVE,
    metavar="S",
    help="Without a usable line for this long [s] the safe setpoint is written; 0 never."
    "  [default: as --hold]",
)
@click.option(
    "--limit",
    "limits",
    type=Interval(),
    default=":",
    help="Range of the setpoints [um]; a heater's is 0 to what the calibration has seen [W].",
)
@click.option(
    "--slew",
    type=POSITIVE,
    metavar="UM_PER_S",
    default=10.0,
    help="Largest rate of the setpoints [um/s].",
)
@click.option(
    "--step",
    type=NOT_NEGATIVE,
    metavar="UM",
    default=0.5,
    help="Step of the setpoints, with a hysteresis of a quarter step [um]; 0 for none.",
)
@click.option(
    "--safe",
    type=Safe(),
    default="zero",
    help="Setpoint while readings are lost and at the end: the last one, or a value [um]; not "
    "with --heater.",
)
@click.option(
    "--checkpoint",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Keep the state here; a restart goes on from it.",
)
@click.option(
    "--checkpoint-every",
    type=POSITIVE,
    metavar="S",
    default=10.0,
    help="Time between two states kept [s].",
)
@initial_option
@json_lines_option
@quiet_option
def command(model: str, log: str, **options: Any) -> None:
    """Setpoints from sensor lines: one line in, one line out, at once.

    MODEL is a file from regularize; LOG is read line by line: the sensors, and the columns that
    measured drives and effects of the model need (regularize names them). Readings that are bad
    (text, empty, NaN, out of range, frozen) are held, then the safe setpoint is written until good
    ones return. The safe setpoint is also the last line, whatever ends the stream (end of input,
    SIGINT, SIGTERM); it is approached at --slew while the stream lives, and written at once at its
    end.
    Each deflection d_PLACE_um gives a column offset_PLACE_um; --limit, --slew, --step and --safe
    count in its unit.

    With --heater MODEL is one from identify, correct, schedule or superpose: LOG has its other
    drives, and the power of the heater comes out that brings --target to zero after --lead, for the
    limits that it has. Here the safe setpoint is no power.
    """
    # One small product per line: threads would only cost memory. Read when numpy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from thermaltool.api.inputs import read_model
    from thermaltool.cli.messages import emitter
    from thermaltool.cli.options import one_stdin, usage_errors
    from thermaltool.runtime.settings import Settings, open_stream

    one_stdin(model, log)
    alone = options["heater"] is None
    if alone and (options["target"] or options["lead"]):
        raise click.UsageError("--target and --lead go with --heater")
    if not alone and options["sign"] != "-1":
        raise click.UsageError("--sign is for offsets: it does not go with --heater")
    if not alone and options["safe"] != 0:
        raise click.UsageError("--safe is for offsets: the safe setpoint of a heater is no power")
    quiet = options.pop("quiet")
    if options.pop("as_json"):
        options["to_format"] = "ndjson"
    safe = options.pop("safe")
    frozen_after = options.pop("frozen_after")
    settings = Settings(
        sign=float(options.pop("sign")),
        safe=None if safe == "hold" else safe,
        frozen_after=float("inf") if frozen_after is None else frozen_after,
        ranges=dict(options.pop("ranges")),
        arrival=options.pop("clock") == "arrival",
        estimates=options.pop("also") == "estimates",
        settled=options.pop("initial") == "settled",
        **options,
    )

    emit, name = emitter("compensate", quiet), "<stdin>" if log == "-" else log
    with click.open_file(log, "rb") as source:
        with usage_errors():
            stream = open_stream(read_model(model), settings, source.fileno(), 1, emit, name)
        number = stream.run()
    if number:
        raise SystemExit(128 + number)
