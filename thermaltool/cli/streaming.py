"""What the streaming commands share: types of options, formats by the registries, and the run."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared
from thermaltool.cli.ends import take_signals
from thermaltool.cli.types import DURATION, PositionType
from thermaltool.documents import source_name
from thermaltool.errors import LogError, OutputError, ThermalToolError
from thermaltool.logs.formats import FORMATS
from thermaltool.runtime.rows import ROW_FORMATS
from thermaltool.runtime.sinks import RECORDING_SINKS, SINKS

if TYPE_CHECKING:
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.process import Process
    from thermaltool.runtime.settings import Settings

# Readings that end within so many seconds of their reader's machine have ended with it.
END_WITHIN = 1.0


class Once(click.Option):
    """An option that is refused where it is given twice: else the last one would win."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        parser.add_option(obj=self, opts=self.opts, dest=self.name, action="append")

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> Any:
        given = opts.get(str(self.name), ())
        if len(given) > 1:
            raise click.BadParameter(f"{', '.join(given)}: there can be one only", ctx, self)
        return super().consume_value(ctx, {**opts, str(self.name): given[0]} if given else opts)


# How the lines that are written look.
text_options = shared.together(
    click.option("--no-header", is_flag=True, help="CSV without the line of names."),
    click.option("--template", metavar="TEXT",
                 help="Lines of this form: 'Z={offset_z_mm:.4f}', with names that are written (in "
                 "their unit or another), {time}, {time_s} and {status}."),
)  # fmt: skip
# How lines are read and written.
line_options = shared.together(
    shared.columns_option,
    click.option("--from", "from_format", type=click.Choice(list(ROW_FORMATS)), default="csv",
                 help="Format of the input."),
    click.option("--to", "to_format", type=click.Choice(
        [name for name in SINKS if name not in RECORDING_SINKS]), default="csv",
                 help="Format of the output."),
    text_options,
)  # fmt: skip


# Of a command that also runs in batch: what either can write.
to_option = click.option(
    "--to",
    "to_format",
    type=click.Choice(list(dict.fromkeys([*FORMATS, *SINKS]))),
    help="Format of stdout (a file's format follows its suffix).  [default: csv]",
)


short_options = shared.together(shared.json_lines_option, shared.quiet_option)

# Where the state is kept, and how often.
checkpoint_options = shared.together(
    click.option("--checkpoint", type=click.Path(dir_okay=False), metavar="FILE",
                 help="Keep the state here; a restart goes on from it."),
    click.option("--checkpoint-every", type=DURATION, metavar="S", default=10.0,
                 help="Time between two states kept [s]."),
    click.option("--checkpoint-max-age", type=DURATION, metavar="S", default=3600.0,
                 help="An older state is not gone on from [s]."),
)  # fmt: skip


# What is written beside the setpoints.
also_options = shared.together(
    click.option("--also", type=click.Choice(["estimates", "status", "bands"]), multiple=True,
                 help="Add columns: heat and deflections (the power wanted and the output); what "
                 "lines rest on: ok, settles, held, reduced, safe, extrapolates, resumed, parted, "
                 "saturated, fault, old-plan; standard errors sigma_..., and the alarm, whether "
                 "model and machine have parted: quiet, parted, untested, not possible."),
    click.option("--lag", type=DURATION, metavar="S",
                 help="Add columns late_...: estimates of so long ago [s], which have seen the "
                 "readings since; 0 until there are any."),
)  # fmt: skip
# A heater that is set in place of offsets.
heater_options = shared.together(
    click.option("--heater", cls=Once, metavar="CHANNEL",
                 help="Set this drive, a heater, in place of offsets."),
    click.option("--target", metavar="OUTPUT",
                 help="What the heater holds at zero.  [default: the only deflection]"),
    click.option("--lead", type=DURATION, metavar="S", help="How far it is foretold for the "
                 "heater, beyond its delay [s].  [default: 2 sample periods]"),
)  # fmt: skip


# Where the actuators stand, which readings are believed, and what is noted of it.
actuating_options = shared.together(
    click.option("--at", type=PositionType(), multiple=True,
                 help="Where the actuators stand at the start [um].  [default: as the "
                 "checkpoint's last line, else --safe]"),
    click.option("--trust-sensors", "trust", is_flag=True,
                 help="Take every reading in range: no test of its rate, of its noise, or against "
                 "other sensors."),
    click.option("--audit", type=click.Path(dir_okay=False), metavar="FILE",
                 help="Append every change of state to this file, as NDJSON."),
    click.option("--end", type=click.Choice(["safe", "ramp", "hold"]), default="safe",
                 help="The last line, whatever ends the stream: the safe setpoint at once, or at "
                 "--slew, or none, so that the last setpoint stays."),
)  # fmt: skip


def check_heater(options: Mapping[str, Any], controller: bool = False) -> None:
    """Raise UsageError where options for a heater, offsets and a controller are mixed."""
    if controller:
        shared.refuse_given(
            ("heater", "target", "lead", "limits", "slew"),
            "is in the controller: give it to design",
        )
    elif options["heater"] is None:
        if options["target"] or options["lead"]:
            raise click.UsageError("--target and --lead go with --heater")
        return
    if "bands" in options["also"] or options["lag"]:
        raise click.UsageError("--lag and --also bands are for offsets: a heater has no estimate")
    if options["sign"] != "-1":
        raise click.UsageError("--sign is for offsets: it does not go with --heater")
    if options["end"] == "hold":
        raise click.UsageError("--end hold is for offsets: a heater that is held stays on")
    if options["safe"] != 0:
        raise click.UsageError("--safe is for offsets: the safe setpoint of a heater is no power")


def settings_of(options: dict[str, Any], **changed: Any) -> Settings:
    """Settings from the options of a stream, with what the command has changed."""
    from thermaltool.runtime.settings import Settings

    if options.get("as_json"):
        changed["to_format"] = "ndjson"
    if (template := options.get("template")) is not None:
        if shared.is_given("to_format") and options["to_format"] != "template":
            raise click.UsageError(f"--template is a format: not with --to {options['to_format']}")
        if options["no_header"]:
            raise click.UsageError("--no-header is for CSV: lines of a template have none")
        changed["to_format"] = "template"
        changed["status"] = changed.get("status") or "{status" in template
    if options.get("no_header"):
        if changed.get("to_format", options.get("to_format")) not in (None, "csv"):
            raise click.UsageError("--no-header is for CSV: other formats have none")
        changed["header"] = False
    if options.get("safe") == "hold":
        changed["safe"] = None
    names = [name for name in Settings.__dataclass_fields__ if options.get(name) is not None]
    return Settings(**{name: options[name] for name in names} | changed)


def run(
    command: str,
    log: str,
    quiet: int,
    settings: Settings,
    make: Callable[[Messages], Process],
    closed_loop: bool = False,
    refused: Callable[[], list[str]] = list,
) -> None:
    """Run the process that `make` makes over the lines of LOG; exits by the signal that came.

    Where `make` refuses a file, the set points that are `refused` get their safe line. In a closed
    loop the machine that reads the answers ends first, and its readings with it: that is no error.
    """
    from thermaltool.cli.messages import background_emitter
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.refusal import write_safe_line
    from thermaltool.runtime.stream import open_stream

    if sys.stdout is None:
        raise OutputError("<stdout>: closed")
    if log == "-" and sys.stdin is None:
        write_safe_line(refused(), settings, 1, 1)
        raise LogError("closed", "<stdin>")
    with background_emitter(command, quiet) as emit:
        messages = Messages(emit, source_name(log))
        # Refused, or a signal before the stream looks after signals itself.
        with _or_safe_line(refused, settings):
            take_signals()
            opened = click.open_file(log, "rb")
        with opened as source:
            with shared.usage_errors(), _or_safe_line(refused, settings, source.fileno()):
                process = make(messages)
                stream = open_stream(process, settings, source.fileno(), 1, messages)
            try:
                number = stream.run()
            except BrokenPipeError:
                if not (closed_loop and _at_end(source.fileno())):
                    raise
                number = 0
    if number:
        raise SystemExit(128 + number)


@contextlib.contextmanager
def _or_safe_line(
    refused: Callable[[], list[str]], settings: Settings, source: int = 1
) -> Iterator[None]:
    """Write the safe line of the set points that are `refused` where no stream begins."""
    from thermaltool.runtime.refusal import write_safe_line

    try:
        yield
    except (ThermalToolError, ImportError, SystemExit, KeyboardInterrupt):
        write_safe_line(refused(), settings, source, 1)
        raise


def _at_end(source: int) -> bool:
    """Whether the readings end, too, within a moment."""
    readable, _, _ = select.select([source], [], [], END_WITHIN)
    return bool(readable) and not os.read(source, 1)
