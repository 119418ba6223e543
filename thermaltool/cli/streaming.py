"""What the streaming commands share: types of options, formats by the registries, and the run."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from thermaltool.cli import shared
from thermaltool.cli.types import POSITIVE
from thermaltool.documents import source_name
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


# How lines are read and written.
line_options = shared.together(
    shared.columns_option,
    click.option("--from", "from_format", type=click.Choice(list(ROW_FORMATS)), default="csv",
                 help="Format of the input."),
    click.option("--to", "to_format", type=click.Choice(
        [name for name in SINKS if name not in RECORDING_SINKS]), default="csv",
                 help="Format of the output."),
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
    click.option("--checkpoint-every", type=POSITIVE, metavar="S", default=10.0,
                 help="Time between two states kept [s]."),
)  # fmt: skip


def settings_of(options: dict[str, Any], **changed: Any) -> Settings:
    """Settings from the options of a stream, with what the command has changed."""
    from thermaltool.runtime.settings import Settings

    if options.get("as_json"):
        changed["to_format"] = "ndjson"
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
) -> None:
    """Run the process that `make` makes over the lines of LOG; exits by the signal that came.

    In a closed loop the machine that reads the answers ends first, and its readings with it: that
    is no error.
    """
    from thermaltool.cli.messages import emitter
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.stream import open_stream

    messages = Messages(emitter(command, quiet), source_name(log))
    with click.open_file(log, "rb") as source:
        with shared.usage_errors():
            stream = open_stream(make(messages), settings, source.fileno(), 1, messages)
        try:
            number = stream.run()
        except BrokenPipeError:
            if not (closed_loop and _at_end(source.fileno())):
                raise
            number = 0
    if number:
        raise SystemExit(128 + number)


def _at_end(source: int) -> bool:
    """Whether the readings end, too, within a moment."""
    readable, _, _ = select.select([source], [], [], END_WITHIN)
    return bool(readable) and not os.read(source, 1)
