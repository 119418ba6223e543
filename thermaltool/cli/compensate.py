"""``thermaltool compensate``: sensor lines in, setpoint lines out."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared, streaming
from thermaltool.cli.types import (
    DELAY,
    DURATION,
    AmountType,
    IntervalType,
    SafeType,
    positions_of,
)

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.process import Process


@click.command(epilog="Example: tail -n +1 -f temps.csv | thermaltool compensate model.json")
@shared.model_argument
@shared.log_argument
@streaming.line_options
@click.option("--period", type=DURATION, metavar="S",
              help="Period of an input without a clock [s].")  # fmt: skip
@click.option("--clock", type=click.Choice(["column", "arrival"]), default="column",
              help="Time from the input, or of its arrival (to 1 ms).")  # fmt: skip
@streaming.heater_options
@streaming.also_options
@click.option("--sign", type=click.Choice(["-1", "1"]), default="-1",
              help="Setpoint over deflection: -1 for an offset that cancels it.")  # fmt: skip
@click.option("--hold", type=DURATION, metavar="S",
              help="Bad readings are replaced by the last good one for this long [s]; then comes "
              "the safe setpoint.  [default: 10, at least 10 sample periods of the design]"
)  # fmt: skip
@click.option("--frozen-after", type=DURATION, metavar="S", show_default="never",
              help="A reading identical for longer than this is bad [s]; commanded columns may "
              "stand still.")  # fmt: skip
@click.option("--range", "ranges", type=IntervalType(channel=True), multiple=True,
              help="Readings outside are bad.  [default: calibrated range, widened by its width]"
)  # fmt: skip
@click.option("--max-gap", type=DURATION, metavar="S",
              help="A longer pause is reported, and counts as this long for --slew [s].  [default: "
              "as --hold, and 2 sample periods for --slew]")  # fmt: skip
@click.option("--timeout", type=DELAY, metavar="S",
              help="Without a usable line for this long [s] the safe setpoint is written; 0 never."
              "  [default: as --hold]")  # fmt: skip
@click.option("--limit", "limits", type=IntervalType(), default=":",
              help="Range of the setpoints [unit of the deflection]; a heater's is 0 to what the "
              "calibration has seen [W]."
)  # fmt: skip
@click.option("--slew", type=AmountType("RATE", above=True),
              help="Largest rate of the setpoints, with its unit: 10um/s.  [default: 10um/s, of a "
              "heater 10 W/s]")  # fmt: skip
@click.option("--step", type=AmountType("STEP"),
              help="Step of the setpoints, with its unit, and a hysteresis of a quarter step; 0 "
              "for none.  [default: 0.5um, of a heater 0.5 W]")  # fmt: skip
@click.option("--safe", type=SafeType(), default="zero",
              help="Setpoint while readings are lost and at the end: the last one, or a value "
              "[unit of the deflection]; not with --heater.")  # fmt: skip
@streaming.actuating_options
@streaming.checkpoint_options
@shared.initial_option
@streaming.short_options
def command(model: str, log: str, **options: Any) -> None:
    """Setpoints from sensor lines: one line in, one line out, at once.

    MODEL is a file from regularize; LOG is read line by line: the sensors, and the columns that
    measured drives and effects of the model need (regularize names them). Readings that are bad
    (text, NaN, out of range, frozen, faster than the machine) are held, then the safe setpoint is
    written until good ones return; one of several sensors is left out. The safe setpoint is also
    the last line, whatever ends the stream, at once (see --end); it is approached at --slew before.
    Each deflection d_PLACE_um gives a column offset_PLACE_um; --limit and --safe count in its unit,
    --slew and --step, too, where they have none.

    With --heater MODEL is one from identify, correct, schedule or superpose: LOG has its other
    drives, and the power of the heater comes out that brings --target to zero after --lead, for the
    limits that it has. Here the safe setpoint is no power. So it is where MODEL is a controller of
    design: LOG has its sensors, and the mean power of each heater since the line before.
    """
    from thermaltool.api.inputs import read_sealed
    from thermaltool.control.controller import HeaterController
    from thermaltool.runtime.compensation import controlled_heaters, heater_power, offsets
    from thermaltool.runtime.refusal import refused_setpoints

    shared.check_files(None, model, log)
    heater, settled = options["heater"], options["initial"] == "settled"
    streaming.check_heater(options)
    counted = options["period"] and options["clock"] == "column"
    settings = streaming.settings_of(
        options,
        clock="count" if counted else options["clock"],
        ranges=dict(options["ranges"]),
        **dict.fromkeys(options["also"], True),
        slew=options["slew"],
        step=options["step"],
        at=positions_of(options["at"]),
    )

    def process(messages: Messages) -> Process:
        machine, digest_of_file = read_sealed(model)
        if isinstance(machine, HeaterController):
            streaming.check_heater(options, controller=True)
            process = controlled_heaters(machine, settings, messages, settled)
        elif heater is None:
            process = offsets(machine, settings, messages, float(options["sign"]), settled)
        else:
            held = options["target"], options["lead"]
            process = heater_power(machine, settings, messages, heater, *held, settled)
        process.title = f"{model} (sha256 {digest_of_file()[:12]})"
        return process

    refused = partial(refused_setpoints, model, heater)
    streaming.run("compensate", log, options["quiet"], settings, process, refused=refused)
