"""How fast a sensor's reading can change: what is faster is a fault of the sensor.

No step of the drives, within what the calibration has seen, changes a reading by more within a
time than the largest rise of its step response over that time. Of a temperature that drives, and of
a reading that effects shape, what it did in the calibration's logs counts.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from thermaltool.documents import Part, finite, items
from thermaltool.estimation.estimator import SensorNoise
from thermaltool.model import Model
from thermaltool.responses.modes import Float
from thermaltool.signals.changes import DOUBLINGS

# A machine may be driven harder than in its calibration by this factor [1].
CHANGE_MARGIN = 3.0
# Noise that is borne beside it, in its standard deviations.
NOISE_MARGIN = 10.0
# Times of the step response among which the steepest stretch is looked for.
RESPONSE_TIMES = 300


def plausible_changes(
    model: Model, sensors: Mapping[str, str], noise: Sequence[SensorNoise], dt: float
) -> dict[str, Any]:
    """What `reach_of` reads: the largest change of each column over times from `dt` [s] on.

    Drives whose value runs on between samples have one, too.

    Parameters
    ----------
    model : Model
    sensors : mapping of column to output
        The columns that are read, and the outputs of the model behind them.
    noise : sequence of SensorNoise
        In the order of `sensors`.
    dt : float [s]
    """
    seconds: Float = dt * np.exp2(np.arange(DOUBLINGS, dtype=np.float64))
    largest = {
        drive.channel: _seen(drive.changes, model.sample_period, seconds)
        for drive in model.drives
        if drive.hold == "first"
    }
    for (column, channel), each in zip(sensors.items(), noise, strict=True):
        bound = NOISE_MARGIN * math.hypot(each.white, each.drift)
        if model.effects:
            # What effects add to the terms may be faster.
            output = next(o for o in model.outputs if o.channel == channel)
            largest[column] = _seen(output.changes, model.sample_period, seconds, bound)
        else:
            largest[column] = CHANGE_MARGIN * _of_steps(model, channel, seconds) + bound
    white = {column: each.white for column, each in zip(sensors, noise, strict=True)}
    # What is not known has no bound.
    known = {column: bound.tolist() for column, bound in largest.items() if len(bound)}
    return {"seconds": seconds.tolist(), "largest": known, "white_sigma": white}


def _of_steps(model: Model, channel: str, seconds: Float) -> Float:
    """How far the largest steps of the drives move an output within each of `seconds`."""
    starts = np.concatenate([[0.0], np.geomspace(seconds[0] / 4, 2 * seconds[-1], RESPONSE_TIMES)])
    largest = np.zeros(len(seconds))
    for term in model.terms:
        if term.output == channel:
            low, high = next(d.range for d in model.drives if d.channel == term.drive)
            step = term.response.modes(seconds[0]).step
            before = step(starts)
            rise = [np.max(np.abs(step(starts + span) - before)) for span in seconds]
            largest += (max(high, 0.0) - min(low, 0.0)) * np.array(rise)
    return largest


def _seen(changes: Sequence[float], period: float, seconds: Float, least: float = 0.0) -> Float:
    """The bound by what the calibration saw over 1, 2, 4 ... periods [s]; empty where nothing."""
    # What never moved says nothing of how fast it can.
    if not changes or not changes[0] > 0:
        return np.zeros(0)
    spans = np.ceil(np.log2(np.maximum(seconds / period, 1.0)) - 1e-9).astype(int)
    seen = np.array(changes)[np.minimum(spans, len(changes) - 1)]
    return np.asarray(CHANGE_MARGIN * seen + least)


def reach_of(design: Mapping[str, Any], column: str) -> Callable[[float], float]:
    """The largest change of a column within a time [s]; without bound where nothing says it.

    Parameters
    ----------
    design : mapping
    column : str

    Raises
    ------
    ModelError
        Not what `plausible_changes` gives.
    """
    if "plausible_change" not in design:
        return lambda seconds: math.inf
    kept = Part(design["plausible_change"], "design.plausible_change")
    seconds = _numbers(kept.read("seconds", items))
    if column not in kept.part("largest").names():
        return lambda elapsed: math.inf
    largest = _numbers(kept.part("largest").read(column, items))
    kept.as_whole(lambda whole: _same_length(seconds, largest))
    # Between two times the later one counts.
    return lambda elapsed: largest[min(bisect_left(seconds, elapsed), len(largest) - 1)]


def white_noise_of(design: Mapping[str, Any], column: str) -> float:
    """Standard deviation of a sensor's white noise; 0 where the design does not tell it.

    Parameters
    ----------
    design : mapping
    column : str
    """
    if "plausible_change" not in design:
        return 0.0
    kept = Part(design["plausible_change"], "design.plausible_change")
    white: float = kept.part("white_sigma").read(column, finite)
    return white


def _numbers(values: Sequence[Any]) -> list[float]:
    return [finite(value) for value in values]


def _same_length(seconds: list[float], largest: list[float]) -> None:
    if not seconds or len(seconds) != len(largest) or sorted(set(seconds)) != seconds:
        raise ValueError("times and changes do not go together")
