"""What the stages read: model and noise documents."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from thermaltool.documents import NOISE, Part, atomic_output, finite, mapping, read_text
from thermaltool.errors import ModelError

if TYPE_CHECKING:
    from thermaltool.estimation.estimator import SensorNoise
    from thermaltool.model import Model

# Time constant given to a drift of which the log tells only the rate [s].
BOUNDED_DRIFT_TIME = 3600.0


def source_name(path: str) -> str:
    """What messages call an input."""
    return "<stdin>" if path == "-" else path


def read_model(path: str) -> Model:
    """The model document in a file, or on stdin for ``-``."""
    from thermaltool.model import loads

    return loads(read_text(path), source_name(path))


def write_model(model: Model, path: str, command: str | None = None) -> None:
    """Write a model document whole; ``-`` is stdout. `command` goes into its provenance."""
    from thermaltool.model import dumps

    if command is not None:
        model = replace(model, provenance={**model.provenance, "command": command})
    text = dumps(model)
    with atomic_output(path) as stream:
        stream.write(text.encode())


def read_noise(path: str) -> dict[str, SensorNoise]:
    """Noise of every channel, from what ``thermaltool noise -o`` wrote.

    Where the log only bounds a drift, its rate enters, over an hour.

    Raises
    ------
    ModelError
        Not such a document; the message names the file.
    """
    document = NOISE.loads(read_text(path), path)
    try:
        channels = Part(document).part("channels")
        return {
            name: noise
            for name in channels.names()
            if (noise := _sensor_noise(channels.part(name))) is not None
        }
    except ModelError as error:
        raise ModelError(f"{path}: not {NOISE.noun}: {error}") from error


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
