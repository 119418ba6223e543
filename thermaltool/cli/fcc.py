"""``thermaltool fcc``: error lines in, commands that act ahead of their own delay out."""

from __future__ import annotations

import contextlib
import os
import select
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli.compensate import FORMATS, Interval, Safe
from thermaltool.cli.options import (
    NOT_NEGATIVE,
    POSITIVE,
    columns_option,
    json_lines_option,
    log_argument,
    quiet_option,
)

if TYPE_CHECKING:
    from thermaltool.control.fcc import ActuatorModel

IDENTIFIED_PLAYS = 5
# What nothing is known of is forecast best by a long AR model (docs/fcc.md).
USUAL_ORDER = 20, 0
# A trial's clock may differ from the period by this share.
SAME_PERIOD = 0.01
# Readings that end within so many seconds of their reader's machine have ended with it.
END_WITHIN = 1.0


class Pairs(click.ParamType):
    """Numbers A:B, several of them with commas between."""

    def __init__(self, name: str, single: bool = False) -> None:
        self.name, self.single = name, single

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        with contextlib.suppress(ValueError):
            pairs = [tuple(map(float, part.split(":"))) for part in value.split(",")]
            if all(len(pair) == 2 for pair in pairs) and (len(pairs) == 1 or not self.single):
                return pairs[0] if self.single else pairs
        self.fail(f"{value!r} is not {self.name}", param, ctx)


class ErrorModel(click.ParamType):
    name = "direct|P|P,Q"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "direct" or not isinstance(value, str):
            return value
        with contextlib.suppress(ValueError):
            p, _, q = value.partition(",")
            if int(p) >= 0 <= int(q or 0) and int(p) + int(q or 0):
                return int(p), int(q or 0)
        self.fail(f"{value!r} is not {self.name}", param, ctx)


@click.command(
    epilog="Example: gauge | thermaltool fcc -C e_tool_um --period 0.0005 --delay 0.0025 "
    "--gain 1.5 --limit=-2:10 | amplifier"
)
@log_argument
@click.option("-C", "--column", "channel", required=True, metavar="NAME", help="Column: the error.")
@click.option(
    "--command", default="U_command_V", metavar="NAME", help="Name of the command, with its unit."
)
@click.option("--period", type=POSITIVE, required=True, metavar="S", help="Sample period [s].")
@click.option(
    "--delay",
    type=NOT_NEGATIVE,
    metavar="S",
    help="Of measuring, computing and acting, low-pass aside [s].",
)
@click.option("--gain", type=POSITIVE, help="Error per unit of the command.  [default: 1]")
@click.option(
    "--low-pass",
    type=Pairs("OMEGA:DAMPING", single=True),
    metavar="OMEGA:DAMPING",
    help="Second-order low-pass between command and reading [rad/s].  [default: none]",
)
@click.option(
    "--hysteresis",
    type=Pairs("R:W,R:W,..."),
    metavar="R:W,R:W,...",
    help="Plays of the actuator in place of --gain: thresholds from 0 up, in units of the command, "
    "and their weights.",
)
@click.option(
    "--identify",
    type=click.Path(exists=True, dir_okay=False),
    metavar="LOG",
    help="Log of a trial with the columns of error and command: gives --delay and --hysteresis.",
)
@click.option(
    "--error-model",
    type=ErrorModel(),
    help="Forecast directly at the horizon, or iterated from AR(P) or ARMA(P,Q)."
    f"  [default: direct with --spindle, else {USUAL_ORDER[0]}]",
)
@click.option(
    "--spindle", metavar="RPM|NAME", help="Speed or its column: what repeats is learnt [rev/min]."
)
@click.option(
    "--harmonics", type=click.IntRange(0, 50), default=6, help="Waves per revolution that repeat."
)
@click.option(
    "--horizon",
    type=click.IntRange(0),
    default=0,
    help="Samples ahead at which the error is to be zero; 0 where half an action has come.",
)
@click.option(
    "--forgetting",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.999,
    help="Weight of a sample against the next; 1 never forgets.",
)
@columns_option
@click.option("--from", "from_format", type=FORMATS, default="csv", help="Format of the input.")
@click.option("--to", "to_format", type=FORMATS, default="csv", help="Format of the output.")
@click.option(
    "--clock",
    type=click.Choice(["column", "none"]),
    default="column",
    help="Time from the input, or one period per line.",
)
@click.option("--limit", "limits", type=Interval(), default=":", help="Range of the commands.")
@click.option("--slew", type=POSITIVE, help="Largest rate of the commands [per s].")
@click.option("--step", type=NOT_NEGATIVE, default=0.0, help="Step of the commands; 0 for none.")
@click.option(
    "--safe", type=Safe(), default="zero", help="Command while readings are lost, and at the end."
)
@click.option(
    "--hold",
    type=POSITIVE,
    metavar="S",
    help="The forecast bridges bad readings for this long [s]; then comes the safe command."
    "  [default: 20 periods]",
)
@click.option(
    "--max-gap",
    type=POSITIVE,
    metavar="S",
    help="A longer pause is told, and lags are forgotten [s].  [default: 20 periods]",
)
@click.option(
    "--timeout",
    type=NOT_NEGATIVE,
    metavar="S",
    help="Without a usable line for this long [s] the safe command is written; 0 never."
    "  [default: 20 periods, at least 0.1]",
)
@click.option("--range", "bounds", type=Interval(), default=":", help="Readings outside are bad.")
@click.option("--also", is_flag=True, help="Add columns: wanted, uncompensated, forecast.")
@json_lines_option
@quiet_option
def command(log: str, **options: Any) -> None:
    """Commands that cancel an error ahead of the delay: one line in, one line out, at once.

    The error is read with the action in it. What it would be without is reconstructed from a model
    of the actuator, forecast, and cancelled. Bad readings are bridged by the forecast; after --hold
    the safe command is written until good ones return, and it is also the last line.
    """
    # One small product per line: threads would only cost memory. Read when numpy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from thermaltool.cli.messages import emitter
    from thermaltool.cli.options import usage_errors
    from thermaltool.runtime.fcc import FccSettings, open_fcc

    emit = emitter("fcc", options.pop("quiet"))
    chosen: Any = options.pop("error_model") or ("direct" if options["spindle"] else USUAL_ORDER)
    order = None if chosen == "direct" else chosen
    safe, slew, timeout = options.pop("safe"), options.pop("slew"), options.pop("timeout")
    if options.pop("as_json"):
        options["to_format"] = "ndjson"
    name = "<stdin>" if log == "-" else log
    with click.open_file(log, "rb") as source:
        with usage_errors():
            settings = FccSettings(
                actuator=_actuator(options, emit),
                order=order,
                spindle=_spindle(options.pop("spindle")),
                safe=None if safe == "hold" else safe,
                slew=float("inf") if slew is None else slew,
                timeout=max(20 * options["period"], 0.1) if timeout is None else timeout,
                has_clock=options.pop("clock") == "column",
                **options,
            )
            stream, controller = open_fcc(settings, source.fileno(), 1, emit, name)
        try:
            number = stream.run()
        except BrokenPipeError:
            # The machine of a closed loop ends first, and its readings with it.
            if not _at_end(source.fileno()):
                raise
            number = 0
        finally:
            if controller.samples:
                emit(controller.summary())
    if number:
        raise SystemExit(128 + number)


def _at_end(source: int) -> bool:
    """Whether the readings end, too, within a moment."""
    readable, _, _ = select.select([source], [], [], END_WITHIN)
    return bool(readable) and not os.read(source, 1)


def _spindle(given: str | None) -> float | str | None:
    with contextlib.suppress(ValueError):
        return None if given is None else float(given)
    return given


def _actuator(options: dict[str, Any], emit: Any) -> ActuatorModel:
    """The model from options, which are taken out; parts that a trial is to tell come from it."""
    from thermaltool.control.fcc import ActuatorModel
    from thermaltool.control.hysteresis import PrandtlIshlinskii

    natural, damping = options.pop("low_pass") or (float("inf"), 0.707)
    plays, gain = options.pop("hysteresis"), options.pop("gain")
    delay, trial = options.pop("delay"), options.pop("identify")
    if plays and gain:
        raise click.UsageError("--hysteresis has its gain in its weights: leave --gain out")
    plays = plays or ([(0.0, gain)] if gain else None)
    if trial is not None and (plays is None or delay is None):
        import numpy as np

        from thermaltool.fitting.actuator import identify_actuator
        from thermaltool.logs import read_log

        table = read_log(trial, need=(options["command"], options["channel"]))
        step = float(np.median(np.diff(table.time))) if len(table) > 1 else options["period"]
        if abs(step / options["period"] - 1) > SAME_PERIOD:
            raise click.UsageError(
                f"{trial} has a sample each {step:.4g} s, --period says {options['period']:.4g} s"
            )
        found = identify_actuator(
            table.column(options["command"]),
            table.column(options["channel"]),
            options["period"],
            natural,
            damping,
            IDENTIFIED_PLAYS,
        )
        plays = plays or list(zip(found.thresholds, found.weights, strict=True))
        delay = found.delay if delay is None else delay
        told = ",".join(f"{r:.4g}:{w:.4g}" for r, w in plays)
        emit(
            f"{trial}: --delay {delay:.4g} --hysteresis {told} explain {found.explained:.1%} of "
            f"the reading's variance, {found.residual:.3g} RMS are left"
        )
    if delay is None:
        raise click.UsageError("how late does the actuator answer? give --delay or --identify")
    thresholds, weights = zip(*(plays or [(0.0, 1.0)]), strict=True)
    return ActuatorModel(PrandtlIshlinskii(thresholds, weights), delay, natural, damping)
