"""``thermaltool plant``: write a test log from a simulated machine."""

from __future__ import annotations

import os
import stat
from typing import Any

import click
from click.core import ParameterSource

from thermaltool.cli import shared
from thermaltool.cli.progress import terminal_progress
from thermaltool.cli.types import DELAY, DURATION, NOT_NEGATIVE, NUMBER, POSITIVE
from thermaltool.plants import PLANTS, SettingError

BAR, MILL, HEATED = "boring-bar", "knee-mill", "quill, c-frame"
# Options of the clock where none is given [s].
FRAME, PAIR, CUT, JOINT = (PLANTS[name].usual for name in ("frame", "quill", BAR, MILL))


@click.command(
    epilog="Example: thermaltool plant frame --input triangle --duration 1800 | thermaltool check -"
)
@click.argument("name", type=click.Choice(list(PLANTS)))
@click.option("--input", "shape", default="step", metavar="step|idle|triangle|duty|FILE",
              help="Heat: a shape, or a log with Q_main_1 (and T_ambient_degC), held between its "
              f"rows; {HEATED}: step, A, B, quick, mixed, or a log with Q_causal_W, "
              "Q_stabilization_W.")  # fmt: skip
@click.option("--level", type=NOT_NEGATIVE, default=1.0, help="Factor on the heat [1].")
@click.option("--start", type=DELAY,
              help=f"Idle time before the input [s].  [default: {FRAME['start']:g}; {HEATED}: "
              f"{PAIR['start']:g}]")  # fmt: skip
@click.option("--duration", type=DURATION,
              help=f"Length, idle time included [s].  [default: {FRAME['duration']:g}; {BAR}: "
              f"{CUT['duration']:g}; {HEATED}: {PAIR['duration']:g}]")  # fmt: skip
@click.option("--dt", type=DURATION,
              help=f"Sample period [s].  [default: {FRAME['dt']:g}; {MILL}: {JOINT['dt']:g}; "
              f"{HEATED}: {PAIR['dt']:g}]")  # fmt: skip
@click.option("--ambient", type=NUMBER, default=20.0, help="Air temperature [degC].")
@click.option("--seed", type=click.IntRange(min=0), default=1, help="Seed of noise and of duty.")
@click.option("--sigma", type=NOT_NEGATIVE, default=0.02, help="White noise of temperatures [K].")
@click.option("--drift", type=NOT_NEGATIVE, default=0.008, help="Drift of temperatures [K].")
@click.option("--drift-time", type=DURATION, default=900.0, help="Time constant of drift [s].")
@click.option("--sigma-d", type=NOT_NEGATIVE, default=0.2, help="Noise of displacements [um].")
@click.option("--load", type=NUMBER, default=0.0,
              help=f"{MILL}: force down on the end of the table [N].")  # fmt: skip
@click.option("--clean", is_flag=True, help="The truth: no noise, no rounding.")
@click.option("--speed", type=POSITIVE, default=600.0, help=f"{BAR}: spindle [rev/min].")
@click.option("--part", type=click.Choice(["straight", "taper", "eccentric", "none"]),
              default="straight",
              help=f"{BAR}: what is cut; none leaves the piezo free, for a trial.")  # fmt: skip
@click.option("--commands", type=click.Path(exists=True, dir_okay=False), metavar="FILE",
              help=f"{BAR}: log with U_command_V; of a named pipe, one line answers each "
              "line.")  # fmt: skip
@click.option("--heater", type=click.Choice(["causal", "stabilization", "both"]),
              help=f"{HEATED}: which one is on, of a shape; both have courses of their own.  "
              "[default: causal]")  # fmt: skip
@click.option("--power", type=POSITIVE,
              help=f"{HEATED}: the largest power that is set, of a shape [W].  "
              "[default: all]")  # fmt: skip
@click.option("--swing", type=NOT_NEGATIVE, default=0.5,
              help=f"{HEATED}: drift of the air [K].")  # fmt: skip
@shared.to_option
@shared.json_lines_option
@shared.output_option
@click.pass_context
def command(
    ctx: click.Context, name: str, to_format: str | None, as_json: bool, output: str, **options: Any
) -> None:
    """Write a test log from the simulated machine NAME, from rest at the air's temperature.

    Q_main_1 acts from its row to the next. Temperatures are read to 0.001 K with white noise and
    slow drift, displacements to 0.01 um; heat, air and clock are exact.

    knee-mill has a joint that opens and closes as it warms, four temperatures down the joint, and
    takes what frame takes; it is not in proportion to its heat.

    boring-bar samples every 0.5 ms: speed, command, error as read, true deflection of the cutter
    and the trace that it cuts; of the general options it takes --duration and --seed. With
    --commands PIPE the lines on stdout are time, speed and error, each waits for its command, and
    -o FILE takes the whole log.

    quill and c-frame have two heaters behind regulators that are not straight, two temperatures and
    three displacement probes with noise of their own: step is a calibration, A holds its steps for
    8 h, B is random with quick changes at its end, quick changes within minutes, mixed at many
    rates. Of the general options they take --input, --start, --duration, --dt, --ambient, --seed
    and --clean. An option that a plant does not take is refused.
    """
    from thermaltool.errors import LogError
    from thermaltool.logs import read_log, write_table
    from thermaltool.plants.run import run

    _refuse_others(ctx, name)
    commands = options["commands"]
    if commands and output == "-" and stat.S_ISFIFO(os.stat(commands).st_mode):
        raise click.UsageError("-o FILE is needed: stdout carries the lines of the loop")
    progress = terminal_progress("plant")
    try:
        columns, fault = run(name, options, read_log, click.echo)
    except SettingError as error:
        if error.option is None:
            raise click.UsageError(str(error)) from error
        raise click.BadParameter(str(error), param_hint=error.option) from error
    progress("done\n")
    write_table(columns, output, "ndjson" if as_json else to_format)
    if fault:  # what was made until then is not lost
        raise LogError(f"{fault} are in {output}", commands)


def _refuse_others(ctx: click.Context, name: str) -> None:
    """Refuse options of other plants; those of the environment or of --config stand for any."""
    for parameter in ctx.command.params:
        option = str(parameter.name)
        typed = ctx.get_parameter_source(option) is ParameterSource.COMMANDLINE
        users = [each for each, offer in PLANTS.items() if option in offer.options]
        if typed and users and name not in users:
            raise click.UsageError(
                f"{parameter.opts[0]} is not for {name}, but for {', '.join(users)}"
            )
