"""What acts where laws hold before the responses: other drives, another clock, a faster decay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from thermaltool.effects.effect import Effect, Float
from thermaltool.effects.sensor_conversion import SensorConversion
from thermaltool.model import Course, Drive, relative
from thermaltool.model.rest import rest_level
from thermaltool.record import Record

# The channel of a record in the machine's own time that has the integral of the rate by which every
# mode decays faster, see `Course`; no log has a name like this.
COOLING = "(cooling)_1"
# An outlier among so many readings changes nothing of what is lost.
READINGS = 3


def acting_records(
    records: Sequence[Record],
    drives: Sequence[Drive],
    effects: Sequence[Effect],
    comparable: bool = False,
) -> tuple[list[Record], list[Drive]]:
    """Records with what acts in place of nonlinear drives and is behind bent readings.

    The drives count from zero.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    effects : sequence of Effect
        Of the drives, one each at most; of the state and of outputs, by what was measured.
    comparable : bool
        Straightened readings times the mean slope of the bend (geometric), so that errors are as
        large as those of readings.

    Returns
    -------
    list of Record [unit of the drive, relative to its reference]
        In the machine's own time.
    list of Drive
    """
    own = {effect.channel: effect for effect in effects if effect.side == "drive"}
    states = [effect for effect in effects if effect.side == "state"]
    bent = [effect for effect in effects if isinstance(effect, SensorConversion)]
    slopes = {e.channel: _mean_slope(e, records) if comparable else 1.0 for e in bent}
    result = []
    for record in records:
        changed = {}
        for drive in drives:
            if drive.channel in own:
                u = relative(record.column(drive.channel), drive.reference, drive.hold)
                changed[drive.channel] = own[drive.channel].drive(record, u)
        for effect in bent:
            rest, straight = _straightened(effect, record)
            changed[effect.channel] = rest + slopes[effect.channel] * straight
        acting = record.with_columns(changed)
        if states:
            measured = {effect.channel: _rise(record, effect.channel) for effect in states}
            course = Course.of(states, record, measured)
            acting = replace(acting.with_columns({COOLING: course.cooling}), time=course.clock)
        result.append(acting)
    return result, [replace(d, reference=0.0) if d.channel in own else d for d in drives]


def cooling_of(record: Record) -> Float | None:
    """Integral of the rate by which every mode decays faster, shape (n,) [1]; None for none.

    Parameters
    ----------
    record : Record
    """
    return record.columns.get(COOLING)


def longest_sustained(records: Sequence[Record]) -> float:
    """Time constant beyond which a machine would heat itself where it loses least [s].

    Parameters
    ----------
    records : sequence of Record
    """
    rates = [
        np.diff(cooling) / np.diff(record.time)
        for record in records
        if (cooling := cooling_of(record)) is not None
    ]
    least = min((float(np.min(rate, initial=0.0)) for rate in rates), default=0.0)
    return -1 / least if least else np.inf


def _rise(record: Record, channel: str) -> Float:
    """A temperature above rest, missing readings from their neighbours, without single outliers."""
    reading = record.column(channel)
    known = np.flatnonzero(np.isfinite(reading))
    if not len(known):
        return np.zeros(len(reading))
    whole = np.interp(record.time, record.time[known], reading[known])
    return np.asarray(median_filter(whole, READINGS, mode="nearest") - rest_level(reading, "first"))


def _straightened(effect: SensorConversion, record: Record) -> tuple[float, Float]:
    """A reading at rest, and the rise behind the others; an outlier stays what it is."""
    reading = record.column(effect.channel)
    rest = rest_level(reading, "first", "first")
    rise = reading - rest
    straight = effect.undone(rise)
    return float(rest), np.where(np.isfinite(straight), straight, rise)


def _mean_slope(effect: SensorConversion, records: Sequence[Record]) -> float:
    """Geometric mean of the change of a reading over that of what is behind it."""
    gain, curvature = effect.parameters.get("gain", 1.0), effect.parameters["curvature"]
    rises = np.concatenate([_straightened(effect, record)[1] for record in records])
    slopes = gain + 2 * curvature * rises[np.isfinite(rises)]
    return float(np.exp(np.mean(np.log(slopes[slopes > 0])))) if np.any(slopes > 0) else 1.0
