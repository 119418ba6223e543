"""``thermaltool regularize``: from model and noise to an estimator."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DELAY, DURATION, NUMBER, POSITIVE, InputPath
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool regularize model.json --noise noise.json | "
    "thermaltool estimate - log.csv"
)
@shared.model_argument
@click.option(
    "--noise",
    type=InputPath(),
    help="What thermaltool noise -o wrote; not needed where every drive is measured.",
)
@click.option("--form", type=click.Choice(["auto", "kalman", "kernel"]), default="auto",
              help="auto takes the one that fares better by the criterion.")  # fmt: skip
@click.option("--measured", multiple=True, metavar="CHANNEL",
              help="This drive is read, not estimated.  [default: all, in a model without "
              "sensor]")  # fmt: skip
@click.option("--sensor", "sensors", multiple=True, metavar="CHANNEL", help="Use only this sensor.")
@click.option("--dt", type=DURATION, metavar="SECONDS",
              help="Sample period of the estimator [s].  [default: that of the "
              "calibration]")  # fmt: skip
@click.option("--walk", type=POSITIVE,
              help="Pin the Kalman form's random-walk rate "
              "[share of the level per √s].")  # fmt: skip
@click.option("--criterion", type=click.Choice(["heat", "deflection", "both"]),
              help="What the design is for.  [default: deflection where the model has one, "
              "else heat]")  # fmt: skip
@click.option("--delay", type=DELAY, help="Pin the kernel form's artificial delay [s].")
@click.option("--cutoff", type=POSITIVE, help="Pin the kernel form's filter [Hz].")
@click.option("--regularization", nargs=3, type=NUMBER, metavar="A B C",
              help="Pin f_R = (At + Bt²)e^(−ct) of the kernel form "
              "[unit/s, unit/s², 1/s].")  # fmt: skip
@shared.output_option
@shared.json_option
@shared.quiet_option
def command(
    model: str,
    noise: str | None,
    measured: tuple[str, ...],
    sensors: tuple[str, ...],
    output: str,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Design the estimator from the model and the measured noise.

    Both forms minimize the predicted band of the deflection error after a step of the calibrated
    level: what is missing while the estimate catches up, and what the sensors' noise leaves. Of the
    heat they minimize the root of the mean squared error (--criterion). The
    trade-off goes to stderr (with --json to stdout), the model with its design to -o.

    The model's effects become part of the design: a sensor's lag, what a channel of the log adds,
    what a measured drive does. Where every drive is measured, nothing is left to estimate, and
    the deflections follow from the drives (form feedforward).
    """
    from thermaltool import api
    from thermaltool.api.result import silent
    from thermaltool.estimation.design import needs_noise
    from thermaltool.model import only_sensors

    shared.check_files(None, model, noise)
    shared.check_files(output, noise, as_json=as_json)
    document = api.read_model(model)
    if sensors:
        document = only_sensors(document, sensors)
    if noise is None and needs_noise(document, measured):
        raise click.UsageError("Missing option '--noise': an estimate weighs it")
    result = api.regularize(document, noise, measured=measured, **options,
                            warn=silent if quiet else warn,
                            progress=terminal_progress("regularize"))  # fmt: skip
    if quiet:
        for note in result.design.notes:
            warn(note)
    # The file last: where anything before it fails, the old one stays.
    table = result.table()
    if as_json:
        write_json(result.document(), "-")
    api.write_model(result, output)
    if not as_json and not quiet:
        warn(table)
