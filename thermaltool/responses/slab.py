"""Temperature in a slab that is heated on one face and loses heat on both.

One-dimensional conduction (Carslaw & Jaeger 1959, sec. 3.11 and 12.5), heat and convection at one
face, convection at the other. With p = √(s τ) and x, the depth as a share of the thickness, it is

    θ(s) = [cosh p(1−x) + B₁ sinh(p(1−x))/p] / [(B₀ + B₁) cosh p + (p² + B₀B₁) sinh(p)/p].
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.relaxation import diffusive_modes, diffusive_step

# Biot numbers that a fit admits: a face as good as insulated, and one as good as held.
BIOT_RANGE: Range = (1e-3, 1e2)
# Depths that a fit admits: its slopes need room below the far face.
DEPTH_RANGE: Range = (1e-2, 0.99)
# Below this the first term of a series is exact to rounding.
SMALL = 1e-9


@dataclass(frozen=True)
class Slab:
    """Rise at a depth of a slab per unit of the heat that goes into one of its faces.

    Attributes
    ----------
    K : float [unit of the output per unit of the drive]
        Steady state at the depth.
    tau : float [s]
        Diffusion time, thickness² over diffusivity.
    biot, biot_far : float [1]
        Heat transfer of the heated and of the other face, times thickness over conductivity.
    depth : float [1]
        Below the heated face, as a share of the thickness.
    """

    K: float
    tau: float
    biot: float
    biot_far: float
    depth: float

    kind: ClassVar[str] = "slab"
    searched: ClassVar[tuple[str, ...]] = ("tau", "biot", "biot_far", "depth")
    gains: ClassVar[tuple[str, ...]] = ("K",)
    fixed: ClassVar[dict[str, float]] = {}

    def __post_init__(self) -> None:
        sound = min(self.tau, self.biot, self.biot_far) > 0 and 0 < self.depth <= 1
        if not sound or not np.isfinite([self.K, self.tau, self.biot, self.biot_far]).all():
            raise ModelError(
                f"slab needs finite K, tau, biot, biot_far > 0 and 0 < depth <= 1 (K={self.K:g}, "
                f"tau={self.tau:g}, biot={self.biot:g}, biot_far={self.biot_far:g}, "
                f"depth={self.depth:g})"
            )

    def transfer(self, s: Complex) -> Complex:
        """K·θ(s)/θ(0).

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
            Off the poles, which lie on the negative real axis.
        """
        p = np.sqrt(np.asarray(s, complex) * self.tau)
        p = np.where(np.abs(p) < SMALL, SMALL, p)
        below = 1.0 - self.depth
        # Times 2 e^(−p), so that nothing overflows.
        above = 1 + np.exp(-2 * p * below) - self.biot_far * np.expm1(-2 * p * below) / p
        both = self.biot + self.biot_far
        under = (
            both * (1 + np.exp(-2 * p)) - (p**2 + self.biot * self.biot_far) * np.expm1(-2 * p) / p
        )
        steady = (1 + self.biot_far * below) / (both + self.biot * self.biot_far)
        return self.K / steady * np.exp(-p * self.depth) * above / under

    def dc_gain(self) -> float:
        """K."""
        return self.K

    def step(self, t: Float) -> Float:
        """Unit-step response; zero for t ≤ 0.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        return diffusive_step(self.transfer, t)

    def slowest(self) -> float:
        """Slowest time constant, τ/μ² by the least root of tan μ = μ (B₀ + B₁)/(μ² − B₀B₁) [s]."""
        # Imported on use: the stream reads models and needs no root finder.
        from scipy.optimize import brentq

        both, product = self.biot + self.biot_far, self.biot * self.biot_far

        def characteristic(mu: float) -> float:
            return both * float(np.cos(mu)) + (product - mu**2) * float(np.sinc(mu / np.pi))

        return self.tau / float(brentq(characteristic, 0.0, np.pi, xtol=1e-14, rtol=1e-14)) ** 2

    def modes(self, dt: float) -> Modes:
        """The response as exponentials, for samples of `dt` or longer [s].

        Parameters
        ----------
        dt : float [s]
        """
        return diffusive_modes(self, 1 / self.slowest(), self.depth**2 * self.tau, dt)

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            None.
        """
        return {
            "tau": (period / 10, 50 * duration),
            "biot": BIOT_RANGE,
            "biot_far": BIOT_RANGE,
            "depth": DEPTH_RANGE,
        }

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Coarse grid: slow time constant, heat transfer of both faces, and depth.

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            None.
        """
        slow = duration * np.array([0.05, 0.2, 0.5, 1.0])
        faces = ((0.1, 0.1), (0.3, 3.0), (3.0, 0.3), (3.0, 3.0), (0.1, 30.0))
        return [
            (tau / cls(1.0, 1.0, *biots, depth).slowest(), *biots, depth)
            for tau, biots, depth in itertools.product(slow.tolist(), faces, (0.05, 0.4, 0.9))
        ]
