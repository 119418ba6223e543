"""What of a parameter-varying model is searched: modes, rates by level, exponents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.convection_state import ConvectionState
from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.effect import STILL, Effect
from thermaltool.effects.transport_delay import TransportDelay
from thermaltool.fitting.data import Array

# Modes, at most.
MAX_LPV_MODES = 4
# Logarithms are searched within so much of where the record says something: shortest time constant
# [sample periods], longest [records]; of the rate of the slowest mode at a level over that at the
# first one; of an exponent.
FASTEST_PERIODS, LONGEST_IN_RECORDS, MAX_LOG_RATE = 0.2, 3.0, 5.0
EXPONENTS = DriveNonlinearity.known["exponent"].low, DriveNonlinearity.known["exponent"].high


@dataclass(frozen=True)
class LpvForm:
    """One choice of structure.

    Attributes
    ----------
    modes : int
        First-order lags that all outputs and inputs share.
    channel : str
        The input by whose level loss and gain go; empty where neither does.
    levels : tuple of float [unit of the channel]
        Rising; along straight lines between them.
    loss, gain : bool
        Whether the rate of every mode goes by the level, and the gains of every input.
    powers : tuple of str
        Inputs that act by a power of their own.
    sizes : tuple of (str, float)
        Largest size of each of these, at which the power agrees with the input.
    delays : tuple of int, one for each input [samples]
        By which it acts later than a held input does in any case.
    direct : bool
        Whether outputs follow the inputs of the same row.
    rest : float [unit of the channel]
        What the channel counts from: a term's share goes by what is above it.
    """

    modes: int
    channel: str = ""
    levels: tuple[float, ...] = ()
    loss: bool = False
    gain: bool = False
    powers: tuple[str, ...] = ()
    sizes: tuple[tuple[str, float], ...] = ()
    delays: tuple[int, ...] = ()
    direct: bool = False
    rest: float = 0.0

    @property
    def rates(self) -> int:
        """Number of rates that are searched: those of the levels beside the first."""
        return len(self.levels) - 1 if self.loss else 0

    @property
    def shares(self) -> int:
        """Gains that each mode has for each input."""
        return len(self.levels) if self.gain else 1

    @property
    def searched(self) -> int:
        """Number of parameters that enter nonlinearly."""
        return self.modes + self.rates + len(self.powers)

    def weights(self, inputs: int) -> int:
        """Number of gains of each output."""
        return (self.modes + self.direct) * inputs * self.shares

    def bounds(self, dt: float, duration: float) -> tuple[Array, Array]:
        """Least and largest value of what is searched, each shape (searched,).

        Parameters
        ----------
        dt, duration : float [s]
            Sample period, and length of the longest record.
        """
        slow = np.log(LONGEST_IN_RECORDS * duration)
        sizes = (self.modes, self.rates, len(self.powers))
        low = (np.log(FASTEST_PERIODS * dt), -MAX_LOG_RATE, np.log(EXPONENTS[0]))
        high = (slow, MAX_LOG_RATE, np.log(EXPONENTS[1]))
        return np.repeat(low, sizes), np.repeat(high, sizes)

    def time_constants(self, theta: Array) -> Array:
        """Of the modes at the first level, shape (modes,) [s].

        Parameters
        ----------
        theta : ndarray, shape (searched,)
            Logarithms of time constants; of the rate of the slowest mode at each level over that
            at the first; of exponents.
        """
        return np.exp(theta[: self.modes])

    def level_rates(self, theta: Array) -> Array:
        """By how much all modes decay faster at each level, shape (levels,) [1/s]; no level: (0,).

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        """
        if not self.loss:
            return np.zeros(len(self.levels))
        slowest = 1.0 / float(np.max(self.time_constants(theta)))
        own = theta[self.modes : self.modes + self.rates]
        return np.append(0.0, slowest * np.expm1(own))

    def exponents(self, theta: Array) -> dict[str, float]:
        """Of every input that acts by a power.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        """
        own = np.exp(theta[self.modes + self.rates :]).tolist()
        return dict(zip(self.powers, own, strict=True))

    def acting(self, name: str, u: Array, theta: Array) -> Array:
        """What acts in place of an input, relative to rest.

        Parameters
        ----------
        name : str
        u : ndarray, shape (n,)
        theta : ndarray, shape (searched,)
        """
        effect = self.power(name, theta)
        return u if effect is None else effect.drive(STILL, u)

    def power(self, name: str, theta: Array) -> DriveNonlinearity | None:
        """The law by which an input acts; None for straight.

        Parameters
        ----------
        name : str
        theta : ndarray, shape (searched,)
        """
        exponent = self.exponents(theta).get(name)
        if exponent is None:
            return None
        return DriveNonlinearity(name, {"exponent": exponent, "level": dict(self.sizes)[name]})

    def bands(self) -> tuple[ScheduleBand, ...] | tuple[None]:
        """Which share of an input each gain takes."""
        if not self.gain:
            return (None,)
        above = tuple(level - self.rest for level in self.levels)
        return tuple(ScheduleBand(self.channel, above, k) for k in range(len(above)))

    def loss_effect(self, theta: Array) -> ConvectionState | None:
        """The rates by level as an effect; None where they are the same.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        """
        if not self.loss:
            return None
        rates = self.level_rates(theta).tolist()
        return ConvectionState(self.channel, _table(self.levels, rates))

    def late_effects(self, names: tuple[str, ...], dt: float) -> list[Effect]:
        """Dead times as effects.

        Parameters
        ----------
        names : tuple of str
            Of the inputs.
        dt : float [s]
        """
        each = zip(names, self.delays, strict=True)
        return [TransportDelay(name, {"delay": k * dt}) for name, k in each if k]

    def carried_over(self, theta: Array, other: LpvForm) -> Array:
        """Where a search of another form of as many modes begins, knowing one of this.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        other : LpvForm
        """
        found = np.zeros(other.searched)
        found[: other.modes] = theta[: self.modes]
        if other.loss and self.loss and other.channel == self.channel:
            own = np.append(0.0, theta[self.modes : self.modes + self.rates])
            shift = np.interp(other.levels, self.levels, own)
            found[other.modes : other.modes + other.rates] = shift[1:] - shift[0]
        known = self.exponents(theta)
        for k, name in enumerate(other.powers):
            found[other.modes + other.rates + k] = np.log(known.get(name, 1.0))
        return found


def _table(levels: tuple[float, ...], rates: list[float]) -> Mapping[str, float]:
    """Parameters of a loss by levels, in the order in which they are searched."""
    found: dict[str, float] = {}
    for k, (level, rate) in enumerate(zip(levels, rates, strict=True)):
        found |= {f"level{k}": level, f"rate{k}": rate}
    return found
