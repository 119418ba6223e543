"""Laws that may hold before the responses: of a drive, or of what the machine is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.dynamics import from_rest
from thermaltool.effects.effect import Effect, Float
from thermaltool.effects.heat_capacity import HeatCapacity
from thermaltool.effects.sensor_conversion import SensorConversion
from thermaltool.model import Course, Drive, relative
from thermaltool.model.rest import rest_level
from thermaltool.record import Record

LawName = tuple[str, str]  # effect, channel

# Parameters of a law that are tried, one at a time.
FORMS: dict[type[Effect], tuple[str, ...]] = {
    DriveNonlinearity: ("exponent", "curvature"),
    HeatCapacity: ("rise",),
    SensorConversion: ("curvature",),
}
# The slope of a bent reading changes by no more than twice this share between rest and its level; a
# quarter of it is how far it may be off the chord. Beyond 0.17 what is as far below rest as the
# level is above it could not be straightened.
MAX_BEND = 0.15
# Over which the slopes of parameters are taken.
SLOPE_STEP = 1e-6


@dataclass(frozen=True)
class Law:
    """A law that may hold at a channel.

    Attributes
    ----------
    effect : type of Effect
    channel : str
    level : float [unit of the channel]
        Where its parameter counts: the largest value that the records reach.
    """

    effect: type[Effect]
    channel: str
    level: float

    @property
    def name(self) -> LawName:
        """Effect and channel."""
        return self.effect.name, self.channel

    @property
    def forms(self) -> tuple[str, ...]:
        """Parameters that are tried, one at a time."""
        return FORMS[self.effect]

    def place(self, form: str, value: float) -> float:
        """Where a search has a value: at its logarithm where it is searched by that."""
        if self.effect is SensorConversion:
            return value * self.level
        return float(np.log(value)) if self.effect.known[form].log else value

    def at(self, form: str, x: float) -> Effect:
        """The effect at a place of the search."""
        if self.effect is SensorConversion:
            # What is read at rest and at the level stays: the other parameters need not move.
            bent = {"gain": 1.0 - float(x), "curvature": float(x) / self.level}
            return SensorConversion(self.channel, bent)
        value = np.exp(x) if self.effect.known[form].log else x
        return self.effect(self.channel, {form: float(value), "level": self.level})

    def known(self, form: str, x: float, error: float) -> Effect:
        """The effect at a place of the search that has a standard error."""
        ahead, behind = (self.at(form, x + side * SLOPE_STEP) for side in (1, -1))
        found = self.at(form, x)
        slopes = np.array(
            [
                (ahead.parameters[n] - behind.parameters[n]) / (2 * SLOPE_STEP)
                for n in found.parameters
            ]
        )
        return replace(found, covariance=error**2 * np.outer(slopes, slopes))

    def places(self, form: str) -> tuple[float, float]:
        """Where a search ends."""
        if self.effect is SensorConversion:
            return -MAX_BEND, MAX_BEND
        known = self.effect.known[form]
        low, high = known.low, known.high
        if self.effect is HeatCapacity:
            low, high = HeatCapacity.ends(self.level)
        return self.place(form, low), self.place(form, high)


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
        measured = {effect.channel: from_rest(record, effect.channel) for effect in states}
        clock = Course.of(states, record, measured).clock if states else record.time
        result.append(replace(record.with_columns(changed), time=clock))
    return result, [replace(d, reference=0.0) if d.channel in own else d for d in drives]


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
