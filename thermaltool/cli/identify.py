"""``thermaltool identify``: transfer functions from measured logs."""

from __future__ import annotations

import sys
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import (
    DURATION,
    MAX_TRANSFER_ORDER,
    PROPER_SHARE,
    DeadTime,
    InputPath,
    Order,
    TransferOrder,
)
from thermaltool.documents import write_json
from thermaltool.fitting.transfer.registry import MAX_MODES, STRUCTURES, described


@click.command(
    epilog="Example: thermaltool identify run.csv --input Q_main_W --output d_z_um --split 0.6 "
    "-o model.json"
)
@shared.logs_argument
@click.option("--input", "inputs", multiple=True, required=True, metavar="CHANNEL",
              help="What drives: power, speed, temperature; repeatable.")  # fmt: skip
@click.option("--output", "outputs", multiple=True, required=True, metavar="CHANNEL",
              help="What follows: displacement, angle, temperature; repeatable.")  # fmt: skip
@click.option("--structure", type=click.Choice([*STRUCTURES, *MAX_MODES, "components"]),
              help=f"Where the noise enters: {described()}; or first-order modes that all outputs "
              "share (network), or poles, real or complex (subspace), or modes whose rate and "
              "gains go by the level of an input (lpv; bilinear: in a straight line), or few "
              "components of many inputs.  [default: oe; subspace for more than two responses; "
              "components of inputs that agree; what predicts blocks far better]")  # fmt: skip
@click.option("--reduce", metavar="pca[:k]|pls[:k]|none",
              help="Components of the scaled inputs, or all inputs, through lags with a ridge.  "
              "[default: all of them]")  # fmt: skip
@click.option("--orders", type=TransferOrder(), multiple=True, metavar="nb,nf,nk|auto",
              help="Numerator coefficients and order of the denominator, up to "
              f"{MAX_TRANSFER_ORDER} each, and samples of delay; once for all inputs or once for "
              "each. auto chooses by held-out data.  [default: auto]")  # fmt: skip
@click.option("--modes", type=click.IntRange(1, max(MAX_MODES.values())), metavar="N",
              help="Shared modes of a network (up to 6) or lpv (4), poles of a subspace model "
              "(12).  [default: chosen by held-out data]")  # fmt: skip
@click.option("--delay", type=DeadTime(), metavar="SECONDS|auto",
              help="Dead time of a network; auto finds it for each input and output.  "
              "[default: 0]")  # fmt: skip
@click.option("--noise-orders", type=Order(), metavar="NC,ND",
              help="Orders of the noise of armax (NC) and bj (NC, ND).  "
              "[default: 1,1]")  # fmt: skip
@click.option("--continuous", is_flag=True,
              help="In continuous time: simplified refined instrumental variables.")  # fmt: skip
@click.option("--real-poles/--any-poles", default=None,
              help="Real, stable poles only, or pairs, too.  [default: real where orders of oe are "
              "chosen and heat leads to the outputs, unless pairs predict far better]")  # fmt: skip
@click.option("--initial", type=click.Choice(["auto", "rest", "free"]), default="auto",
              help="State at the first row: settled, free (estimated), or rest unless free "
              "is clearly better; not for arx and armax.")  # fmt: skip
@click.option("--split", type=PROPER_SHARE,
              metavar="SHARE", help="Fit on this first share of the rows, validate on the "
              "rest.")  # fmt: skip
@click.option("--validate", type=InputPath(), metavar="LOG", help="Validate on another log.")
@click.option("--reference", metavar="first|NUMBER",
              help="What counts as no input in the model file.  [default: first for T_..._degC, "
              "else 0]")  # fmt: skip
@click.option("--budget", type=DURATION, metavar="S",
              help="Time for the choice of orders and modes; then the best so far is fitted, as at "
              "Ctrl-C [s].  [default: none]")  # fmt: skip
@shared.span_options("Rows from", "Rows up to")
@shared.log_options
@click.option("-o", "model_file", metavar="FILE", help="Model file, for simulate and others.")
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    reference: str | None,
    model_file: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Transfer functions from measured logs: power, speed or temperature in, displacement out.

    Each output gets one model with all inputs; in a network and by subspace identification they
    share their time constants. The offset is estimated, and the state at the start where it is not
    at rest; gaps part the record. Fits are those of free runs; validation data are not used in the
    fit, and are run as simulate runs them: the state goes on from the rows before. Where a model
    predicts them worse than their mean does, the exit code is 3. Outputs that follow an input of
    the same row are tried, and the output says where no linear model describes the data.
    """
    from thermaltool import api
    from thermaltool.api.identification_arguments import check_arguments

    with shared.usage_errors():
        check_arguments(inputs, outputs, **options)
    rest = shared.reference_of(reference)
    shared.check_files(model_file, *logs, options["validate"])
    found = api.identify(logs, inputs, outputs, reference=rest, warn=warn,
                         progress=terminal_progress("identify"), **options)  # fmt: skip
    if as_json:
        write_json(found.document(), "-")
    elif model_file != "-":
        click.echo(found.table())
    # Where there is no model file of these fits, the table is there, and the old file stays.
    notes = (*found.notes, *(found.model_notes if model_file is not None else ()))
    if model_file is not None:
        api.write_model(found, model_file, command_line())
    for message in notes if not quiet else ():
        warn(message)
    if not found.predicts:
        sys.exit(DID_NOT_PASS)
