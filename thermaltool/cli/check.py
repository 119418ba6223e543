"""``thermaltool check``: what is in a log and what is wrong with it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli.options import (
    POSITIVE,
    columns_option,
    from_option,
    gap_option,
    json_option,
    log_argument,
    to_option,
)
from thermaltool.errors import LogError

if TYPE_CHECKING:
    from thermaltool.logs import Log
    from thermaltool.logs.inspect import Inspection

DID_NOT_PASS = 3


@click.command(
    "check",
    epilog="Example: thermaltool plant frame --input step | thermaltool check --json - | jq .rows",
)
@log_argument
@columns_option
@from_option
@gap_option
@json_option
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="Write the log under its mapped names, time in s; with -o - the report goes to stderr.",
)
@to_option
@click.option(
    "--resample",
    type=POSITIVE,
    metavar="SECONDS",
    help="Put the log that -o writes on an even clock of this period [s]; gaps stay gaps.",
)
@click.pass_context
def command(
    ctx: click.Context,
    log: str,
    columns: str | None,
    from_format: str | None,
    max_gap: float | None,
    as_json: bool,
    output: str | None,
    to_format: str | None,
    resample: float | None,
) -> None:
    """What is in LOG (rows, clock, channels) and what is wrong with it, one line each.

    Exits with 3 when something is wrong.
    """
    from thermaltool.logs import read_log, write_table
    from thermaltool.logs import resample as on_even_clock
    from thermaltool.logs.inspect import inspect

    if resample and not output:
        raise click.UsageError("--resample needs -o: where to write the resampled log")
    table = read_log(log, columns=columns, from_format=from_format, max_gap=max_gap, strict=False)
    inspection = inspect(table)
    report = _json(table, inspection) if as_json else _text(table, inspection)
    click.echo(report, err=output == "-")
    if output:
        if resample:
            table = on_even_clock(table, resample)
        write_table({"time_s": table.time, **table.columns}, output, to_format)
    if inspection.findings:
        ctx.exit(DID_NOT_PASS)


def _text(log: Log, inspection: Inspection) -> str:
    clock = inspection.clock
    since = f", from {log.epoch}" if log.epoch else ""
    lines = [
        f"{log.name}: {inspection.rows} rows, {inspection.duration:g} s{since}, "
        f"{inspection.segments} segment{'' if inspection.segments == 1 else 's'}"
    ]
    if inspection.rows > 1:
        lines.append(f"period {clock.period:.6g} s, jitter {clock.jitter:.3g} s")
    if clock.burst_rows:
        lines[-1] += f", in bursts of {clock.burst_rows} rows every {clock.burst_period:g} s"
    width = max((len(channel.name) for channel in inspection.channels), default=7)
    lines.append(f"{'channel':<{width}}  {'min':>12}  {'max':>12}  {'unit':<5}  missing")
    for c in inspection.channels:
        lines.append(
            f"{c.name:<{width}}  {c.minimum:>12.6g}  {c.maximum:>12.6g}  {c.unit:<5}  "
            f"{100 * c.missing:.3g} %{'  constant' if c.minimum == c.maximum else ''}"
        )
    if not inspection.findings:
        return "\n".join([*lines, "nothing wrong"])
    wrong = [str(LogError(f.message, log.name, f.line, f.column)) for f in inspection.findings]
    return "\n".join([*lines, "wrong:", *wrong])


def _json(log: Log, inspection: Inspection) -> str:
    document = {"log": log.name, "sha256": log.digest, "epoch": log.epoch, **asdict(inspection)}
    return json.dumps(_plain(document), indent=2, sort_keys=True, allow_nan=False)


def _plain(value: Any) -> Any:
    """NaN and infinity as null, all the way down."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not -float("inf") < value < float("inf"):
        return None
    return value
