"""What several commands share: options as named objects, and checks of what they say."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import click
from click.core import ParameterSource

from thermaltool.cli.types import DURATION, NUMBER, SECONDS, InputPath
from thermaltool.documents import check_folder
from thermaltool.errors import ThermalToolError
from thermaltool.logs.formats import FORMATS, READABLE
from thermaltool.units import Reference

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def is_given(option: str) -> bool:
    """Whether an option of the running command was typed, or is in the environment."""
    source = click.get_current_context().get_parameter_source(option)
    return source in (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT)


log_argument: Decorator = click.argument("log", type=InputPath(), default="-")
logs_argument: Decorator = click.argument("logs", type=InputPath(), nargs=-1, default=("-",))
model_argument: Decorator = click.argument("model", type=InputPath())
output_option: Decorator = click.option(
    "-o", "--output", default="-", metavar="FILE", help="Where the result goes; - is stdout."
)
json_option: Decorator = click.option(
    "--json", "as_json", is_flag=True, help="Machine-readable JSON on stdout."
)
json_lines_option: Decorator = click.option(
    "--json", "as_json", is_flag=True, help="Short for --to ndjson."
)
columns_option: Decorator = click.option(
    "--columns",
    type=click.Path(exists=True, dir_okay=False),
    metavar="MAP.toml",
    help="Maps foreign column names to <quantity>_<place>_<unit>.",
)
from_option: Decorator = click.option(
    "--from",
    "from_format",
    type=click.Choice(list(READABLE)),
    help="Format of the log.  [default: by its content and suffix, else csv]",
)
to_option: Decorator = click.option(
    "--to",
    "to_format",
    type=click.Choice(list(FORMATS)),
    help="Format of stdout (a file's format follows its suffix).  [default: csv]",
)
nan_option: Decorator = click.option(
    "--nan-policy",
    type=click.Choice(["raise", "omit", "hold"]),
    default="raise",
    help="What a missing value where one is needed does: stop, leave the row out, keep the last.",
)
gap_option: Decorator = click.option(
    "--max-gap",
    type=DURATION,
    metavar="SECONDS",
    help="A pause above this splits the log into segments [s].  [default: 10 median periods]",
)
duplicates_option: Decorator = click.option(
    "--duplicates",
    type=click.Choice(["first", "mean", "spread"]),
    help="What rows of one time stamp become: the first, their mean, or as many rows, spread up "
    "to the next stamp.  [default: an error]",
)
initial_option: Decorator = click.option(
    "--initial",
    type=click.Choice(["rest", "settled"]),
    default="rest",
    help="The machine at the first row: at rest in what is measured there (a room), or settled at "
    "all first readings.",
)
free_initial_option: Decorator = click.option(
    "--initial",
    type=click.Choice(["auto", "rest", "settled", "free"]),
    default="auto",
    help="The machine at the first row: at rest in what is measured there, settled at all first "
    "readings, or, with --smooth, free: its state is estimated. With --smooth auto is rest unless "
    "the first readings contradict it, and free then; else it is rest.",
)
quiet_option: Decorator = click.option("-q", "--quiet", count=True, help="Less on stderr.")
rmse_option: Decorator = click.option(
    "--max-rmse",
    type=NUMBER,
    metavar="VALUE",
    help="Exit 3 when an output's RMSE is above this [unit of the output].",
)


def together(*options: Decorator) -> Decorator:
    """Several options as one decorator, in the order of the help."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


start_state_option: Decorator = click.option(
    "--initial",
    type=click.Choice(["auto", "rest", "free"]),
    default="auto",
    help="State at the first row: at rest; what fits the rows before --start best (all without "
    "it), for each measured output; or at rest unless most of what is wrong there is a start that "
    "decays or the calibration began so.",
)


def span_options(start: str, stop: str) -> Decorator:
    """``--start --stop``: a stretch of a log, and what it is for."""
    return together(
        click.option("--start", type=SECONDS, metavar="SECONDS", help=f"{start} this time on [s]."),
        click.option("--stop", type=SECONDS, metavar="SECONDS", help=f"{stop} this time [s]."),
    )


def faults_option(default: str) -> Decorator:
    """``--faults``: what becomes of readings that are a sensor's fault."""
    return click.option(
        "--faults",
        type=click.Choice(["omit", "keep"]),
        default=default,
        help="Readings that are a sensor's fault (85.0 and -127 of a DS18B20, spikes, …): left out "
        "as missing values, or taken as they are.",
    )


# How a table is read, and what reading a log takes beside that.
reading_options = together(columns_option, from_option, gap_option, duplicates_option)
table_options = together(reading_options, faults_option("omit"))
log_options = together(table_options, nan_option)
# Their parameters, which a body has no use for.
LOG_PARAMETERS = ("columns", "from_format", "max_gap", "duplicates", "faults", "nan_policy")


def is_body(logs: Sequence[str], of_logs: Sequence[str]) -> bool:
    """Whether a body is declared, by one .toml file; UsageError beside options of logs.

    Parameters
    ----------
    logs : sequence of str
        What stands for logs.
    of_logs : sequence of str
        Parameters that count for logs alone.
    """
    bodies = [name for name in logs if name.endswith(".toml")]
    if bodies and len(logs) > 1:
        raise click.UsageError(f"{bodies[0]} is a body, which comes without logs or other bodies")
    if not bodies:
        return False
    refuse_given(of_logs, f"is of logs, {logs[0]} is a body")
    return True


def refuse_given(parameters: Sequence[str], why: str) -> None:
    """UsageError for the first of some parameters that is given: its option, and why not."""
    for each in click.get_current_context().command.params:
        if each.name in parameters and is_given(each.name):
            raise click.UsageError(f"{each.opts[0]} {why}")


def low_pass_of(static: bool, time_constants: tuple[float, ...]) -> tuple[float, ...] | None:
    """Time constants of low-pass states [s]: none by --static, None where they are chosen."""
    if static and time_constants:
        raise click.UsageError("--static has no --time-constant")
    return () if static else time_constants or None


def number_of(text: str, option: str) -> float:
    """What is given as NAME=VALUE or as a word or a number; UsageError where it is no number."""
    try:
        value = float(text)
    except ValueError as error:
        raise click.UsageError(f"{option}: not a number: {text!r}") from error
    if not math.isfinite(value):
        raise click.UsageError(f"{option}: not a finite number: {text!r}")
    return value


def pair_of(text: str, option: str) -> tuple[str, str]:
    """The two sides of NAME=VALUE; UsageError where there is no sign between them."""
    name, equals, value = text.partition("=")
    if not equals:
        raise click.UsageError(f"{option} takes NAME=VALUE, not {text!r}")
    return name, value


def reference_of(text: str | None) -> Reference | None:
    """``--reference first|NUMBER``; None where it is not given."""
    if text is None or text == "first":
        return "first" if text else None
    return number_of(text, "--reference")


def check_files(output: str | None, *inputs: str | None, as_json: bool = False) -> None:
    """Refuse a second ``-`` among the inputs, two results on stdout, and what `keep_inputs` does.

    Files that are not given are None.
    """
    given = [name for name in inputs if name is not None]
    if as_json and output == "-":
        raise click.UsageError("--json reports on stdout: give the model a file with -o")
    if given.count("-") > 1:
        raise click.UsageError("only one input can be -: name a file for the others")
    if output is not None:
        keep_inputs(output, *given)


def keep_inputs(output: str, *inputs: str) -> None:
    """Refuse an output that cannot be written, or would replace what the command reads."""
    for name in inputs:
        both = "-" not in (output, name) and os.path.exists(output) and os.path.exists(name)
        if both and os.path.samefile(output, name):
            raise click.UsageError(f"-o {output} would replace the input")
    check_folder(output)


def keep_from_report(report: str | None, inputs: Sequence[str], output: str | None) -> None:
    """Refuse a report of another suffix, that would replace an input or the model, or cannot be."""
    if report is None:
        return
    if not report.endswith((".md", ".markdown")):
        raise click.UsageError(f"--report {report}: the report is Markdown, name it FILE.md")
    for name in (*inputs, output or "-"):
        if name != "-" and os.path.realpath(report) == os.path.realpath(name):
            raise click.UsageError(f"--report {report} would replace {name}")
    check_folder(report)


@contextlib.contextmanager
def usage_errors() -> Iterator[None]:
    """What settings refuse (ValueError) is an error of usage."""
    try:
        yield
    except ThermalToolError:
        raise
    except ValueError as error:
        raise click.UsageError(str(error)) from error
