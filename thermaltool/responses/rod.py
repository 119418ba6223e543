"""Temperature along a bar that is heated at one place and loses heat along its side.

One-dimensional conduction in a fin of finite length with insulated ends (Carslaw & Jaeger 1959,
sec. 4.5). With p = √(s τ + m), y the place of the heat and x that of the probe beyond it, both as
shares of the length, it is

    θ(s) = cosh(p y) cosh(p (1 − x)) / (p sinh p),

a sum of modes at the rates (m + (n π)²)/τ.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.relaxation import diffusive_modes, diffusive_step

# Losses along the side that a fit admits: as good as none, and no heat at the far end.
LOSS_RANGE: Range = (1e-3, 1e2)
# Places of the probe that a fit admits.
PLACE_RANGE: Range = (1e-2, 0.999)


@dataclass(frozen=True)
class Rod:
    """Rise at a place of a bar per unit of the heat that enters at another.

    Attributes
    ----------
    K : float [unit of the output per unit of the drive]
        Steady state at the probe.
    tau : float [s]
        Diffusion time, length² over diffusivity.
    loss : float [1]
        Heat transfer of the side times length² over conductivity and section.
    probe : float [1]
        From the end beside the heat, as a share of the length.
    source : float [1]
        Place of the heat, between that end and the probe.
    """

    K: float
    tau: float
    loss: float
    probe: float
    source: float = 0.0

    kind: ClassVar[str] = "rod"
    searched: ClassVar[tuple[str, ...]] = ("tau", "loss", "probe")
    gains: ClassVar[tuple[str, ...]] = ("K",)
    fixed: ClassVar[dict[str, float]] = {"source": 0.0}

    def __post_init__(self) -> None:
        sound = min(self.tau, self.loss) > 0 and 0 <= self.source < self.probe <= 1
        if not sound or not np.isfinite([self.K, self.tau, self.loss]).all():
            raise ModelError(
                f"rod needs finite K, tau, loss > 0 and 0 <= source < probe <= 1 (K={self.K:g}, "
                f"tau={self.tau:g}, loss={self.loss:g}, probe={self.probe:g}, "
                f"source={self.source:g})"
            )

    def transfer(self, s: Complex) -> Complex:
        """K·θ(s)/θ(0).

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
            Off the poles, which lie on the negative real axis.
        """
        p = np.sqrt(np.asarray(s, complex) * self.tau + self.loss)
        return self.K * self._shape(p) / self._shape(np.sqrt(np.array([self.loss + 0j])))[0].real

    def _shape(self, p: Complex) -> Complex:
        # Exponentials that only fall, so that nothing overflows.
        beyond = 1 + np.exp(-2 * p * (1 - self.probe))
        before = 1 + np.exp(-2 * p * self.source)
        fall = np.exp(-p * (self.probe - self.source))
        return np.asarray(fall * beyond * before / (-2 * p * np.expm1(-2 * p)))

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
        """Slowest time constant, τ/m [s]."""
        return self.tau / self.loss

    def modes(self, dt: float) -> Modes:
        """The response as exponentials, for samples of `dt` or longer [s].

        Parameters
        ----------
        dt : float [s]
        """
        delay = (self.probe - self.source) ** 2 * self.tau
        return diffusive_modes(self, self.loss / self.tau, delay, dt)

    @classmethod
    def search_box(cls, period: float, duration: float, **fixed: float) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            source [1].
        """
        return {
            "tau": (period / 10, 50 * duration),
            "loss": LOSS_RANGE,
            "probe": (max(PLACE_RANGE[0], 1.001 * fixed["source"]), PLACE_RANGE[1]),
        }

    @classmethod
    def starts(cls, period: float, duration: float, **fixed: float) -> list[tuple[float, ...]]:
        """Coarse grid: slow time constant, loss, and place of a probe that the records show.

        Parameters
        ----------
        period, duration : float [s]
        **fixed : float
            source [1].
        """
        slow = duration * np.array([0.05, 0.2, 0.5, 1.0])
        shares = fixed["source"] + (1 - fixed["source"]) * np.array([0.05, 0.3, 0.6, 0.95])
        grid = itertools.product(slow.tolist(), (0.03, 0.3, 3.0, 20.0), shares.tolist())
        least, _ = cls.search_box(period, duration, **fixed)["tau"]
        found = [(max(tau * loss, least), loss, probe) for tau, loss, probe in grid]
        return [each for each in found if (each[2] - fixed["source"]) ** 2 * each[0] < duration]
