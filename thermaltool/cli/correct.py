"""``thermaltool correct``: a static curve in front of a linear model or behind it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from thermaltool.api.inputs import read_model
from thermaltool.cli.messages import warn, warn_pauses
from thermaltool.cli.options import (
    Source,
    json_option,
    keep_inputs,
    log_options,
    logs_argument,
    model_argument,
    one_stdin,
    output_option,
    quiet_option,
)
from thermaltool.documents import write_json
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from thermaltool.model import Model
    from thermaltool.record import Record

USUAL = {"spline": 6, "polynomial": 2}
# A drive farther from rest than this share of its range is on.
SWITCHED = 0.01


@click.command(
    epilog="Example: thermaltool correct model.json steps.csv --at Q_heater_W --refit "
    "-o corrected.json"
)
@model_argument
@logs_argument
@click.option("--at", multiple=True, metavar="CHANNEL",
              help="A drive: the curve is in front of its responses (Hammerstein). An output: "
              "behind them (Wiener). Repeatable.  [default: the only drive]")  # fmt: skip
@click.option("--curve", type=click.Choice(list(USUAL)), default="spline",
              help="A monotone spline, or a polynomial through zero.")  # fmt: skip
@click.option("--size", type=click.IntRange(min=1), metavar="N",
              help="Pieces of the spline, degree of the polynomial.  "
              "[default: 6, 2]")  # fmt: skip
@click.option("--refit", is_flag=True,
              help="Search time constants and gains again, together with the curves.")  # fmt: skip
@click.option("--validate", "validation", type=Source(), metavar="LOG",
              help="Judge on another log, too.")  # fmt: skip
@log_options
@output_option
@json_option
@quiet_option
def command(
    model: str,
    logs: tuple[str, ...],
    at: tuple[str, ...],
    curve: Any,
    size: int | None,
    refit: bool,
    validation: str | None,
    output: str,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """A static curve in front of a linear MODEL or behind it, fitted from logs.

    A regulator whose scale is not straight bends the power before it heats. Without --refit the
    model stays as it is and the curve stands for itself; with --refit one record of mixed levels
    gives dynamics and curve together, and the curve agrees with the drive at its largest level.
    The logs begin at rest. The corrected model goes to -o, for simulate, regularize, compensate.
    """
    from dataclasses import replace

    from thermaltool.documents import atomic_output
    from thermaltool.fitting.static import Form, correct
    from thermaltool.model import dumps
    from thermaltool.report.corrections import correction_document, correction_table

    if as_json and output == "-":
        raise click.UsageError("--json reports on stdout: give the model a file with -o")
    every = (*logs, *([] if validation is None else [validation]))
    one_stdin(model, *every)
    keep_inputs(output, model, *every)
    document = read_model(model)
    if not at:
        if len(document.drives) != 1:
            raise click.UsageError("the model has several drives: name one with --at")
        at = (document.drives[0].channel,)
    read = [_signals(name, document, options) for name in logs]
    sources = [{"name": name, "sha256": log.digest} for name, log in zip(logs, read, strict=True)]
    fresh = None if validation is None else _signals(validation, document, options)
    found = correct(document, read, at, Form(curve, size or USUAL[curve]), refit)
    provenance = {
        "logs": [*document.provenance.get("logs", []), *sources],
        "command": "thermaltool " + " ".join(sys.argv[1:]),
    }
    with atomic_output(output) as stream:
        stream.write(dumps(replace(found.model, provenance=provenance)).encode())
    if as_json:
        write_json(correction_document(found, document, fresh), "-")
    elif not quiet:
        warn(aligned(correction_table(found, document, fresh)))


def _signals(name: str, model: Model, options: dict[str, Any]) -> Record:
    """A log with all that the model reads and computes."""
    from thermaltool.errors import LogError
    from thermaltool.logs import read_log
    from thermaltool.model import relative
    from thermaltool.record import Record

    need = (*model.needs(), *(o.channel for o in model.outputs))
    log = read_log(name, **options, need=tuple(dict.fromkeys(need)))
    if len(log) < 3:
        raise LogError(f"{len(log)} rows say nothing of a curve", log.name)
    warn_pauses(log, "the drive is taken as held over it")
    for drive in model.drives:
        first = relative(log.column(drive.channel), drive.reference)[0]
        if abs(first) > SWITCHED * max(map(abs, drive.range)):
            warn(
                f"{log.name}: begins with {drive.channel} {first:g} away from rest: it is taken as "
                "switched on there, which misleads the fit where it was on before"
            )
    return Record(log.time, log.columns, digest=log.digest)
