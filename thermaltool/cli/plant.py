"""``thermaltool plant``: write a test log from a simulated machine."""

from __future__ import annotations

import os
from typing import Any

import click
from click.core import ParameterSource

from thermaltool.cli.options import (
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    json_lines_option,
    output_option,
    to_option,
)
from thermaltool.plants import HEATED, PLANTS

HEATERS = ("causal", "stabilization")
SHAPES = ("step", "idle", "triangle", "duty")
BORING_BAR = "boring-bar"
# Where no --duration is given [s].
USUAL_DURATION, USUAL_CUT, USUAL_START, USUAL_PERIOD = 9000.0, 4.0, 60.0, 0.5
WARMED = ", ".join(HEATED)
# What every plant takes, and what some take beside it.
COMMON = {"name", "duration", "seed", "to_format", "as_json", "output"}
ROOM = {"shape", "start", "dt", "ambient", "clean"}
TAKEN = {
    **dict.fromkeys(PLANTS, ROOM | {"level", "sigma", "drift", "drift_time", "sigma_d"}),
    **dict.fromkeys(HEATED, ROOM | {"heater", "power", "swing"}),
    BORING_BAR: {"speed", "part", "commands"},
}


@click.command(
    epilog="Example: thermaltool plant frame --input triangle --duration 1800 | thermaltool check -"
)
@click.argument("name", type=click.Choice([*PLANTS, *HEATED, BORING_BAR]))
@click.option(
    "--input",
    "shape",
    default="step",
    metavar="|".join((*SHAPES, "FILE")),
    help="Heat: a shape, or a log with Q_main_1 (and T_ambient_degC), held between its rows; "
    f"{WARMED}: step, A, B, quick, mixed, or a log with Q_causal_W, Q_stabilization_W.",
)
@click.option("--level", type=NOT_NEGATIVE, default=1.0, help="Factor on the heat [1].")
@click.option("--start", type=NOT_NEGATIVE,
              help=f"Idle time before the input [s].  [default: {USUAL_START:g}; {WARMED}: "
              "1800]")  # fmt: skip
@click.option(
    "--duration",
    type=POSITIVE,
    help=f"Length, idle time included [s].  [default: {USUAL_DURATION:g}; {BORING_BAR}: "
    f"{USUAL_CUT:g}; {WARMED}: 43200]",
)
@click.option("--dt", type=POSITIVE,
              help=f"Sample period [s].  [default: {USUAL_PERIOD:g}; {WARMED}: 60]")  # fmt: skip
@click.option("--ambient", type=NUMBER, default=20.0, help="Air temperature [degC].")
@click.option("--seed", type=click.IntRange(min=0), default=1, help="Seed of noise and of duty.")
@click.option("--sigma", type=NOT_NEGATIVE, default=0.02, help="White noise of temperatures [K].")
@click.option("--drift", type=NOT_NEGATIVE, default=0.008, help="Drift of temperatures [K].")
@click.option("--drift-time", type=POSITIVE, default=900.0, help="Time constant of drift [s].")
@click.option("--sigma-d", type=NOT_NEGATIVE, default=0.2, help="Noise of displacements [um].")
@click.option("--clean", is_flag=True, help="The truth: no noise, no rounding.")
@click.option("--speed", type=POSITIVE, default=600.0, help=f"{BORING_BAR}: spindle [rev/min].")
@click.option(
    "--part",
    type=click.Choice(["straight", "taper", "eccentric", "none"]),
    default="straight",
    help=f"{BORING_BAR}: what is cut; none leaves the piezo free, for a trial.",
)
@click.option(
    "--commands",
    type=click.Path(exists=True, dir_okay=False),
    metavar="FILE",
    help=f"{BORING_BAR}: log with U_command_V; of a named pipe, one line answers each line.",
)
@click.option("--heater", type=click.Choice([*HEATERS, "both"]),
              help=f"{WARMED}: which one is on, of a shape; both have courses of their own.  "
              "[default: causal]")  # fmt: skip
@click.option("--power", type=POSITIVE,
              help=f"{WARMED}: the largest power that is set, of a shape [W].  "
              "[default: all]")  # fmt: skip
@click.option("--swing", type=NOT_NEGATIVE, default=0.5,
              help=f"{WARMED}: drift of the air [K].")  # fmt: skip
@to_option
@json_lines_option
@output_option
@click.pass_context
def command(
    ctx: click.Context,
    name: str,
    shape: str,
    level: float,
    start: float | None,
    duration: float | None,
    dt: float | None,
    ambient: float,
    seed: int,
    sigma: float,
    drift: float,
    drift_time: float,
    sigma_d: float,
    clean: bool,
    speed: float,
    part: str,
    commands: str | None,
    heater: str | None,
    power: float | None,
    swing: float,
    to_format: str | None,
    as_json: bool,
    output: str,
) -> None:
    """Write a test log from the simulated machine NAME, from rest at the air's temperature.

    Q_main_1 acts from its row to the next. Temperatures are read to 0.001 K with white noise and
    slow drift, displacements to 0.01 um; heat, air and clock are exact.

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
    _refuse_others(ctx, name)
    form = "ndjson" if as_json else to_format
    if name in HEATED:
        from thermaltool.cli.heaters import write_heated

        write_heated(name, shape, heater, power, (duration, start, dt), (ambient, swing), seed,
                     clean, output, form)  # fmt: skip
        return
    if name == BORING_BAR:
        from thermaltool.cli.boring_bar import write_cut

        write_cut(part, speed, duration or USUAL_CUT, seed, commands, output, form)
        return
    import numpy as np

    from thermaltool.logs import write_table
    from thermaltool.plants import build
    from thermaltool.plants.excitation import INPUTS, hold
    from thermaltool.plants.noise import Sensor, read_sensors

    dt, start = dt or USUAL_PERIOD, USUAL_START if start is None else start
    time = clock(duration or USUAL_DURATION, dt)
    air = np.full_like(time, ambient)
    if shape in INPUTS:
        heat = INPUTS[shape](time - start, seed)
    else:
        log = read_input(shape, SHAPES, ("Q_main_1",))
        elapsed = log.time - log.time[0] + start
        heat = hold(time, elapsed, log.column("Q_main_1"), before=0.0)
        if "T_ambient_degC" in log.columns:
            measured = log.column("T_ambient_degC")
            air = hold(time, elapsed, measured, before=measured[0])
    heat = np.round(level * heat, 6)
    columns = build(name).simulate(heat, air, dt)
    if not clean:
        temperature = Sensor(sigma, drift, drift_time, decimals=3)
        sensors = {"degC": temperature, "K": temperature, "um": Sensor(sigma_d, decimals=2)}
        columns = read_sensors(columns, sensors, dt, seed)
    table = {"time_s": time, "Q_main_1": heat, "T_ambient_degC": air, **columns}
    write_table(table, output, form)


def _refuse_others(ctx: click.Context, name: str) -> None:
    """Refuse options of other plants; those of the environment or of --config stand for any."""
    for parameter in ctx.command.params:
        given = ctx.get_parameter_source(str(parameter.name)) is ParameterSource.COMMANDLINE
        if given and parameter.name not in COMMON | TAKEN[name]:
            users = ", ".join(plant for plant, own in TAKEN.items() if parameter.name in own)
            raise click.UsageError(f"{parameter.opts[0]} is not for {name}, but for {users}")


def clock(duration: float, dt: float) -> Any:
    """The times of a log, two at least."""
    from thermaltool.plants.excitation import sample_times

    if duration < dt:
        raise click.BadParameter(
            f"{duration:g} s is shorter than the sample period of {dt:g} s",
            param_hint="--duration",
        )
    return sample_times(duration, dt)


def read_input(source: str, shapes: tuple[str, ...], need: tuple[str, ...]) -> Any:
    """The log that ``--input`` names."""
    from thermaltool.errors import LogError
    from thermaltool.logs import read_log

    if source != "-" and not os.path.exists(source):
        raise click.BadParameter(
            f"{source!r} is no file and none of {', '.join(shapes)}", param_hint="--input"
        )
    log = read_log(source, need=need)
    if not len(log):
        raise LogError("no rows to take the heat from", log.name)
    return log
