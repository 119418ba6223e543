"""``thermaltool diagnose``: what a model gets wrong, why, and what knowing it is worth."""

from __future__ import annotations

import sys
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, command_line, warn
from thermaltool.cli.progress import coloured, terminal_progress
from thermaltool.cli.types import InputPath, NumberRange
from thermaltool.documents import write_json

# Exit code and colour of each verdict.
OUTCOMES = {"adequate": (0, "green"), "not adequate": (DID_NOT_PASS, "red"),
            "cannot judge": (4, "yellow")}  # fmt: skip


@click.command(
    epilog="Example: thermaltool diagnose model.json morning.csv --validate evening.csv "
    "-o extended.json --report why.md > why.json"
)
@shared.model_argument
@shared.logs_argument
@click.option("--validate", multiple=True, type=InputPath(), metavar="LOG",
              help="A log that no fit sees: causes have to hold on it, unless the model as it "
              "came fits it; gains are told on it; repeatable.  [default: stretches of the LOGs "
              "are held out in turn]")  # fmt: skip
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="Where the extended model goes: the input, byte for byte, where no cause is found; "
    "not written where LOG or --validate would be worse by it.  [default: nowhere]",
)
@click.option("--report", metavar="FILE.md", help="Report in Markdown, its figures beside it.")
@click.option(
    "--tolerance",
    multiple=True,
    metavar="[CHANNEL=]VALUE[UNIT]",
    help="What an output may be off by, e.g. 5um or d_z_um=5um; without a unit in that of the "
    "outputs; repeatable. Each cause is told against it.  [default: none]",
)
@click.option(
    "--limits", default="", show_default=False,
    metavar="switch=TIME,run=TIME,fixed=CHANNEL,set=CHANNEL",
    help="What experiments may ask for: shortest time between switches, longest run (with units: "
    "30s, 4h), channels that cannot be set, temperatures that can.  "
    "[default: a working day or the longest log]",
)  # fmt: skip
@click.option(
    "--fail-above",
    type=NumberRange(0, 1),
    metavar="SHARE",
    help="Exit 3 only where more than this share of an output's residual power is neither noise "
    "nor the calibration's own error; 1 never fails.  [default: by the verdict]",
)
@click.option("--json", "as_json", is_flag=True, hidden=True)
@shared.log_options
@shared.quiet_option
def command(
    model: str,
    logs: tuple[str, ...],
    validate: tuple[str, ...],
    output: str | None,
    report: str | None,
    tolerance: tuple[str, ...],
    limits: str,
    fail_above: float | None,
    as_json: bool,
    quiet: int,
    **reading: Any,
) -> None:
    """What a model gets wrong on measured logs, why, and what knowing it is worth.

    Compares the residual with the noise of the same log, tries every cause of the catalogue,
    extends the model by those that have evidence and help on data that the fit has not seen (-o),
    and says what these logs cannot tell apart. What is told of the extended model is what simulate
    makes of it. JSON goes to stdout, the verdict to stderr. Exit 0 where the model is adequate, 3
    where it is not or -o would be worse, 4 where these logs cannot judge it.
    """
    from thermaltool import api
    from thermaltool.api.result import silent

    inputs = (model, *logs, *validate)
    if output == "-":
        raise click.UsageError("stdout takes the JSON: give the extended model a file with -o")
    if report == "-":
        raise click.UsageError("stdout takes the JSON: give --report a file, FILE.md")
    shared.check_files(output, *inputs)
    shared.keep_from_report(report, inputs, output)
    found = api.diagnose(model, logs, validate=validate, tolerance=tolerance, limits=limits,
                         **reading, warn=silent if quiet else warn,
                         progress=terminal_progress("diagnose"))  # fmt: skip
    calibration = [log.name for log in found.calibration]
    if output is not None:
        shared.keep_inputs(output, *calibration)
    shared.keep_from_report(report, calibration, None)
    refused = output is not None and found.diagnosis.spoiled
    # The files last: where anything before them fails, the old ones stay.
    table = found.table()
    write_json(found.document(), "-")
    if report is not None:
        found.write(report, lambda figure: shared.keep_inputs(figure, *inputs, *calibration))
    if output is not None and not refused:
        found.write_extended(output, model, command_line())
    code, color = OUTCOMES[found.diagnosis.verdict]
    if not quiet:
        first, newline, rest = table.partition("\n")
        warn(coloured(first, fg=color, bold=True) + newline + rest)
        if output is not None and not refused and not found.diagnosis.extends:
            warn(f"{output}: the model as it came, nothing extends it")
    if refused:
        warn(f"{output} is not written: {refused} would be worse than by {model}")
    if fail_above is not None:
        code = DID_NOT_PASS if found.exceeds(fail_above) else 0
    sys.exit(DID_NOT_PASS if refused else code)
