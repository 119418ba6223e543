"""``thermaltool fcc``: error lines in, commands that act ahead of their own delay out."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared, streaming
from thermaltool.cli.actuator import actuator_of, actuator_options
from thermaltool.cli.types import (
    DELAY,
    DURATION,
    FORGETTING,
    NOT_NEGATIVE,
    POSITIVE,
    ErrorModelType,
    IntervalType,
    SafeType,
)

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.process import Process

# What nothing is known of is forecast best by a long AR model (docs/how-to/fcc.md).
USUAL_ORDER = 20, 0


@click.command(
    epilog="Example: gauge | thermaltool fcc -C e_tool_um --period 0.0005 --delay 0.0025 "
    "--gain 1.5 --limit=-2:10 | amplifier"
)
@shared.log_argument
@click.option("-C", "--column", "channel", required=True, metavar="NAME", help="Column: the error.")
@click.option("--command", default="U_command_V", metavar="NAME",
              help="Name of the command, with its unit.")  # fmt: skip
@click.option("--period", type=DURATION, required=True, metavar="S", help="Sample period [s].")
@actuator_options
@click.option("--error-model", type=ErrorModelType(),
              help="Forecast directly at the horizon, or iterated from AR(P) or ARMA(P,Q)."
              f"  [default: direct with --spindle, else {USUAL_ORDER[0]}]")  # fmt: skip
@click.option("--spindle", metavar="RPM|NAME",
              help="Speed or its column: what repeats is learnt [rev/min].")  # fmt: skip
@click.option("--harmonics", type=click.IntRange(0, 50), default=6,
              help="Waves per revolution that repeat.")  # fmt: skip
@click.option("--horizon", type=click.IntRange(0), default=0, help="Samples ahead at which the "
              "error is to be zero; 0 where half an action has come.")  # fmt: skip
@click.option("--forgetting", type=FORGETTING, default=0.999,
              help="Weight of a sample against the next; 1 never forgets.")  # fmt: skip
@streaming.line_options
@click.option("--clock", type=click.Choice(["column", "none"]), default="column",
              help="Time from the input, or one period per line.")  # fmt: skip
@click.option("--limit", "limits", type=IntervalType(), default=":",
              help="Range of the commands.")  # fmt: skip
@click.option("--slew", type=POSITIVE, help="Largest rate of the commands [per s].")
@click.option("--step", type=NOT_NEGATIVE, default=0.0, help="Step of the commands; 0 for none.")
@click.option("--safe", type=SafeType(), default="zero",
              help="Command while readings are lost, and at the end.")  # fmt: skip
@click.option("--hold", type=DURATION, metavar="S",
              help="The forecast bridges bad readings for this long [s]; then comes the safe "
              "command.  [default: 20 periods]")  # fmt: skip
@click.option("--max-gap", type=DURATION, metavar="S", help="A longer pause is told, and lags are "
              "forgotten [s].  [default: 20 periods]")  # fmt: skip
@click.option("--timeout", type=DELAY, metavar="S",
              help="Without a usable line for this long [s] the safe command is written; 0 never."
              "  [default: 20 periods, at least 0.1]")  # fmt: skip
@click.option("--range", "bounds", type=IntervalType(), default=":",
              help="Readings outside are bad.")  # fmt: skip
@click.option("--also", is_flag=True, help="Add columns: wanted, uncompensated, forecast.")
@streaming.short_options
def command(log: str, channel: str, spindle: str | None, **options: Any) -> None:
    """Commands that cancel an error ahead of the delay: one line in, one line out, at once.

    The error is read with the action in it. What it would be without is reconstructed from a model
    of the actuator, forecast, and cancelled. Bad readings are bridged by the forecast; after --hold
    the safe command is written until good ones return, and it is also the last line.
    """
    from thermaltool.runtime.fcc import ErrorModel, error_control

    settings = streaming.settings_of(
        options,
        clock="count" if options["clock"] == "none" else "column",
        ranges={channel: options["bounds"]},
        estimates=options["also"],
    )
    speed: float | str | None = spindle
    with contextlib.suppress(TypeError, ValueError):
        speed = float(spindle or "")
    order: Any = options["error_model"] or ("direct" if spindle else USUAL_ORDER)
    order = None if order == "direct" else order
    error_model = ErrorModel(order, speed, options["harmonics"], options["forgetting"])

    def process(messages: Messages) -> Process:
        actuator = actuator_of(channel, options, messages.emit)
        name, horizon = options["command"], options["horizon"]
        return error_control(channel, name, actuator, error_model, settings, messages, horizon)

    streaming.run("fcc", log, options["quiet"], settings, process, closed_loop=True,
                  refused=lambda: [options["command"]])  # fmt: skip
