"""``thermaltool calibrate``: logs in, a model out."""

from __future__ import annotations

import sys
from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import DID_NOT_PASS, command_line, warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.documents import write_json

# Options that choose and fit responses: the mesh of a body has its own.
_OF_RESPONSES = ("drives", "sensors", "deflections", "responses", "fixed", "reference", "initial",
                 "linear", "reduce", "joint", "loss", "starts")  # fmt: skip


@click.command(
    epilog="Example: thermaltool plant frame --input step | thermaltool calibrate - "
    "--drive Q_main_1 --sensor dT_pair1_K --deflection d_y_um -o model.json"
)
@shared.logs_argument
@click.option("--body", type=click.Path(exists=True, dir_okay=False), metavar="BODY.toml",
              help="Finite-element model that the logs update, as modes takes it; its heats are "
              "the drives.")  # fmt: skip
@click.option("--drive", "drives", multiple=True, metavar="CHANNEL",
              help="Known input: a heat, a voltage, or any measured channel; "
              "repeatable.")  # fmt: skip
@click.option("--sensor", "sensors", multiple=True, metavar="CHANNEL",
              help="Output from which the drive will be estimated; repeatable.")  # fmt: skip
@click.option("--deflection", "deflections", multiple=True, metavar="CHANNEL",
              help="Output that will be computed; repeatable.")  # fmt: skip
@click.option("--response", "responses", multiple=True, metavar="CHANNEL=KIND",
              help="Kind of response: conduction, slab, rod, deflection, joint_deflection, "
              "oscillation, rational1 (a lag) to rational12, these with _direct, too.  "
              "[default: chosen by evidence and held-out rows]")  # fmt: skip
@click.option("--fix", "fixed", multiple=True, metavar="NAME=VALUE",
              help="A parameter that is not fitted, e.g. r0=0.12 "
              "(the unit of length).")  # fmt: skip
@click.option("--reference", metavar="first|NUMBER",
              help="What counts as no drive.  [default: first for T_..._degC, else 0]")  # fmt: skip
@click.option("--initial", type=click.Choice(["auto", "rest", "free"]), default="auto",
              help="State at the first row: at rest, coming from an unknown level, or the latter "
              "where that leaves far less.")  # fmt: skip
@click.option("--linear", is_flag=True,
              help="Take every drive as it is logged, and the material as at rest.  [default: "
              "a power law or a parabola of a drive, a heat capacity or a loss that changes with "
              "temperature, where evidence and held-out rows speak for one]")  # fmt: skip
@click.option("--reduce", metavar="pca[:k]|pls[:k]|none",
              help="For many drives that say much the same: components of them, directly and "
              "through lags with a ridge, as identify has them.")  # fmt: skip
@click.option("--joint", multiple=True, metavar="CHANNEL",
              help="Contact temperature of a joint, repeatable, with logs of several levels: it "
              "tells how displacements depart from proportion.")  # fmt: skip
@shared.span_options("Fit from", "Fit up to")
@click.option("--loss", type=click.Choice(["huber", "linear"]), default="huber",
              help="huber counts outliers less.")  # fmt: skip
@click.option("--starts", type=click.IntRange(1, 50), default=6,
              help="Starts of the search that are refined.")  # fmt: skip
@shared.rmse_option
@shared.log_options
@shared.output_option
@shared.json_option
@shared.quiet_option
def command(
    logs: tuple[str, ...],
    body: str | None,
    responses: tuple[str, ...],
    fixed: tuple[str, ...],
    reference: str | None,
    max_rmse: float | None,
    output: str,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Fit temperature and deflection models to measured logs.

    Any input will do, not only a step; several logs are fitted together. The model goes to -o, a
    table of the fit to stderr (with --json to stdout). With --body the logs say what its films,
    conductivities, heats and expansions are, about what is declared.
    """
    from thermaltool import api
    from thermaltool.api.calibration import check_reduce

    shared.check_files(output, *logs, body, as_json=as_json)
    if body is not None:
        shared.refuse_given(_OF_RESPONSES, "has no meaning beside --body: the mesh has its own")
    elif not options["drives"]:
        raise click.UsageError("calibrate needs --drive, or --body with the model of a body")
    kinds = dict(shared.pair_of(item, "--response") for item in responses)
    named = dict(shared.pair_of(item, "--fix") for item in fixed)
    constants = {name: shared.number_of(value, "--fix") for name, value in named.items()}
    given = {name: options[name] for name in ("linear", "loss", "starts", "joint")}
    given |= {"kinds": kinds, "fixed": constants}
    with shared.usage_errors():
        check_reduce(options["reduce"], len(options["drives"]), **given)
    progress = terminal_progress("calibrate")
    fit: Any
    if body is not None:
        own = {name: value for name, value in options.items() if name not in _OF_RESPONSES}
        fit = api.calibrate_body(body, logs, warn=warn, **own)
        progress("done\n")
    else:
        fit = api.calibrate(logs, **options, kinds=kinds, fixed=constants,
                            reference=shared.reference_of(reference), warn=warn,
                            progress=progress)  # fmt: skip
    # The file last: where anything before it fails, the old one stays.
    document, table, notes = fit.document(), fit.table(), fit.notes
    api.write_model(fit.model, output, command_line())
    if as_json:
        write_json(document, "-")
    elif not quiet:
        warn(table)
    for sentence in notes if not quiet else ():
        warn(sentence)
    if max_rmse is not None and fit.exceeds(max_rmse):
        sys.exit(DID_NOT_PASS)
