"""``thermaltool regularize``: from model and noise to an estimator."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click

from thermaltool.api.inputs import read_model, read_noise
from thermaltool.cli.messages import terminal_progress, warn
from thermaltool.cli.options import (
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    Source,
    json_option,
    keep_inputs,
    model_argument,
    one_stdin,
    output_option,
    quiet_option,
)
from thermaltool.documents import write_json
from thermaltool.errors import FitError, ModelError
from thermaltool.report.text import aligned


@click.command(
    epilog="Example: thermaltool regularize model.json --noise noise.json | "
    "thermaltool estimate - log.csv"
)
@model_argument
@click.option(
    "--noise",
    type=Source(),
    help="What thermaltool noise -o wrote; not needed where every drive is measured.",
)
@click.option(
    "--form",
    type=click.Choice(["auto", "kalman", "kernel"]),
    default="auto",
    help="auto takes the one with the narrower predicted band.",
)
@click.option(
    "--measured",
    multiple=True,
    metavar="CHANNEL",
    help="This drive is read, not estimated.  [default: all, in a model without sensor]",
)
@click.option("--sensor", "sensors", multiple=True, metavar="CHANNEL", help="Use only this sensor.")
@click.option(
    "--dt",
    type=POSITIVE,
    metavar="SECONDS",
    help="Sample period of the estimator [s].  [default: that of the calibration]",
)
@click.option(
    "--walk",
    type=POSITIVE,
    help="Pin the Kalman form's random-walk rate [share of the level per √s].",
)
@click.option("--delay", type=NOT_NEGATIVE, help="Pin the kernel form's artificial delay [s].")
@click.option(
    "--cutoff",
    type=POSITIVE,
    help="Pin the kernel form's filter [Hz].",
)
@click.option(
    "--regularization",
    nargs=3,
    type=NUMBER,
    metavar="A B C",
    help="Pin f_R = (At + Bt²)e^(−ct) of the kernel form [unit/s, unit/s², 1/s].",
)
@output_option
@json_option
@quiet_option
def command(
    model: str,
    noise: str | None,
    form: str,
    measured: tuple[str, ...],
    sensors: tuple[str, ...],
    dt: float | None,
    walk: float | None,
    delay: float | None,
    cutoff: float | None,
    regularization: tuple[float, float, float] | None,
    output: str,
    as_json: bool,
    quiet: int,
) -> None:
    """Design the estimator from the model and the measured noise.

    Both forms minimize the predicted band of the deflection error after a step of the calibrated
    level: what is missing while the estimate catches up, and what the sensors' noise leaves. The
    trade-off goes to stderr (with --json to stdout), the model with its design to -o.

    The model's effects become part of the design: a sensor's lag, what a channel of the log adds,
    what a measured drive does. Where every drive is measured, nothing is left to estimate, and
    the deflections follow from the drives (form feedforward).
    """
    from thermaltool.documents import atomic_output
    from thermaltool.estimation.design_model import DesignModel
    from thermaltool.estimation.known_inputs import Feedforward
    from thermaltool.estimation.regularization import best_choice, design_kalman, design_kernel
    from thermaltool.model import dumps, only_sensors

    if as_json and output == "-":
        raise click.UsageError("--json reports on stdout: give the model a file with -o")
    if noise is not None:
        one_stdin(model, noise)
        keep_inputs(output, noise)
    document = read_model(model)
    if sensors:
        document = only_sensors(document, sensors)
    if noise is None and document.sensors and {d.channel for d in document.drives} - {*measured}:
        raise click.UsageError("Missing option '--noise': an estimate weighs it")
    known = {} if noise is None else read_noise(noise)
    machine = DesignModel.of(document, known, dt or document.sample_period, measured)
    if not quiet:
        for note in machine.notes:
            warn(note)
        if machine.drives and machine.known:
            warn(f"read beside the sensors: {', '.join(k.channel for k in machine.known)}")
    report: dict[str, Any] = {"outputs": list(machine.outputs), "sample_period_s": machine.dt}
    if not machine.drives:
        if form != "auto":
            raise ModelError(f"--form {form}: every drive is measured, nothing is to be estimated")
        estimator = machine.finished(Feedforward(machine.outputs))
        design = {**estimator.document(), "sample_period_s": machine.dt}
        with atomic_output(output) as stream:
            stream.write(dumps(document.with_design(design)).encode())
        if as_json:
            write_json({"chosen": "feedforward", **report, "forms": {}}, "-")
        elif not quiet:
            warn(f"chosen: feedforward, from {', '.join(estimator.sensors)}")
        return
    progress = terminal_progress("regularize")
    pinned = {"delay_s": delay, "cutoff_Hz": cutoff}
    pinned |= dict(zip("ABc", regularization or (None,) * 3, strict=True))
    designs = {}
    if form != "kernel":
        designs["kalman"] = design_kalman(machine, walk, progress)
    single = len(machine.sensors) == 1 and len(machine.drives) == 1
    if form == "kernel" or (form == "auto" and single):
        held = {name: value for name, value in pinned.items() if value is not None}
        try:
            designs["kernel"] = design_kernel(machine, held, progress)
        except FitError as error:
            if form == "kernel":
                raise
            warn(f"kernel form: {error}")
    progress("done\n")
    best = {name: best_choice(choices) for name, choices in designs.items()}
    chosen = min(best, key=lambda name: best[name].objective)
    report |= {
        "chosen": chosen,
        "forms": {
            name: {
                "settings": choice.settings,
                "predicted": asdict(choice.prediction),
                "trade_off": [
                    {"settings": c.settings, "predicted": asdict(c.prediction)}
                    for c in designs[name]
                ],
            }
            for name, choice in best.items()
        },
    }
    design = {
        **machine.finished(best[chosen].estimator).document(),
        "sample_period_s": machine.dt,
        "settings": best[chosen].settings,
        "predicted": asdict(best[chosen].prediction),
    }
    with atomic_output(output) as stream:
        stream.write(dumps(document.with_design(design)).encode())
    if as_json:
        write_json(report, "-")
    elif not quiet:
        heading = ["form", "setting", "lag s", "settles s"]
        for name in machine.outputs:
            heading += [f"{name}: band", "lag error", "noise σ"]
        rows = [heading]
        for name, choices in designs.items():
            for c in choices:
                mark = " <" if c is best[chosen] else ""
                p = c.prediction
                key = "walk_per_sqrt_s" if name == "kalman" else "delay_s"
                row = [
                    name,
                    f"{key} {c.settings[key]:.3g}{mark}",
                    f"{p.lag:.1f}",
                    f"{p.settling:.0f}",
                ]
                for k in range(len(machine.outputs)):
                    row += [f"{p.band[k]:.2f}", f"{p.lag_error[k]:.2f}", f"{p.noise_sigma[k]:.3f}"]
                rows.append(row)
        warn(aligned(rows))
        warn(f"chosen: {chosen}, {_told(best[chosen].settings)}")


def _told(settings: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in settings.items())
