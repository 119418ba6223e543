"""Deflection response: two exponentials and one critically damped pair (or two).

Fraser 1997, (6.16), (6.20); with the second pair, for joint sources, (7.19).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.parameters import check_parameters, step_of


@dataclass(frozen=True)
class Deflection:
    """δ(t) = A(1 − e^(−at)) + B(1 − e^(−bt)) + D t e^(−dt) for a unit step.

    Attributes
    ----------
    A, B : float [unit of the output per unit of the drive]
    D : float [the same per s]
    a, b, d : float [1/s]
    """

    A: float
    a: float
    B: float
    b: float
    D: float
    d: float

    kind: ClassVar[str] = "deflection"
    searched: ClassVar[tuple[str, ...]] = ("a", "b", "d")
    gains: ClassVar[tuple[str, ...]] = ("A", "B", "D")
    fixed: ClassVar[dict[str, float]] = {}

    def __post_init__(self) -> None:
        check_parameters(self, "finite rates above zero")

    def _pairs(self) -> list[tuple[float, float]]:
        return [(self.D, self.d)]

    def transfer(self, s: Complex) -> Complex:
        """A a/(s + a) + B b/(s + b) + D s/(s + d)², (6.20).

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        s = np.asarray(s, complex)
        first = self.A * self.a / (s + self.a) + self.B * self.b / (s + self.b)
        return np.asarray(first + sum(D * s / (s + d) ** 2 for D, d in self._pairs()))

    def dc_gain(self) -> float:
        """A + B."""
        return self.A + self.B

    def step(self, t: Float) -> Float:
        """Unit-step response (6.16); zero before t = 0.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        return step_of(self, np.maximum(np.asarray(t, float), 0.0))

    @classmethod
    def unit_steps(cls, t: Float, **searched: float) -> tuple[Float, Float]:
        """`step` and `dc_gain` with each gain at one and the others at zero.

        Parameters
        ----------
        t : ndarray, shape (m,) [s]
            Zero or later.
        **searched : float [1/s]
            Rates by name.

        Returns
        -------
        steps : ndarray, shape (m, gains)
        steady : ndarray, shape (gains,)
        """
        at = t[:, None] * np.array([searched[name] for name in cls.searched])
        pairs = t[:, None] * np.exp(-at[:, 2:])
        steady = np.zeros(at.shape[1])
        steady[:2] = 1.0
        return np.column_stack([-np.expm1(-at[:, :2]), pairs]), steady

    def slowest(self) -> float:
        """Slowest time constant [s]."""
        return 1 / min(getattr(self, name) for name in self.searched)

    def modes(self, dt: float) -> Modes:
        """Exact: s/(s + d)² = 1/(s + d) − d/(s + d)². `dt` does not matter.

        Parameters
        ----------
        dt : float [s]
        """
        pairs = self._pairs()
        poles = [-self.a, -self.b, *(-d for _, d in pairs)]
        weights = [self.A * self.a, self.B * self.b, *(D for D, _ in pairs)]
        double = [0.0, 0.0, *(-D * d for D, d in pairs)]
        return Modes(np.array(poles, complex), np.array(weights, complex), np.array(double))

    @classmethod
    def search_box(cls, period: float, duration: float) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        """
        return dict.fromkeys(cls.searched, (0.02 / duration, 4 / period))

    @classmethod
    def starts(cls, period: float, duration: float) -> list[tuple[float, ...]]:
        """Coarse grid: every choice of rates from six time constants, the slow ones first.

        Parameters
        ----------
        period, duration : float [s]
        """
        rates = 1 / np.geomspace(duration, max(duration / 300, 2 * period), 6)
        pairs = itertools.combinations(rates, 2)
        rest = itertools.product(rates[1:], repeat=len(cls.searched) - 2)
        return [(*pair, *more) for pair, more in itertools.product(pairs, list(rest))]


@dataclass(frozen=True)
class JointDeflection(Deflection):
    """The sixth-order form (7.19): a second critically damped pair, E t e^(−et)."""

    E: float = 0.0
    e: float = 1.0

    kind: ClassVar[str] = "joint_deflection"
    searched: ClassVar[tuple[str, ...]] = ("a", "b", "d", "e")
    gains: ClassVar[tuple[str, ...]] = ("A", "B", "D", "E")

    def _pairs(self) -> list[tuple[float, float]]:
        return [(self.D, self.d), (self.E, self.e)]
