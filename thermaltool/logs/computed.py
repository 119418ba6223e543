"""Columns that a map computes from others: angles, differences, powers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from thermaltool.record import Array
from thermaltool.units import UNITS, parse_channel


class Computed(Protocol):
    """A column by its `name`, from the mapped columns `inputs`."""

    @property
    def name(self) -> str: ...
    @property
    def inputs(self) -> tuple[str, str]: ...
    def of(self, first: Array, second: Array) -> Array:
        """The column in the unit of its name, shape (n,)."""


@dataclass(frozen=True)
class Angle:
    """An angle from two probes at a `distance` [mm]: φ = (δ2 − δ1)/Δ (Mareš et al.)."""

    name: str
    inputs: tuple[str, str]
    distance: float

    def of(self, first: Array, second: Array) -> Array:
        """φ in the unit of its name, from what both probes read."""
        one, two = (UNITS[parse_channel(probe).unit][1] for probe in self.inputs)  # [µm]
        with np.errstate(over="ignore", invalid="ignore"):  # the reader refuses what overflows
            radians = (two * second - one * first) / (1e3 * self.distance)
            return np.asarray(1e6 * radians / UNITS[parse_channel(self.name).unit][1], float)


@dataclass(frozen=True)
class Difference:
    """The first column less the second, in the unit of its name."""

    name: str
    inputs: tuple[str, str]

    def of(self, first: Array, second: Array) -> Array:
        """The difference [unit of the name]."""
        one, two = (_relative(each, self.name) for each in self.inputs)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(one * first - two * second, float)


@dataclass(frozen=True)
class Power:
    """Voltage times current, in the unit of its name."""

    name: str
    inputs: tuple[str, str]

    def of(self, first: Array, second: Array) -> Array:
        """P = U I [unit of the name]."""
        one, two = (UNITS[parse_channel(each).unit][1] for each in self.inputs)
        scale = one * two / UNITS[parse_channel(self.name).unit][1]
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(scale * first * second, float)


def _relative(name: str, to: str) -> float:
    """The unit of one column in that of another."""
    return UNITS[parse_channel(name).unit][1] / UNITS[parse_channel(to).unit][1]


def difference_fits(name: str, inputs: tuple[str, str]) -> bool:
    """Whether the difference of two columns is what a name says: temperatures differ by K."""
    own, one, two = (parse_channel(each).dimension for each in (name, *inputs))
    return own == ("temperature difference" if one == "temperature" else one) and one == two
