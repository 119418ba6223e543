"""What the stages read: logs for a fit; model and noise documents."""

from __future__ import annotations

import functools
import os
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, TypeVar, Unpack, cast

from thermaltool.api.result import Notice, notice
from thermaltool.documents import (
    CONTROLLER,
    MODEL,
    NOISE,
    Part,
    finite,
    mapping,
    read_text,
    write_whole,
)
from thermaltool.errors import LogError, ModelError, counted
from thermaltool.units import Hold, hold_of

if TYPE_CHECKING:
    from thermaltool.control.controller import HeaterController
    from thermaltool.estimation.estimator import SensorNoise
    from thermaltool.logs import Log
    from thermaltool.logs.columns import Columns
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model

    ModelLike: TypeAlias = str | os.PathLike[str] | Model | Any


Stage = TypeVar("Stage", bound=Callable[..., Any])


class Reading(TypedDict, total=False):
    """How a log is read: the options of `read_log` that all stages share."""

    columns: Columns | None
    from_format: str | None
    nan_policy: str
    max_gap: float | None
    duplicates: str | None
    faults: str


# What reads as without the option.
READING_DEFAULTS = (("nan_policy", "raise"), ("faults", "omit"))


def options_of(reading: Mapping[str, Any]) -> tuple[str, ...]:
    """How a log was read, as options of a command; what is the default is left out.

    Parameters
    ----------
    reading : mapping
        As `Reading`.
    """
    found: list[str] = []
    for name in Reading.__annotations__:
        value = reading.get(name)
        if value is None or (name, value) in READING_DEFAULTS:
            continue
        option = "--from" if name == "from_format" else "--" + name.replace("_", "-")
        # Columns that no file holds are those of a call from Python.
        own = "MAP.toml" if name == "columns" and not isinstance(value, str) else str(value)
        found += [option, shlex.quote(own)]
    return tuple(found)


def reads(options: type) -> Callable[[Stage], Stage]:
    """A stage whose further keywords are `options` of how data are read.

    Others are refused in the name of the stage, not of a function below it.
    """

    def decorate(stage: Stage) -> Stage:
        own = stage.__code__.co_varnames[: stage.__code__.co_argcount]
        known = (*own, *(stage.__kwdefaults__ or ()), *options.__annotations__)

        @functools.wraps(stage)
        def checked(*args: Any, **keywords: Any) -> Any:
            for name in keywords:
                if name not in known:
                    from thermaltool.record import hint

                    raise TypeError(
                        f"{stage.__qualname__}() takes no argument {name!r}{hint(name, known)}"
                    )
            return stage(*args, **keywords)

        return cast(Stage, checked)

    return decorate


# Time constant given to a drift of which the log tells only the rate [s].
BOUNDED_DRIFT_TIME = 3600.0


def read(
    data: Data,
    need: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    keep_spikes: Sequence[str] = (),
    unread: bool = False,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> Log:
    """A log without the faults of its sensors, with a word on what was left out.

    With `unread` the stage says itself what it makes of cells that are no numbers
    (`refuse_unread`).

    Raises
    ------
    LogError
        As `read_log`.
    """
    from thermaltool.logs import read_log
    from thermaltool.report.text import fault_message, spared_map_message

    reading = {"faults": "omit", **reading}
    log = read_log(
        data, **reading, keep_spikes=keep_spikes, need=need, outputs=outputs, unread=unread
    )
    if log.spared_map:
        warn(spared_map_message(log))
    if told := fault_message(log, (*need, *outputs) if outputs else None):
        warn(told)
    return log if unread else refuse_unread([log], (), warn)[0]


def refuse_unread(logs: Sequence[Log], needed: Sequence[str], warn: Notice) -> list[Log]:
    """The logs, with a word on cells that are no numbers where they count as missing values.

    Raises
    ------
    LogError
        Such a cell of a channel that is needed.
    """
    from thermaltool.logs.unread import with_cure

    for log in logs:
        for channel, problem in log.unread.items():
            if channel in needed:
                raise with_cure(problem)
            warn(f"{problem}: taken as a missing value")
    return [replace(log, unread={}) if log.unread else log for log in logs]


def read_for_fit(
    data: Data,
    need: Sequence[str],
    subject: str,
    span: tuple[float | None, float | None] = (None, None),
    *,
    outputs: Sequence[str] = (),
    whole: bool = False,
    min_rows: int = 2,
    pauses: str | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> Log:
    """A log as by `read` over a `span` of time [s], with a word on what its pauses mean.

    With `whole` all rows are returned, and those of the span checked. Where missing values are
    omitted, a row in which an output alone is missing stays: what drives acts there, too.

    Raises
    ------
    LogError
        As `read_log`; too few rows to say anything of the `subject`.
    """
    from thermaltool.report.text import stuck_messages

    log = read(data, need, outputs, warn=warn, **reading)
    part = log.between(*span)
    if len(part) < min_rows:
        raise LogError(f"{counted(len(part), 'row')}: too few to tell a {subject} by", log.name)
    warn_pauses(part, warn, drives_over_pauses(map(hold_of, need)) if pauses is None else pauses)
    for message in stuck_messages(part, (*need, *outputs)):
        warn(message)
    return log if whole else part


def drives_over_pauses(holds: Iterable[Hold]) -> str:
    """What drives do over a pause, by their holds.

    Parameters
    ----------
    holds : iterable of "zero" or "first"
    """
    found = set(holds)
    if found == {"first"}:
        return "the drive is taken along a straight line over it"
    if "first" in found:
        return "commands are taken as held over it, what is measured along a straight line"
    return "the drive is taken as held over it"


def warn_pauses(log: Log, warn: Notice, meaning: str) -> None:
    """Say where a log pauses, and what that means."""
    from thermaltool.report.text import pause_messages

    for message in pause_messages(log, meaning):
        warn(message)


def all_of(data: Data | Sequence[Data]) -> Sequence[Data]:
    """One or several inputs as several."""
    return data if isinstance(data, list | tuple) else [data]


def read_toml(path: str) -> dict[str, Any]:
    """The table in a TOML file.

    Raises
    ------
    ModelError
        It cannot be read, or is no TOML; the message names the file and the place.
    """
    from thermaltool.parsing import parse_toml
    from thermaltool.sources import read_input

    try:
        return parse_toml(read_input(path), path)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error


def as_model(model: ModelLike) -> Model:
    """A model: itself, the one in a file, or the one that a result holds (its ``model``)."""
    if isinstance(model, str | os.PathLike):
        return read_model(os.fspath(model))
    found: Model = getattr(model, "model", model)
    return found


def read_model(path: str) -> Model:
    """The model in a file.

    Parameters
    ----------
    path : str
        A model document (JSON); ``-`` is stdin.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        No model document, or one of a newer version; the message names the file and the place.

    Examples
    --------
    >>> import numpy as np, pandas as pd, tempfile, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tt.write_model(fit, f"{folder}/model.json")
    ...     tt.read_model(f"{folder}/model.json").needs()
    ('Q_motor_W',)
    """
    from thermaltool.model import loads

    return loads(*read_text(path))


def read_sealed(path: str) -> tuple[Model | HeaterController, Callable[[], str]]:
    """The model or controller in a file, and what checks that nobody has changed it.

    The check gives the digest of the file.

    Parameters
    ----------
    path : str
        ``-`` is stdin. A file of an earlier release, without a checksum, is taken as it is.

    Raises
    ------
    ModelError
        As `read_model`; from the check: another content than was written.
    """
    from thermaltool.model import from_document
    from thermaltool.parsing import parse_json

    text, name = read_text(path)
    document = parse_json(text, name, f" (not {MODEL.noun})")
    sealed = isinstance(document, dict) and CONTROLLER.matches(document)
    form = CONTROLLER if sealed else MODEL

    def checked() -> str:
        try:
            return form.check_seal(form.check(document, name), name)
        except ModelError as error:
            raise ModelError(f"{error}: write it anew with the command that made it") from error

    if form is MODEL:
        return from_document(document, name), checked
    # Imported for a controller alone: the other streams start without it.
    from thermaltool.control.controller import load_controller

    return load_controller(document, name), checked


def write_model(model: ModelLike, path: str, command: str | None = None) -> None:
    """Write a model document, whole or not at all.

    Parameters
    ----------
    model : Model, or a result that holds one
    path : str
        ``-`` is stdout.
    command : str, optional
        How the model was made, for its provenance.

    Raises
    ------
    OutputError
        It cannot be written; a file that was there before is still there.

    Examples
    --------
    >>> import numpy as np, pandas as pd, tempfile, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tt.write_model(fit, f"{folder}/model.json")
    ...     tt.read_model(f"{folder}/model.json").needs()
    ('Q_motor_W',)
    """
    from thermaltool.model import dumps

    model = as_model(model)
    if command is not None:
        model = replace(model, provenance={**model.provenance, "command": command})
    write_whole(dumps(model).encode(), path)


def read_noise(noise: str | os.PathLike[str] | Any) -> dict[str, SensorNoise]:
    """Noise of every channel, from what ``thermaltool noise -o`` wrote or `noise` returned.

    Where the log only bounds a drift, its rate enters, over an hour.

    Raises
    ------
    ModelError
        Not such a document; the message names the file.
    """
    if isinstance(noise, str | os.PathLike):
        name = os.fspath(noise)
        return _sensor_noises(NOISE.loads(*read_text(name)), name)
    return _sensor_noises(noise.document(), "<noise>")


def _sensor_noises(document: Mapping[str, Any], name: str) -> dict[str, SensorNoise]:
    try:
        channels = Part(document).part("channels")
        noises = {each: _sensor_noise(channels.part(each)) for each in channels.names()}
    except ModelError as error:
        raise ModelError(f"{name}: not {NOISE.noun}: {error}") from error
    return {each: found for each, found in noises.items() if found is not None}


def _sensor_noise(channel: Part) -> SensorNoise | None:
    """White level and drift; None where the log shows no noise."""
    from thermaltool.estimation.estimator import SensorNoise

    white = channel.read("white_sigma", finite, 0.0)
    if white < 0:
        raise ModelError(f"white_sigma: a standard deviation of {white:g}")
    # A quantizer's own noise is the least that a reading can have.
    white = max(white, channel.read("resolution", finite, 0.0) / 12**0.5)
    if not white > 0:
        return None
    if channel.read("drift", mapping, {}) == {}:
        return SensorNoise(white, 0.0, 1.0)
    drift = channel.part("drift")
    sigma = drift.read("sigma", finite, 0.0)
    time = drift.read("time_constant_s", finite, 0.0)
    rate = drift.read("rate_per_sqrt_s", finite, 0.0)
    if drift.read("upper_bound", bool, False) and rate:
        sigma, time = rate * (BOUNDED_DRIFT_TIME / 2) ** 0.5, BOUNDED_DRIFT_TIME
    return SensorNoise(white, sigma, time or 1.0)
