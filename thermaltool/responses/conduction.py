"""Generalized temperature response: a ring source on a thin plate that loses heat by convection.

Fraser 1997, (3.7), (5.3), (5.8). The print gives the transfer function as an integral over Bessel
functions; the integral has the closed form K·I0(r0 λ)·K0(r λ), λ = √(a + s/α), for r ≥ r0.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.relaxation import diffusive_modes, diffusive_step

# A fit keeps √a·r, the distance in lengths over which the heat is lost, below this: farther away a
# part in 10⁵ of it arrives, and no sum of exponentials follows.
MAX_LOSS_LENGTHS = 10.0


@dataclass(frozen=True)
class Conduction:
    """Temperature difference per unit heat at distance r from a ring source of radius r0.

    Attributes
    ----------
    K : float [unit of the output per unit of the drive]
    a : float [1/length²]
        Convection loss; the slowest rate of the response is a·α.
    alpha : float [length²/s]
        Diffusivity.
    r, r0 : float [length]
        Distance of the probes and radius of the source; r0 sets the unit of length.
    """

    K: float
    a: float
    alpha: float
    r: float
    r0: float = 0.12

    kind: ClassVar[str] = "conduction"
    searched: ClassVar[tuple[str, ...]] = ("a", "alpha", "r")
    gains: ClassVar[tuple[str, ...]] = ("K",)
    fixed: ClassVar[dict[str, float]] = {"r0": 0.12}

    def __post_init__(self) -> None:
        sound = self.a > 0 and self.alpha > 0 and self.r0 > 0 and self.r >= self.r0
        if not sound or not np.isfinite([self.K, self.a, self.alpha, self.r]).all():
            raise ModelError(
                f"conduction needs finite K, a, alpha, r0 > 0 and r >= r0 (K={self.K:g}, "
                f"a={self.a:g}, alpha={self.alpha:g}, r={self.r:g}, r0={self.r0:g})"
            )

    def transfer(self, s: Complex) -> Complex:
        """K·I0(r0 λ)·K0(r λ), the closed form of (5.8).

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
            Off the cut (−∞, −a·α].
        """
        # Imported on use: the stream reads models and needs no Bessel function.
        from scipy.special import ive, kve

        lam = np.sqrt(self.a + np.asarray(s, complex) / self.alpha)
        # Scaled Bessel functions, so that far from the origin nothing overflows.
        scale = np.exp(self.r0 * lam.real - self.r * lam)
        value = self.K * ive(0, self.r0 * lam) * kve(0, self.r * lam) * scale
        return np.where(scale == 0, 0.0, value)

    def dc_gain(self) -> float:
        """H(0) = K·I0(r0 √a)·K0(r √a)."""
        return float(self.transfer(np.zeros(1, complex))[0].real)

    def step(self, t: Float) -> Float:
        """Unit-step response (3.7); zero for t ≤ 0.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        return diffusive_step(self.transfer, t)

    def slowest(self) -> float:
        """Slowest time constant, 1/(a α) [s]."""
        return 1 / (self.a * self.alpha)

    def modes(self, dt: float) -> Modes:
        """The response as exponentials, for samples of `dt` or longer [s].

        Parameters
        ----------
        dt : float [s]
        """
        delay = (self.r - self.r0) ** 2 / self.alpha
        return diffusive_modes(self, self.a * self.alpha, delay, dt)

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            r0 [length].
        """
        r0 = fixed["r0"]
        return {
            "a": (1e-8 / r0**2, 30 / r0**2),
            "alpha": (1e-4 * r0**2 / duration, 1e3 * r0**2 / period),
            "r": (r0 * 1.001, 300 * r0),
        }

    @classmethod
    def search_excess(cls, a: float, r: float, **others: float) -> float:
        """How far a fit is beyond `MAX_LOSS_LENGTHS`, as a logarithm; 0 within.

        Parameters
        ----------
        a : float [1/length²]
        r : float [length]
        **others : float
        """
        return max(float(np.log(np.sqrt(a) * r / MAX_LOSS_LENGTHS)), 0.0)

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Coarse grid: slow time constant, loss over the distance (a r²), and r/r0.

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            r0 [length].
        """
        r0 = fixed["r0"]
        slow = duration * np.array([0.05, 0.2, 0.5, 1.0])
        _, fastest = cls.search_box(period, duration, r0=r0)["alpha"]
        grid = itertools.product(slow, (0.01, 0.1, 0.4, 1.0, 3.0), (1.2, 3.0, 10.0, 40.0))
        return [
            (loss / (ratio * r0) ** 2, min((ratio * r0) ** 2 / (loss * tau), fastest), ratio * r0)
            for tau, loss, ratio in grid
        ]
