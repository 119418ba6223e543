"""Which cause a channel beside the model speaks for, by its name."""

from __future__ import annotations

import numpy as np

from thermaltool.effects.scene import Scene
from thermaltool.units import is_absolute, is_displacement, is_temperature, parse_channel

# Taken for rest where no absolute temperature is known [degC].
ROOM_DEGC = 20.0
# In English, German, French, Italian, Spanish.
AIR_WORDS = {
    "air",
    "aire",
    "amb",
    "ambiance",
    "ambient",
    "ambiente",
    "aria",
    "atelier",
    "env",
    "environment",
    "hall",
    "halle",
    "lab",
    "luft",
    "officina",
    "outside",
    "raum",
    "room",
    "sala",
    "salle",
    "shop",
    "taller",
    "umgebung",
    "werkstatt",
    "workshop",
}
PART_WORDS = {"part", "pezzo", "piece", "pieza", "werkstueck", "work", "workpiece"}
# Of a temperature to one that it warms: nothing warms more than what warms it, but the logged
# sensor may be on its far side. Air warms a machine by as much in the long run, where nothing else
# does; and nothing that is warmer cools it, but for what a record leaves open.
MAX_TEMPERATURE_GAIN, MAX_FROM_AIR, MIN_WARMING = 3.0, 2.0, -0.5


def _speaks_of(channel: str, words: set[str]) -> bool:
    """Whether a channel is a temperature with one of `words` in its name ("room2" counts)."""
    parsed = parse_channel(channel)
    said = {word.rstrip("0123456789").lower() for word in parsed.place.split("_")}
    return is_temperature(channel) and bool(said & words)


def is_air(channel: str) -> bool:
    """Whether a channel is the temperature of the air around the machine, by its name.

    Parameters
    ----------
    channel : str
    """
    return _speaks_of(channel, AIR_WORDS)


def is_part(channel: str) -> bool:
    """Whether a channel is the temperature of the workpiece, by its name.

    Parameters
    ----------
    channel : str
    """
    return _speaks_of(channel, PART_WORDS)


def is_possible_gain(source: str, output: str, gain: float) -> bool:
    """Whether a channel may move an output by so much in the long run, as far as its name says.

    Parameters
    ----------
    source, output : str
    gain : float [unit of the output over that of the source]
    """
    if not (is_temperature(source) and is_temperature(output)):
        return True
    warms = is_absolute(source) and is_absolute(output)
    low = MIN_WARMING if warms else -MAX_TEMPERATURE_GAIN
    return low <= gain <= (MAX_FROM_AIR if is_air(source) else MAX_TEMPERATURE_GAIN)


def unknown_channels(scene: Scene) -> tuple[str, ...]:
    """Channels beside the model, and drives that it leaves out of an output.

    Parameters
    ----------
    scene : Scene
    """
    return (*scene.extra, *scene.unanswered)


def source_channels(scene: Scene) -> list[str]:
    """Unknown channels, neither air nor workpiece, with which heat may go.

    A displacement is no source, nor is a difference of two temperatures of the structure: both
    answer the heat that the model knows, and would explain a delay or a gain of it.

    Parameters
    ----------
    scene : Scene
    """
    return [
        c
        for c in unknown_channels(scene)
        if not (is_air(c) or is_part(c) or is_displacement(c))
        and parse_channel(c).dimension != "temperature difference"
    ]


def air_is_logged(scene: Scene) -> bool:
    """Whether any log holds the air, be it steady or already in the model.

    Parameters
    ----------
    scene : Scene
    """
    return any(is_air(channel) for log in scene.logs for channel in log.columns)


def rest_of(scene: Scene, output: str) -> float:
    """What an output reads at rest, in the first log that measures it [degC].

    Parameters
    ----------
    scene : Scene
    output : str
    """
    for log, simulated, residual in zip(scene.logs, scene.simulated, scene.residual, strict=True):
        there = np.isfinite(residual[output])
        if there.any():
            measured = log.columns[output] - residual[output] - simulated[output]
            return float(np.median(measured[there]))
    return ROOM_DEGC
