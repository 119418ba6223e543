"""``thermaltool identify``: transfer functions from measured logs."""

from __future__ import annotations

import sys
from typing import Any

import click
from click.core import ParameterSource

from thermaltool.cli.fit import Order
from thermaltool.cli.messages import warn
from thermaltool.cli.options import (
    NUMBER,
    NumberRange,
    Source,
    json_option,
    keep_inputs,
    log_options,
    logs_argument,
    one_stdin,
    quiet_option,
    reference_of,
)
from thermaltool.cli.series import one_thread
from thermaltool.documents import write_json

# From the tenth order on the search leaves the range of numbers (--continuous first).
LARGEST_ORDER = 9


class TransferOrder(click.ParamType):
    name = "nb,nf,nk"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        parts = [part.strip() for part in value.split(",")]
        if value == "auto":
            return None
        if len(parts) != 3 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(f"{value!r} is neither {self.name} nor auto", param, ctx)
        nb, nf, nk = map(int, parts)
        if max(nb, nf) > LARGEST_ORDER:
            self.fail(f"{value!r}: nb and nf go up to {LARGEST_ORDER}", param, ctx)
        return nb, nf, nk


class Delay(click.ParamType):
    name = "SECONDS|auto"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "auto" or not isinstance(value, str):
            return value
        seconds = NUMBER.convert(value, param, ctx)
        if seconds < 0:
            self.fail(f"{value!r} is below 0", param, ctx)
        return seconds


@click.command(
    epilog="Example: thermaltool identify run.csv --input Q_main_W --output d_z_um --split 0.6 "
    "-o model.json"
)
@logs_argument
@click.option("--input", "inputs", multiple=True, required=True, metavar="CHANNEL",
              help="What drives: power, speed, temperature; repeatable.")  # fmt: skip
@click.option("--output", "outputs", multiple=True, required=True, metavar="CHANNEL",
              help="What follows: displacement, angle, temperature; repeatable.")  # fmt: skip
@click.option("--structure", type=click.Choice(["oe", "bj", "arx", "armax", "network"]),
              default="oe", help="Where the noise enters: at the output (oe), with a model of its "
              "own (bj), through the denominator (arx), or that with a moving average (armax); or "
              "first-order modes that all outputs share (network).")  # fmt: skip
@click.option("--orders", type=TransferOrder(), multiple=True, metavar="nb,nf,nk|auto",
              help="Numerator coefficients and order of the denominator, up to "
              f"{LARGEST_ORDER} each, and samples of delay; once for all inputs or once for each. "
              "auto chooses by held-out data.  "
              "[default: auto]")  # fmt: skip
@click.option("--modes", type=click.IntRange(1, 6), metavar="N",
              help="Shared modes of a network.  [default: chosen by held-out data]")  # fmt: skip
@click.option("--delay", type=Delay(), metavar="SECONDS|auto",
              help="Dead time of a network; auto finds it for each input and output.  "
              "[default: 0]")  # fmt: skip
@click.option("--noise-orders", type=Order(), default="1,1", metavar="NC,ND",
              help="Orders of the noise of armax (NC) and bj (NC, ND).")  # fmt: skip
@click.option("--continuous", is_flag=True,
              help="In continuous time: simplified refined instrumental variables.")  # fmt: skip
@click.option("--real-poles", is_flag=True,
              help="Overdamped models only: real, stable poles.")  # fmt: skip
@click.option("--initial", type=click.Choice(["auto", "rest", "free"]), default="auto",
              help="State at the first row: settled, free (estimated), or rest unless free "
              "is clearly better; not for arx and armax.")  # fmt: skip
@click.option("--split", type=NumberRange(min=0, max=1, min_open=True, max_open=True),
              metavar="SHARE", help="Fit on this first share of the rows, validate on the "
              "rest.")  # fmt: skip
@click.option("--validate", "validation", type=Source(), metavar="LOG",
              help="Validate on another log.")  # fmt: skip
@click.option("--reference", metavar="first|NUMBER",
              help="What counts as no input in the model file.  [default: first for T_..._degC, "
              "else 0]")  # fmt: skip
@click.option("--start", type=NUMBER, metavar="SECONDS", help="Rows from this time on [s].")
@click.option("--stop", type=NUMBER, metavar="SECONDS", help="Rows up to this time [s].")
@log_options
@click.option("-o", "model_file", metavar="FILE", help="Model file, for simulate and others.")
@json_option
@quiet_option
def command(
    logs: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    validation: str | None,
    reference: str | None,
    model_file: str | None,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Transfer functions from measured logs: power, speed or temperature in, displacement out.

    Each output gets one model with all inputs; in a network they share their time constants. The
    offset is estimated, and the state at the start where it is not at rest; gaps part the record.
    Fits are those of free runs; validation data are not used in the fit. Where refined instrumental
    variables do not converge, Gauss-Newton goes on, and the output says so.
    """
    one_thread()
    from thermaltool.cli.network import identify_shared
    from thermaltool.cli.transfer import identify_each
    from thermaltool.documents import atomic_output
    from thermaltool.fitting.transfer.machine import machine
    from thermaltool.model import dumps

    _agree(inputs, outputs, validation, options)
    rest = reference_of(reference)
    every = (*logs, *([] if validation is None else [validation]))
    one_stdin(*every)
    if model_file is not None:
        keep_inputs(model_file, *every)
    run = identify_shared if options["structure"] == "network" else identify_each
    found, told = run(logs, inputs, outputs, validation, options), []
    if model_file is not None:
        provenance = {"logs": found.sources, "command": "thermaltool " + " ".join(sys.argv[1:])}
        model = machine(found.parts, rest, provenance)
        with atomic_output(model_file) as stream:
            stream.write(dumps(model).encode())
        told = found.in_use(model)
    if as_json:
        write_json(found.document, "-")
    elif model_file != "-":
        click.echo(found.table)
    if not quiet:
        for message in [*found.warnings, *told]:
            warn(message)


def _agree(
    inputs: tuple[str, ...], outputs: tuple[str, ...], validation: str | None, options: Any
) -> None:
    """Refuse options that contradict each other (UsageError)."""
    structure = options["structure"]
    shared = structure == "network"
    if options["split"] is not None and validation is not None:
        raise click.UsageError("--split and --validate both name the validation data: take one")
    for name in (*inputs, *outputs):
        if (*inputs, *outputs).count(name) > 1:
            raise click.UsageError(f"{name} is named twice: a channel has one role")
    if len(options["orders"]) > 1 and len(options["orders"]) != len(inputs):
        raise click.UsageError("--orders: once for all inputs, or once for each")
    if options["continuous"] and structure != "oe":
        raise click.UsageError("--continuous goes with --structure oe")
    if shared and options["orders"]:
        raise click.UsageError("--orders: a network takes --modes and --delay")
    if not shared and (options["modes"], options["delay"]) != (None, None):
        raise click.UsageError("--modes and --delay go with --structure network")
    source = click.get_current_context().get_parameter_source("noise_orders")
    if source is ParameterSource.COMMANDLINE and structure not in ("armax", "bj"):
        raise click.UsageError("--noise-orders go with --structure armax and bj")
    if options["real_poles"] and shared:
        raise click.UsageError("--real-poles: those of a network are always real")
    if options["initial"] != "auto" and structure in ("arx", "armax"):
        raise click.UsageError(
            f"--initial: {structure} takes its first rows as they are, from any state"
        )
