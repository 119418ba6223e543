"""Laws that may hold before the responses: of a drive, or of what the machine is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermaltool.effects.channels import ROOM_DEGC
from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.effect import Effect
from thermaltool.effects.heat_capacity import HeatCapacity
from thermaltool.effects.natural_convection import NaturalConvection
from thermaltool.effects.radiation import Radiation, radiative_excess
from thermaltool.effects.sensor_conversion import SensorConversion
from thermaltool.units import kelvins

LawName = tuple[str, str]  # effect, channel

# Parameters of a law that are tried, one at a time.
FORMS: dict[type[Effect], tuple[str, ...]] = {
    DriveNonlinearity: ("exponent", "curvature"),
    HeatCapacity: ("rise",),
    Radiation: ("rate",),
    NaturalConvection: ("rate",),
    SensorConversion: ("curvature",),
}
# Those by which more is lost for each kelvin where the machine is hot.
LOSSES = Radiation, NaturalConvection
# The slope of a bent reading changes by no more than twice this share between rest and its level; a
# quarter of it is how far it may be off the chord. Beyond 0.17 what is as far below rest as the
# level is above it could not be straightened.
MAX_BEND = 0.15
# What is lost beyond the linear law at the hottest is at most so many times what is lost by it. It
# is searched in steps of more than that of the other laws, by this factor: much of it may be so.
MAX_LOST, LOSS_SCALE = 3.0, 5.0
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
    rest : float [degC]
        What a temperature that radiates is at rest.
    slowest : float [s]
        Slowest time constant of that temperature.
    """

    effect: type[Effect]
    channel: str
    level: float
    rest: float = ROOM_DEGC
    slowest: float = 1.0

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
        if self.effect in LOSSES:
            return value / self._unit_rate
        return float(np.log(value)) if self.effect.known[form].log else value

    def at(self, form: str, x: float) -> Effect:
        """The effect at a place of the search."""
        if self.effect is SensorConversion:
            # What is read at rest and at the level stays: the other parameters need not move.
            bent = {"gain": 1.0 - float(x), "curvature": float(x) / self.level}
            return SensorConversion(self.channel, bent)
        if self.effect in LOSSES:
            rate = float(x) * self._unit_rate
            at = {"rest": self.rest} if self.effect is Radiation else {"level": self.level}
            return self.effect(self.channel, {"rate": rate, **at})
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
        if self.effect in LOSSES:
            return 0.0, MAX_LOST / LOSS_SCALE
        known = self.effect.known[form]
        low, high = known.low, known.high
        if self.effect is HeatCapacity:
            low, high = HeatCapacity.ends(self.level * kelvins(self.channel))
        return self.place(form, low), self.place(form, high)

    @property
    def _unit_rate(self) -> float:
        """The rate of a loss at one in the search [1/s]."""
        beyond = 1.0
        if self.effect is Radiation:
            hottest = np.array([self.level * kelvins(self.channel)])
            beyond = float(radiative_excess(self.rest, hottest)[0])
        return LOSS_SCALE / (self.slowest * beyond)
