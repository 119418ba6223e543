"""From a wanted offset to one that an actuator may be given: limits, slew rate, quantizer.

Scalars in the unit of the setpoint; no arrays, so that a stream pays nothing for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

# The quantizer keeps its level until the wanted value is this part of a step past half a step.
HYSTERESIS = 0.25
# Levels are printed as decimals: 3 steps of 0.1 are 0.3.
DECIMALS = 9


@dataclass(frozen=True)
class Limits:
    """The range that a setpoint never leaves.

    Raises
    ------
    ValueError
        `low` above `high`, or NaN.
    """

    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"no value lies between {self.low:g} and {self.high:g}")

    def clip(self, value: float) -> float:
        """`value`, or the limit that it passes."""
        return self.low if value < self.low else self.high if value > self.high else value

    def on_grid(self, step: float) -> Limits:
        """The outermost multiples of `step` inside the limits; the same limits for step 0.

        Parameters
        ----------
        step : float

        Raises
        ------
        ValueError
            Where no multiple lies inside.
        """
        if not step:
            return self
        # A billionth of a step forgives the rounding of the division.
        low = math.ceil(self.low / step - 1e-9) if math.isfinite(self.low) else self.low
        high = math.floor(self.high / step + 1e-9) if math.isfinite(self.high) else self.high
        if low > high:
            raise ValueError(
                f"no multiple of the step {step:g} lies between {self.low:g} and {self.high:g}"
            )
        return Limits(round(low * step, DECIMALS), round(high * step, DECIMALS))


def slewed(value: float, target: float, reach: float) -> float:
    """`value` moved towards `target` by at most `reach` (≥ 0).

    Parameters
    ----------
    value, target : float
    reach : float
        At least 0.
    """
    distance = target - value
    return target if abs(distance) <= reach else value + math.copysign(reach, distance)


def quantized(level: float, wanted: float, step: float) -> float:
    """The level of a quantizer with hysteresis, which stands at `level`.

    It stays until `wanted` is more than (1/2 + `HYSTERESIS`) steps away and then becomes the
    nearest multiple of `step`; so |level − wanted| ≤ 0.75 step always. Step 0 passes `wanted`.

    Parameters
    ----------
    level, wanted : float
    step : float
        0 for no quantizer.
    """
    if not step:
        return wanted
    if abs(wanted - level) <= (0.5 + HYSTERESIS) * step:
        return level
    return round(round(wanted / step) * step, DECIMALS)


@dataclass
class Setpoint:
    """One actuator: limits, then slew rate, then quantizer.

    With a wanted value w clipped to the limits and slewed to v, the setpoint u obeys

    - low ≤ u ≤ high, and u is a multiple of `step`;
    - |u − v| ≤ 0.75 step, and v changes by at most `rate`·dt, so one move changes u by at most
      `rate`·dt + 1.25 step.

    A wanted value that is not finite leaves the setpoint where it is.

    Attributes
    ----------
    limits : Limits
    rate : float [unit of the setpoint per s]
    step : float [unit of the setpoint]
        0 for no quantizer.
    value : float
        The setpoint.
    ramp : float
        v, the slewed value that the quantizer follows.
    """

    limits: Limits = field(default_factory=Limits)
    rate: float = math.inf
    step: float = 0.0
    value: float = 0.0
    ramp: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.limits = self.limits.on_grid(self.step)
        self.jump(self.value)

    def move(self, wanted: float, dt: float) -> float:
        """The setpoint `dt` [s] after the last move, on its way to `wanted`.

        Parameters
        ----------
        wanted : float
        dt : float [s]
        """
        if math.isfinite(wanted):
            reach = self.rate * dt if self.rate < math.inf else math.inf
            self.ramp = slewed(self.ramp, self.limits.clip(wanted), reach)
            self.value = quantized(self.value, self.ramp, self.step)
            # From outside, where it may begin, the last part of a step is taken at once.
            if self.limits.clip(self.ramp) == self.ramp:
                self.value = self.limits.clip(self.value)
        return self.value

    def jump(self, wanted: float) -> float:
        """The setpoint at once at `wanted`, or at what limits and step allow nearest to it.

        Parameters
        ----------
        wanted : float
        """
        wanted = self.limits.clip(wanted)
        if self.step:
            wanted = round(round(wanted / self.step) * self.step, DECIMALS)
        self.value = self.ramp = wanted
        return wanted

    def resume(self, value: float, ramp: float) -> None:
        """Stand where an earlier run stood, be it outside these limits; `move` leads inside.

        Parameters
        ----------
        value, ramp : float
            As they were.
        """
        self.value, self.ramp = value, ramp
