"""``thermaltool design``: from a model and control drives to a controller."""

from __future__ import annotations

from typing import Any

import click

from thermaltool.cli import shared
from thermaltool.cli.messages import warn
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DURATION, POSITIVE, Assignment, ControlType
from thermaltool.control.methods import METHODS
from thermaltool.documents import write_json


@click.command(
    epilog="Example: thermaltool regularize model.json --noise noise.json --measured Q_top_W "
    "--form kalman | thermaltool design - --control Q_top_W:250 -o controller.json"
)
@shared.model_argument
@click.option("--control", "controls", type=ControlType(), multiple=True, required=True,
              metavar="CHANNEL[:MAX]",
              help="This drive, a heater, is set between 0 and MAX.  [default: what the "
              "calibration has seen]")  # fmt: skip
@click.option("--method", type=click.Choice(METHODS), default=METHODS[0],
              help="Heats planned within the limits; linear quadratic regulators with Bryson's "
              "weights; feed-forward.")  # fmt: skip
@click.option("--hold", "outputs", metavar="OUTPUT", multiple=True,
              help="Hold this deflection at zero.  [default: all]")  # fmt: skip
@click.option("--tolerance", "tolerances", type=Assignment(), metavar="OUTPUT=VALUE", multiple=True,
              help="Deviation that counts as much as one of this size of another output, and for a "
              "regulator as full power [unit of the output].  [default: 1 % of the range of "
              "the calibration]")  # fmt: skip
@click.option("--axis", "axes", type=Assignment(), metavar="OUTPUT=RANGE", multiple=True,
              help="An NC axis corrects this deflection by up to RANGE, up and down: heat is "
              "planned for what goes beyond [unit of the output].")  # fmt: skip
@click.option("--slew", type=POSITIVE, metavar="RATE",
              help="Largest rate of the setpoints [unit of the drive per s].  [default: 10]"
)  # fmt: skip
@click.option("--horizon", type=DURATION, metavar="S",
              help="How far the heats are planned [s].  [default: the slowest time constant of "
              "the control drives]")  # fmt: skip
@click.option("--duration", type=DURATION, metavar="S",
              help="How long the machine works from the first line on: the plan ends there, and "
              "holds the band over all of it [s].")  # fmt: skip
@click.option("--lead", type=DURATION, metavar="S",
              help="When the inversion is at zero [s].  [default: 2 sample periods]"
)  # fmt: skip
@shared.output_option
@shared.json_option
@shared.quiet_option
def command(
    model: str,
    controls: tuple[tuple[str, float | None], ...],
    tolerances: tuple[tuple[str, float], ...],
    axes: tuple[tuple[str, float], ...],
    output: str,
    as_json: bool,
    quiet: int,
    **options: Any,
) -> None:
    """Design a controller of heaters, which compensate runs.

    MODEL is a file from regularize --measured with each control drive: the estimator reads what the
    heaters deliver. The controller goes to -o; what it does on its own model after the largest step
    of each disturbance goes to stderr (with --json to stdout), with the heat that would have to be
    taken away where a method asks for it.

    The default method plans heats between nothing and full power, and so for the time that a heater
    needs to cool; the others cut off what they ask for.
    """
    from thermaltool import api
    from thermaltool.api.result import silent

    shared.check_files(None, model)
    shared.check_files(output, as_json=as_json)
    for method, needed in (
        ("receding-horizon", ("horizon", "duration", "axes")),
        ("inversion", ("lead",)),
    ):
        if options["method"] != method:
            shared.refuse_given(needed, f"is of --method {method}")
    given = {name: value for name, value in options.items() if value is not None}
    progress = terminal_progress("design")
    with shared.usage_errors():
        result = api.design(model, dict_of(controls, "--control"),
                            tolerance=dict_of(tolerances, "--tolerance"),
                            axes=dict_of(axes, "--axis"), **given,
                            warn=silent if quiet else warn)  # fmt: skip
    progress("done\n")
    table = result.table()
    if as_json:
        write_json(result.document(), "-")
    write_json(result.design.controller.document(), output)
    if not as_json and not quiet:
        warn(table)


def dict_of(pairs: tuple[tuple[str, Any], ...], option: str) -> dict[str, Any]:
    """Pairs as a mapping; UsageError where a name is there twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise click.UsageError(f"{option} takes each name once")
    return found
