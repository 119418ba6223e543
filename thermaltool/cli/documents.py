"""Model and noise documents at the border, and what commands say on stderr."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click

from thermaltool.documents import atomic_output, check_folder
from thermaltool.errors import ModelError, ThermalToolError

if TYPE_CHECKING:
    from thermaltool.estimation.estimator import SensorNoise
    from thermaltool.logs import Log
    from thermaltool.model import Excursion, Model


# Time constant given to a drift of which the log tells only the rate [s].
BOUNDED_DRIFT_TIME = 3600.0


def read_text(path: str) -> str:
    """A text file, or stdin for ``-``."""
    try:
        if path == "-":
            return sys.stdin.read()
        with open(path, encoding="utf-8") as stream:
            return stream.read()
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not a text file") from error


def one_stdin(*paths: str) -> None:
    """Refuse a second ``-``: there is one stdin."""
    if paths.count("-") > 1:
        raise click.UsageError("only one input can be -: name a file for the others")


def keep_inputs(output: str, *inputs: str) -> None:
    """Refuse an output that would replace what the command reads."""
    for name in inputs:
        both = "-" not in (output, name) and os.path.exists(output) and os.path.exists(name)
        if both and os.path.samefile(output, name):
            raise click.UsageError(f"-o {output} would replace the input")
    check_folder(output)


def read_model(path: str) -> Model:
    """The model document in a file, or on stdin for ``-``."""
    from thermaltool.model import loads

    return loads(read_text(path), "<stdin>" if path == "-" else path)


def write_combined(
    combine: Callable[[list[Model], list[str]], Model], models: tuple[str, ...], output: str
) -> None:
    """Read several models, and write the one that is made of them (and of their names)."""
    from dataclasses import replace

    from thermaltool.model import dumps

    one_stdin(*models)
    keep_inputs(output, *models)
    names = ["<stdin>" if path == "-" else path for path in models]
    made = combine([read_model(path) for path in models], names)
    provenance = {**made.provenance, "command": "thermaltool " + " ".join(sys.argv[1:])}
    with atomic_output(output) as stream:
        stream.write(dumps(replace(made, provenance=provenance)).encode())


def write_json(document: Mapping[str, Any], target: str) -> None:
    """Sorted keys, null for what is missing, never NaN."""
    text = json.dumps(document, sort_keys=True, indent=1, allow_nan=False) + "\n"
    with atomic_output(target) as stream:
        stream.write(text.encode())


def read_noise(path: str) -> dict[str, SensorNoise]:
    """Noise of every channel, from what ``thermaltool noise -o`` wrote.

    Where the log only bounds a drift, its rate enters, over an hour.
    """
    try:
        document = json.loads(read_text(path))
        if document["format"] != "thermaltool-noise":
            raise ModelError(f"{path}: format {document['format']!r} is not thermaltool-noise")
        if document.get("version", 1) > 1:
            raise ModelError(
                f"{path}: version {document['version']} is newer than this thermaltool"
            )
        return _sensor_noise(document["channels"])
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ModelError(f"{path}: not what thermaltool noise -o writes") from error


def _sensor_noise(channels: Mapping[str, Any]) -> dict[str, SensorNoise]:
    from thermaltool.estimation.estimator import SensorNoise

    noise = {}
    for name, channel in channels.items():
        drift = channel.get("drift") or {}
        sigma, time = drift.get("sigma"), drift.get("time_constant_s")
        if drift.get("upper_bound") and drift.get("rate_per_sqrt_s"):
            time = BOUNDED_DRIFT_TIME
            sigma = drift["rate_per_sqrt_s"] * (time / 2) ** 0.5
        white = channel.get("white_sigma") or 0.0
        # A quantizer's own noise is the least that a reading can have.
        white = max(white, (channel.get("resolution") or 0.0) / 12**0.5)
        if white > 0:
            noise[name] = SensorNoise(white, sigma or 0.0, time or 1.0)
    return noise


def warn(message: str) -> None:
    """One line on stderr."""
    click.echo(message, err=True)


def emitter(command: str, quiet: int) -> Callable[[str], None]:
    """Where a stream's messages go: one line each on stderr, nowhere with --quiet."""

    def emit(message: str) -> None:
        # A terminal that has gone must not stop the stream.
        if not quiet:
            with contextlib.suppress(OSError):
                click.echo(f"thermaltool {command}: {message}", err=True)

    return emit


@contextlib.contextmanager
def usage_errors() -> Iterator[None]:
    """What settings refuse (ValueError) is an error of usage."""
    try:
        yield
    except ThermalToolError:
        raise
    except ValueError as error:
        raise click.UsageError(str(error)) from error


def warn_row(log: Log, row: int, message: str) -> None:
    """One line on stderr, with the file and the line of a row."""
    warn(f"{log.name}:{log.lines[row]}: {message}")


def terminal_progress(label: str) -> Callable[[str], None]:
    """A line that is overwritten, on a terminal only."""
    if not sys.stderr.isatty():
        return lambda message: None
    return lambda message: click.echo(f"\r\033[K{label}: {message}", nl=False, err=True)


def warn_excursions(model: Model, log: Log) -> None:
    """Say where the log leaves what the calibration has seen."""
    from thermaltool.model import excursions

    for e in excursions(model, log.columns):
        warn_excursion(log, e)


def warn_excursion(log: Log, e: Excursion) -> None:
    """Say where one channel leaves it."""
    warn_row(
        log,
        e.first,
        f"{e.channel}: {e.value:.4g} is outside the calibrated range {e.low:.4g} to {e.high:.4g} "
        f"({e.rows} rows): the model extrapolates",
    )


def warn_pauses(log: Log, meaning: str) -> None:
    """Say where the log has pauses (above --max-gap), and what they mean here."""
    for part in log.segments[1:]:
        pause = log.time[part.start] - log.time[part.start - 1]
        warn_row(log, part.start, f"a pause of {pause:g} s; {meaning}")
