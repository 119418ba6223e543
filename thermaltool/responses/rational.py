"""Rational transfer functions with delay, as sums of first-order lags and one damped oscillation.

Every stable rational function without direct feedthrough and without repeated poles is of this
form; with real poles it is a table of time constants and weights, as heat conduction has them
(Zhu, Ni, Shih 2008: T = Σ A_k (1 − e^(−t/τ_k))). Mareš et al. use second order.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import make_dataclass
from typing import Any, ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.parameters import check_parameters


class Rational:
    """H(s) = e^(−Ls) [Σ K_i/(τ_i s + 1) + (K ω² + D ω s)/(s² + 2ζω s + ω²)].

    The kinds below say how many lags there are and whether there is an oscillation.

    Attributes
    ----------
    K1, K2, ... : float [unit of the output per unit of the drive]
    tau1, tau2, ... : float [s]
    K, D : float [unit of the output per unit of the drive]
    omega : float [rad/s]
    zeta : float, between 0 and 1
    delay : float [s]
        L. A fit takes it as given (`calibrate` compares some); ``identify`` finds it.
    """

    kind: ClassVar[str]
    searched: ClassVar[tuple[str, ...]]
    gains: ClassVar[tuple[str, ...]]
    fixed: ClassVar[dict[str, float]] = {"delay": 0.0}
    delay: float

    def __post_init__(self) -> None:
        check_parameters(self, "finite values above zero, and zeta below 1")
        if not 0 <= self.delay < np.inf:
            raise ModelError(f"{self.kind} needs a finite delay of 0 or more ({self.delay:g})")

    def _lags(self) -> Iterator[tuple[float, float]]:
        """(gain, time constant) of every lag."""
        for name in self.searched:
            if name.startswith("tau"):
                yield getattr(self, "K" + name[3:]), getattr(self, name)

    def _oscillation(self) -> tuple[complex, complex] | None:
        """Pole with positive imaginary part, and its residue."""
        if "omega" not in self.searched:
            return None
        K, D, w, zeta = (getattr(self, name) for name in ("K", "D", "omega", "zeta"))
        damped = w * np.sqrt(1 - zeta**2)
        pole = complex(-zeta * w, damped)
        return pole, (K * w**2 + D * w * pole) / (2j * damped)

    def transfer(self, s: Complex) -> Complex:
        """H at complex frequencies, ndarray of any shape [rad/s].

        Parameters
        ----------
        s : ndarray, any shape, complex [rad/s]
        """
        s = np.asarray(s, complex)
        value = np.zeros(s.shape, complex)
        for gain, tau in self._lags():
            value = value + gain / (tau * s + 1)
        if "omega" in self.searched:
            K, D, w, zeta = (getattr(self, name) for name in ("K", "D", "omega", "zeta"))
            value = value + (K * w**2 + D * w * s) / (s**2 + 2 * zeta * w * s + w**2)
        return np.asarray(value * np.exp(-s * self.delay))

    def dc_gain(self) -> float:
        """Sum of the gains."""
        return float(sum(gain for gain, _ in self._lags()) + getattr(self, "K", 0.0))

    def step(self, t: Float) -> Float:
        """Unit-step response; zero before the delay has passed.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        t = np.maximum(np.asarray(t, float) - self.delay, 0.0)
        value = np.zeros(t.shape)
        for gain, tau in self._lags():
            value = value - gain * np.expm1(-t / tau)
        section = self._oscillation()
        if section is not None:
            pole, residue = section
            value = value + 2 * (residue / pole * np.expm1(pole * t)).real
        return np.asarray(value)

    def slowest(self) -> float:
        """Slowest time constant [s]."""
        section = self._oscillation()
        times = [tau for _, tau in self._lags()]
        return max([*times, *([] if section is None else [-1 / section[0].real])])

    def partial_fractions(self) -> tuple[Complex, Complex]:
        """Poles p and residues w of Σ w/(s − p) without the delay, both of a pair [1/s]."""
        poles: list[complex] = [complex(-1 / tau) for _, tau in self._lags()]
        weights: list[complex] = [complex(gain / tau) for gain, tau in self._lags()]
        section = self._oscillation()
        if section is not None:
            poles += [section[0], section[0].conjugate()]
            weights += [section[1], section[1].conjugate()]
        return np.array(poles), np.array(weights)

    def modes(self, dt: float) -> Modes:
        """Exact; `dt` does not matter.

        Parameters
        ----------
        dt : float [s]
        """
        poles, weights = self.partial_fractions()
        kept = poles.imag >= 0
        parts = poles[kept], weights[kept]
        return DelayedModes(*parts, delay=self.delay) if self.delay else Modes(*parts)

    @classmethod
    def search_box(cls, period: float, duration: float, delay: float = 0.0) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        delay : float [s]
        """
        lags, turns = (period / 4, 50 * duration), (0.02 / duration, 4 / period)
        ranges = {"omega": turns, "zeta": (0.01, 0.999)}
        return {name: ranges.get(name, lags) for name in cls.searched}

    @classmethod
    def starts(cls, period: float, duration: float, delay: float = 0.0) -> list[tuple[float, ...]]:
        """Coarse grid: every choice of distinct time constants; rates and dampings.

        Parameters
        ----------
        period, duration : float [s]
        delay : float [s]
        """
        lags = sum(name.startswith("tau") for name in cls.searched)
        count = {0: 0, 1: 12, 2: 7, 3: 6}.get(lags, lags + 2)
        times = np.geomspace(duration, max(duration / 300, 2 * period), count).tolist()
        chosen = list(itertools.combinations(times, lags))
        if "omega" not in cls.searched:
            return chosen
        rates = (1 / np.geomspace(duration, max(duration / 30, 2 * period), 5)).tolist()
        turns = itertools.product(rates, (0.2, 0.5, 0.8))
        return [(*turn, *place) for turn, place in itertools.product(turns, chosen)]


def _kind(lags: int, oscillation: bool = False) -> Any:
    """The class of so many lags, with a damped oscillation or without."""
    gains, places = (("K", "D"), ("omega", "zeta")) if oscillation else ((), ())
    lag_gains, taus = ([f"{name}{k}" for k in range(1, lags + 1)] for name in ("K", "tau"))
    name = f"Oscillation{lags or ''}" if oscillation else f"Rational{lags}"
    parts = [*gains, *places, *itertools.chain(*zip(lag_gains, taus, strict=True))]
    oscillating = "one damped oscillation and " if oscillation else ""
    return make_dataclass(
        name,
        [*((part, float) for part in parts), ("delay", float, 0.0)],
        bases=(Rational,),
        frozen=True,
        namespace={
            "__doc__": f"A response of {oscillating}{lags} lags; see `Rational`.",
            "__module__": __name__,
            "kind": name.lower(),
            "searched": (*places, *taus),
            "gains": (*gains, *lag_gains),
        },
    )


Rational1, Rational2, Rational3, Rational4, Rational5 = (_kind(k) for k in range(1, 6))
Rational6, Rational7, Rational8, Rational9, Rational10 = (_kind(k) for k in range(6, 11))
Oscillation, Oscillation1, Oscillation2 = (_kind(k, True) for k in range(3))

# By their number of lags and of oscillations.
KINDS: dict[tuple[int, int], Any] = {
    (sum(name.startswith("tau") for name in cls.searched), int("omega" in cls.searched)): cls
    for cls in (
        Rational1,
        Rational2,
        Rational3,
        Rational4,
        Rational5,
        Rational6,
        Rational7,
        Rational8,
        Rational9,
        Rational10,
        Oscillation,
        Oscillation1,
        Oscillation2,
    )
}
