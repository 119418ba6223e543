"""``thermaltool correct``: a static curve in front of a linear model or behind it."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.api.inputs import read_for_fit, read_model, write_model
from thermaltool.cli import shared
from thermaltool.cli.messages import command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import InputPath
from thermaltool.documents import write_json
from thermaltool.report.text import aligned

# Second differences, which tell the noise of a reading, take so many.
MIN_ROWS = 3


@click.command(
    epilog="Example: thermaltool correct model.json steps.csv --at Q_heater_W --refit "
    "-o corrected.json"
)
@shared.model_argument
@shared.logs_argument
@click.option("--at", multiple=True, metavar="CHANNEL",
              help="A drive: the curve is in front of its responses (Hammerstein). An output: "
              "behind them (Wiener). Repeatable.  [default: the only drive]")  # fmt: skip
@click.option("--curve", type=click.Choice(["spline", "polynomial"]), default="spline",
              help="A monotone spline, or a polynomial through zero.")  # fmt: skip
@click.option("--size", type=click.IntRange(min=1), metavar="N",
              help="Pieces of the spline, degree of the polynomial.  "
              "[default: 6, 2]")  # fmt: skip
@click.option("--refit", is_flag=True,
              help="Search time constants and gains again, together with the curves.")  # fmt: skip
@click.option("--validate", "validation", type=InputPath(), metavar="LOG",
              help="Judge on another log, too.")  # fmt: skip
@shared.log_options
@shared.output_option
@shared.json_option
@shared.quiet_option
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
    from thermaltool.fitting.static import correct
    from thermaltool.model.curves import Form
    from thermaltool.report.corrections import (
        correction_document,
        correction_table,
        correction_warnings,
    )

    every = (*logs, *([] if validation is None else [validation]))
    shared.check_files(output, model, *every, as_json=as_json)
    document = read_model(model)
    if not at:
        if len(document.drives) != 1:
            raise click.UsageError("the model has several drives: name one with --at")
        at = (document.drives[0].channel,)
    need = tuple(dict.fromkeys((*document.needs(), *(o.channel for o in document.outputs))))
    read = []
    for name in every:
        read.append(read_for_fit(name, need, "curve", min_rows=MIN_ROWS, warn=warn, **options))
        for sentence in correction_warnings(document, read[-1]):
            warn(sentence)
    fresh = None if validation is None else read.pop()
    progress = terminal_progress("correct")
    found = correct(document, read, at, Form.usual(curve, size), refit)
    progress("done\n")
    # The file last: where anything before it fails, the old one stays.
    table = aligned(correction_table(found, document, fresh))
    if as_json:
        write_json(correction_document(found, document, fresh), "-")
    write_model(found.model, output, command_line())
    if not as_json and not quiet:
        warn(table)
