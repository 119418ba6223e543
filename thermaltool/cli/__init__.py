"""The command line: one small file per subcommand, imported when it is called."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import warnings
from typing import Any

import click

from thermaltool import __version__
from thermaltool.cli.ends import end_by_signals
from thermaltool.cli.types import SizeType
from thermaltool.errors import ThermalToolError

# The help table: no command is imported to print it.
COMMANDS: dict[str, str] = {
    "check": "What is in a log and what is wrong with it.",
    "noise": "Noise of every channel: resolution, white, drift, lines, outliers.",
    "calibrate": "Fit temperature and deflection models to measured logs.",
    "identify": "Transfer functions from measured logs: ARX, ARMAX, OE, BJ.",
    "spectrum": "Time constants, Foster and Cauer networks of a thermal transient.",
    "rc": "Networks of heat capacities and conductances from logs: grey box, stochastic.",
    "modes": "Thermal modes: of a finite-element model, or from logs alone.",
    "iso230": "Thermal tests of ISO 230-3: ranges and tilts with intervals.",
    "place": "Which temperature sensors to keep, for deflections predicted from them.",
    "regress": "Thermal errors as sums of temperatures, and how far they hold elsewhere.",
    "correct": "A static curve in front of a linear model or behind it, from logs.",
    "schedule": "Several models by level, switched without a bump.",
    "superpose": "The sum of several models.",
    "regularize": "Design the estimator from the model and the measured noise.",
    "design": "A controller of heaters, from a model and the drives that are set.",
    "invert": "Time-domain kernel of the inverse model, with its singular weights.",
    "present": "What is in models: gains, time constants, delays, effects, estimator.",
    "simulate": "Outputs of a model for the drives in a log.",
    "compare": "Models side by side on a log: errors of each, one figure.",
    "estimate": "Heat and deflection from measured temperatures.",
    "compensate": "Stream: sensor lines in, setpoint lines out.",
    "fcc": "Stream: error lines in, commands that act ahead of their own delay out.",
    "order": "Which AR or ARMA order a series has, by AIC, AICc and BIC.",
    "fit": "An AR or ARMA model of a series: coefficients, roots, natural frequencies.",
    "forecast": "Forecasts of a fitted model with intervals, in batch or as a stream.",
    "laplace": "Invert an expression of s numerically, with an error estimate.",
    "diagnose": "What a model gets wrong, why, and what knowing it is worth.",
    "plot": "Figure of any log or result.",
    "plant": "Write a test log from a simulated machine.",
    "completion": "Script that completes commands and options in bash, zsh or fish.",
}

INTERRUPTED, CLOSED_PIPE = 128 + signal.SIGINT, 141


OUT_OF_MEMORY = (
    "out of memory: take a shorter log, fewer columns (--columns) or a longer period "
    "(check --resample)"
)


class LazyGroup(click.Group):
    """Subcommands live in ``thermaltool.cli.<name>`` and are imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"thermaltool.cli.{name}").command
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            from difflib import get_close_matches

            near = get_close_matches(args[0], COMMANDS, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            ctx.fail(f"no command {args[0]!r}{hint}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            # By its errno click would make exit code 1 of it; `main` knows better.
            raise BrokenPipeError from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog="Example: thermaltool plant frame --input step | thermaltool check -",
)
@click.version_option(__version__, prog_name="thermaltool")
@click.option("--debug", is_flag=True, help="Show a traceback with an error.")
@click.option(
    "--config",
    type=click.Path(exists=True, dir_okay=False),
    metavar="FILE.toml",
    help="Defaults per command: [calibrate] loss = 'huber' (flag over environment over file).",
)
@click.option(
    "--max-bytes",
    type=SizeType(),
    help="A larger log or model is refused (500MB, 20GB); a stream is not.  [default: 2GiB]",
)
@click.pass_context
def group(ctx: click.Context, debug: bool, config: str | None, max_bytes: int | None) -> None:
    """From a measured log of a warming machine to a calibrated model and a compensated stream.

    Logs are tables (CSV, Parquet, NDJSON) whose columns are named <quantity>_<place>_<unit>. Times
    among the options are in seconds, or have their unit: 30s, 10min, 8h.
    """
    if max_bytes is not None:
        from thermaltool import sources

        before = sources.max_bytes.set(max_bytes)
        ctx.call_on_close(lambda: sources.max_bytes.reset(before))
    if config:
        from thermaltool.parsing import parse_toml
        from thermaltool.sources import read_input

        try:
            tables = parse_toml(read_input(config), config)
        except OSError as error:
            raise click.UsageError(f"{config}: {error.strerror or error}") from error
        except ThermalToolError as error:
            raise click.UsageError(str(error)) from error
        for name, table in tables.items():
            if name not in COMMANDS or not isinstance(table, dict):
                raise click.UsageError(f"{config}: [{name}] is no command")
        called = ctx.invoked_subcommand
        if called in tables:
            ctx.default_map = {called: _defaults(config, called, tables[called], ctx)}


def _defaults(
    config: str, name: str, table: dict[str, Any], ctx: click.Context
) -> dict[str | None, Any]:
    """Defaults of one command by parameter, from its options as they are written."""
    command = group.get_command(ctx, name)
    assert command is not None
    known = {o.lstrip("-"): p for p in command.params for o in p.opts if o.startswith("--")}
    for key, value in table.items():
        if key.replace("_", "-") not in known:
            from difflib import get_close_matches

            near = get_close_matches(key, known, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise click.UsageError(f"{config}: [{name}] has no option {key!r}{hint}")
        option = known[key.replace("_", "-")]
        several = option.multiple or option.nargs != 1
        if not isinstance(value, str | int | float | list) or isinstance(value, list) > several:
            what = "values" if several else "one value"
            raise click.UsageError(f"{config}: [{name}] {key} takes {what}, not {value!r:.60}")
    return {known[key.replace("_", "-")].name: value for key, value in table.items()}


def _show_warning(message: Warning | str, *where: Any, **more: Any) -> None:
    """One line on stderr, as everything that a command says.

    NumPy's own are about its operations, not about the user's data: an overflow ends in NaN or
    infinity, which no writer takes.
    """
    if not isinstance(message, RuntimeWarning):
        from thermaltool.cli.messages import warn

        warn(str(message))


def _show_error(name: str, message: str) -> None:
    """One line on stderr, the name of the command in red where a terminal has colours."""
    from thermaltool.cli.progress import coloured

    line = message.replace("\n", " ")
    click.echo(f"{coloured(f'{name}:', fg='red', bold=True)} {line}", err=True)


def _with_variable(error: click.ClickException) -> click.ClickException:
    """The error, with the environment variable that a bad value of an option comes from."""
    ctx, param = (getattr(error, name, None) for name in ("ctx", "param"))
    if not (isinstance(error, click.BadParameter) and ctx and param and param.name):
        return error
    if ctx.get_parameter_source(param.name) is not click.core.ParameterSource.ENVIRONMENT:
        return error
    own = param.envvar or f"{ctx.auto_envvar_prefix}_{param.name.upper()}"
    return click.BadParameter(f"{error.message} (from {own})", ctx, param)


def main() -> None:
    """Entry point: every way out has its exit code and at most one line on stderr."""
    # Small products and long sums: threads would only wait for each other. Read by numpy.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    called = next((word for word in sys.argv[1:] if word in COMMANDS), "")
    end_by_signals(called)
    warnings.showwarning = _show_warning
    debug = "--debug" in sys.argv[1:]
    name = f"thermaltool {called}".rstrip()
    try:
        code = group.main(
            prog_name="thermaltool", auto_envvar_prefix="THERMALTOOL", standalone_mode=False
        )
        if sys.stdout is not None:
            sys.stdout.flush()
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        _with_variable(error).show()
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo(f"{name}: interrupted", err=True)
        code = INTERRUPTED
    except BrokenPipeError:
        # The interpreter flushes stdout once more at exit: give it somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = CLOSED_PIPE
    except ThermalToolError as error:
        if debug:
            raise
        _show_error(name, str(error))
        code = 1
    except MemoryError:
        if debug:
            raise
        _show_error(name, OUT_OF_MEMORY)
        code = 1
    except ModuleNotFoundError as error:
        from thermaltool.cli.extras import missing_package

        message = missing_package(error.name, name.partition(" ")[2], sys.argv[1:])
        if debug or message is None:
            raise
        click.echo(f"{name}: {message}", err=True)
        code = 1
    except OSError as error:
        if debug:
            raise
        place = f"{error.filename}: " if error.filename else ""
        _show_error(name, f"{place}{error.strerror or error}")
        code = 1
    except Exception as error:
        if debug:
            raise
        message = f"{type(error).__name__}: {error}"
        _show_error(name, f"unexpected {message} (thermaltool --debug shows where)")
        code = 1
    sys.exit(code if isinstance(code, int) else 0)
