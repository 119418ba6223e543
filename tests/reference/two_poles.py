"""A kind of response of the tests' own: what a new physical model has to bring, and no more."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from thermaltool.responses.modes import Modes


@dataclass(frozen=True)
class TwoPoles:
    """A(1 − e^(−at)) + B(1 − e^(−bt))."""

    A: float
    a: float
    B: float
    b: float

    kind: ClassVar[str] = "two_poles"
    searched: ClassVar[tuple[str, ...]] = ("a", "b")
    gains: ClassVar[tuple[str, ...]] = ("A", "B")
    fixed: ClassVar[dict[str, float]] = {}

    def transfer(self, s):
        return self.A * self.a / (s + self.a) + self.B * self.b / (s + self.b)

    def step(self, t):
        return -self.A * np.expm1(-self.a * t) - self.B * np.expm1(-self.b * t)

    def dc_gain(self):
        return self.A + self.B

    def slowest(self):
        return 1 / min(self.a, self.b)

    def modes(self, dt):
        poles = -np.array([self.a, self.b], complex)
        return Modes(poles, np.array([self.A * self.a, self.B * self.b], complex))

    @classmethod
    def search_box(cls, period, duration):
        return dict.fromkeys(cls.searched, (0.1 / duration, 2 / period))

    @classmethod
    def starts(cls, period, duration):
        return list(itertools.combinations(1 / np.geomspace(4 * period, duration, 5), 2))
