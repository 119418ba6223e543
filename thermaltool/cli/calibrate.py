"""``thermaltool calibrate``: logs in, a model out."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from thermaltool.cli.messages import terminal_progress, warn, warn_pauses
from thermaltool.cli.options import (
    NUMBER,
    json_option,
    keep_inputs,
    log_options,
    logs_argument,
    number_of,
    one_stdin,
    output_option,
    quiet_option,
    reference_of,
)
from thermaltool.documents import write_json
from thermaltool.report.text import aligned

if TYPE_CHECKING:
    from thermaltool.responses import Response


@click.command(
    epilog="Example: thermaltool plant frame --input step | thermaltool calibrate - "
    "--drive Q_main_1 --sensor dT_pair1_K --deflection d_y_um -o model.json"
)
@logs_argument
@click.option(
    "--drive",
    "drives",
    multiple=True,
    required=True,
    metavar="CHANNEL",
    help="Known input: a heat, a voltage, or any measured channel; repeatable.",
)
@click.option(
    "--sensor",
    "sensors",
    multiple=True,
    metavar="CHANNEL",
    help="Output from which the drive will be estimated; repeatable.",
)
@click.option(
    "--deflection",
    "deflections",
    multiple=True,
    metavar="CHANNEL",
    help="Output that will be computed; repeatable.",
)
@click.option(
    "--response",
    "responses",
    multiple=True,
    metavar="CHANNEL=KIND",
    help="Kind of response: conduction, deflection, joint_deflection.  "
    "[default: conduction for sensors, deflection for deflections]",
)
@click.option(
    "--fix",
    "fixed",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter that is not fitted, e.g. r0=0.12 (the unit of length).",
)
@click.option(
    "--reference",
    metavar="first|NUMBER",
    help="What counts as no drive.  [default: first for T_..._degC, else 0]",
)
@click.option(
    "--initial",
    type=click.Choice(["rest", "free"]),
    default="rest",
    help="State at the first row: at rest, or coming from an unknown level.",
)
@click.option("--start", type=NUMBER, metavar="SECONDS", help="Fit from this time on [s].")
@click.option("--stop", type=NUMBER, metavar="SECONDS", help="Fit up to this time [s].")
@click.option(
    "--loss",
    type=click.Choice(["huber", "linear"]),
    default="huber",
    help="huber counts outliers less.",
)
@click.option(
    "--starts", type=click.IntRange(1, 50), default=6, help="Starts of the search that are refined."
)
@click.option(
    "--max-rmse",
    type=NUMBER,
    metavar="VALUE",
    help="Exit 3 when an output's RMSE is above this [unit of the output].",
)
@log_options
@output_option
@json_option
@quiet_option
def command(
    logs: tuple[str, ...],
    drives: tuple[str, ...],
    sensors: tuple[str, ...],
    deflections: tuple[str, ...],
    responses: tuple[str, ...],
    fixed: tuple[str, ...],
    reference: str | None,
    initial: str,
    start: float | None,
    stop: float | None,
    loss: str,
    starts: int,
    max_rmse: float | None,
    columns: str | None,
    from_format: str | None,
    nan_policy: str,
    max_gap: float | None,
    output: str,
    as_json: bool,
    quiet: int,
) -> None:
    """Fit temperature and deflection models to measured logs.

    Any input will do, not only a step; several logs are fitted together. The model goes to -o, a
    table of the fit to stderr (with --json to stdout).
    """
    from thermaltool.documents import atomic_output
    from thermaltool.errors import LogError
    from thermaltool.fitting.records import Plan, calibrate
    from thermaltool.logs import read_log
    from thermaltool.model import dumps, to_document
    from thermaltool.record import Record

    if as_json and output == "-":
        raise click.UsageError("--json reports on stdout: give the model a file with -o")
    plan = Plan(
        drives,
        sensors,
        deflections,
        dict(_pair(item, "--response") for item in responses),
        reference_of(reference),
        None,
        {name: number_of(value, "--fix") for name, value in (_pair(i, "--fix") for i in fixed)},
        loss,  # type: ignore[arg-type]
        starts,
        initial == "free",
    )
    need = (*drives, *sensors, *deflections)
    one_stdin(*logs)
    keep_inputs(output, *logs)
    measurements, sources = [], []
    for name in logs:
        log = read_log(
            name,
            columns=columns,
            from_format=from_format,
            nan_policy=nan_policy,
            max_gap=max_gap,
            need=need,
        )
        log = log.between(start, stop)
        if len(log) < 2:
            raise LogError(f"{len(log)} rows say nothing of a response", log.name)
        warn_pauses(log, "the drive is taken as held over it")
        measurements.append(Record(log.time, {channel: log.column(channel) for channel in need}))
        sources.append({"name": log.name, "sha256": log.digest})
    provenance = {"logs": sources, "command": "thermaltool " + " ".join(sys.argv[1:])}
    progress = terminal_progress("calibrate")
    model = calibrate(measurements, plan, provenance, progress)
    progress("done\n")
    with atomic_output(output) as stream:
        stream.write(dumps(model).encode())
    if as_json:
        write_json({key: to_document(model)[key] for key in ("outputs", "terms")}, "-")
    elif not quiet:
        rows = [["output", "rmse", "fit %", "max", "rows", "parameters"]]
        for out in model.outputs:
            fit = out.fit
            terms = [t.response for t in model.terms if t.output == out.channel]
            rows.append(
                [
                    out.channel,
                    f"{fit['rmse']:.4g}",
                    f"{fit['fit_percent']:.2f}",
                    f"{fit['max_error']:.3g}",
                    str(fit["rows"]),
                    "; ".join(map(_told, terms)),
                ]
            )
        warn(aligned(rows))
    if not quiet:
        for out in model.outputs:
            for sentence in out.fit["unidentified"]:
                warn(f"{out.channel}: {sentence}")
    if max_rmse is not None and any(out.fit["rmse"] > max_rmse for out in model.outputs):
        sys.exit(3)


def _told(response: Response) -> str:
    from thermaltool.responses import parameter_names

    names = parameter_names(response.kind)
    return " ".join([response.kind, *(f"{n}={getattr(response, n):.4g}" for n in names)])


def _pair(item: str, option: str) -> tuple[str, str]:
    name, equals, value = item.partition("=")
    if not equals:
        raise click.UsageError(f"{option} takes NAME=VALUE, not {item!r}")
    return name, value
