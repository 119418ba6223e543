"""What the stages read: logs, data frames and records; model and noise documents."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

from thermaltool.api.result import Notice, notice
from thermaltool.documents import NOISE, Part, atomic_output, finite, mapping, read_text
from thermaltool.errors import LogError, ModelError

if TYPE_CHECKING:
    import pandas

    from thermaltool.estimation.estimator import SensorNoise
    from thermaltool.logs import Log
    from thermaltool.model import Model
    from thermaltool.record import Record

    Data: TypeAlias = str | os.PathLike[str] | pandas.DataFrame | Record
    ModelLike: TypeAlias = str | os.PathLike[str] | Model | Any


class Reading(TypedDict, total=False):
    """How a log is read: the options of `read_log` that all stages share."""

    columns: str | None
    from_format: str | None
    nan_policy: str
    max_gap: float | None


# What a pause means where nothing else is said.
HELD_OVER_PAUSES = "the drive is taken as held over it"
# Time constant given to a drift of which the log tells only the rate [s].
BOUNDED_DRIFT_TIME = 3600.0


def read_log(
    data: Data,
    *,
    columns: str | None = None,
    from_format: str | None = None,
    nan_policy: str = "raise",
    max_gap: float | None = None,
    need: str | Sequence[str] = (),
    strict: bool = True,
) -> Log:
    """A log, from a file, a data frame or a record.

    Parameters
    ----------
    data : str, path, pandas.DataFrame or Record
        A file (CSV, NDJSON, Parquet; ``-`` is stdin), or a frame with columns named as in logs
        (``T_spindle_degC``) and a clock: a column ``time_s`` or ``time``, or a `DatetimeIndex`.
    columns : str, optional
        A column map (TOML) for foreign names.
    from_format : str, optional
        Format of the file. Default: by its suffix, else CSV.
    nan_policy : {"raise", "omit", "hold"}
        What a missing value in a channel of `need` does.
    max_gap : float, optional
        A pause above this [s] starts a new segment. Default: ten median periods.
    need : str or sequence of str
        Channels that must be there.
    strict : bool
        Whether the first fault is raised; else faults are listed in the log's `problems`.

    Returns
    -------
    Log

    Raises
    ------
    LogError
        A file or frame that cannot be read; with file, line and column.
    UnitError
        A column of a record whose name has no known unit.

    Examples
    --------
    >>> import pandas as pd, thermaltool as tt
    >>> frame = pd.DataFrame({"time_s": [0.0, 10.0, 20.0], "T_spindle_degC": [20.0, 20.4, 20.7]})
    >>> tt.read_log(frame).column("T_spindle_degC")
    array([20. , 20.4, 20.7])
    """
    from thermaltool import logs
    from thermaltool.record import Record

    if isinstance(data, Record):
        if columns is not None or from_format is not None:
            raise ValueError("columns and from_format say how a file or a frame is read")
        return logs.as_log(data, nan_policy=nan_policy, max_gap=max_gap, need=names(need))
    return logs.read_log(
        os.fspath(data) if isinstance(data, str | os.PathLike) else data,
        columns=columns,
        from_format=from_format,
        nan_policy=nan_policy,
        max_gap=max_gap,
        need=names(need),
        strict=strict,
    )


def read_for_fit(
    data: Data,
    need: Sequence[str],
    subject: str,
    span: tuple[float | None, float | None] = (None, None),
    *,
    min_rows: int = 2,
    pauses: str = HELD_OVER_PAUSES,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> Log:
    """A log over a `span` of time [s], with a word on what its pauses mean.

    Raises
    ------
    LogError
        As `read_log`; too few rows to say anything of the `subject`.
    """
    log = read_log(data, **reading, need=need).between(*span)
    if len(log) < min_rows:
        raise LogError(f"{len(log)} rows say nothing of a {subject}", log.name)
    warn_pauses(log, warn, pauses)
    return log


def warn_pauses(log: Log, warn: Notice, meaning: str = HELD_OVER_PAUSES) -> None:
    """Say where a log pauses, and what that means."""
    from thermaltool.report.text import pause_messages

    for message in pause_messages(log, meaning):
        warn(message)


def all_of(data: Data | Sequence[Data]) -> Sequence[Data]:
    """One or several inputs as several."""
    return data if isinstance(data, list | tuple) else [data]


def names(wanted: str | Sequence[str]) -> tuple[str, ...]:
    """Names of channels; a string is one name."""
    return (wanted,) if isinstance(wanted, str) else tuple(wanted)


def as_model(model: ModelLike) -> Model:
    """A model: itself, the one in a file, or the one that a result holds (its ``model``)."""
    if isinstance(model, str | os.PathLike):
        return read_model(os.fspath(model))
    found: Model = getattr(model, "model", model)
    return found


def source_name(path: str) -> str:
    """What messages call an input."""
    return "<stdin>" if path == "-" else path


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

    return loads(read_text(path), source_name(path))


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
    text = dumps(model)
    with atomic_output(path) as stream:
        stream.write(text.encode())


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
        return _sensor_noises(NOISE.loads(read_text(name), name), name)
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
