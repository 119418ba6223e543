"""Sensors of a simulated machine: white noise, slow drift, finite resolution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.units import parse_channel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """What a sensor adds to the truth, in the unit of its channel.

    Parameters
    ----------
    white : float
        Standard deviation of the white part, per sample whatever the period.
    drift : float
        Standard deviation of the slow part, a stationary Ornstein-Uhlenbeck process.
    drift_time : float
        Time constant of the slow part [s].
    decimals : int
        Digits after the point that the converter resolves.
    """

    white: float
    drift: float = 0.0
    drift_time: float = 900.0
    decimals: int = 3

    def read(self, truth: Array, dt: float, generator: np.random.Generator) -> Array:
        """Readings of `truth` (n,) sampled every `dt` [s]."""
        # A stream for each part: the readings of a shorter log begin those of a longer one.
        (slow,) = generator.spawn(1)
        reading = truth + self.white * generator.standard_normal(truth.size)
        reading += ornstein_uhlenbeck(truth.size, dt, self.drift, self.drift_time, slow)
        return np.round(reading, self.decimals) + 0.0  # no negative zero


def ornstein_uhlenbeck(
    n: int, dt: float, sigma: float, time_constant: float, generator: np.random.Generator
) -> Array:
    """`n` samples of the stationary Ornstein-Uhlenbeck process, exact for any `dt`.

    Its standard deviation is `sigma`, its autocovariance sigma² exp(-|lag|/time_constant).
    """
    decay = np.exp(-dt / time_constant)
    shocks = sigma * generator.standard_normal(n)
    shocks[1:] *= np.sqrt(1.0 - decay**2)
    path: Array = lfilter([1.0], [1.0, -decay], shocks)
    return path


def read_sensors(
    truth: Mapping[str, Array], sensors: Mapping[str, Sensor], dt: float, seed: int
) -> dict[str, Array]:
    """Readings of every channel by the sensor of its unit.

    Each channel draws from its own stream, named by the channel, so that a plant with one more
    channel reads the same on the others.

    Parameters
    ----------
    truth : mapping of str to (n,) ndarray
        Channel to values without noise.
    sensors : mapping of str to Sensor
        Unit (``degC``, ``K``, ``um``) to sensor; a channel of another unit is read exactly.
    dt : float
        Sample period [s].
    seed : int
        The same seed gives the same readings.
    """
    readings = {}
    for name, values in truth.items():
        sensor = sensors.get(parse_channel(name).unit)
        generator = np.random.default_rng([seed, crc32(name.encode())])
        readings[name] = values if sensor is None else sensor.read(values, dt, generator)
    return readings
