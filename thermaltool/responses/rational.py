"""Rational transfer functions, as sums of first-order lags, damped oscillations and feedthrough.

Every stable proper rational function without repeated poles is of this form; with real poles it is
a table of time constants and weights, as heat conduction has them (Zhu, Ni, Shih 2008: T = Σ A_k (1
− e^(−t/τ_k))). Mareš et al. use second order.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import make_dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Complex, Float, Modes, Range
from thermaltool.responses.parameters import check_parameters, step_of

# Lags, oscillations and feedthrough of a kind, by its name.
NAMES = re.compile(r"(?:rational(\d+)|oscillation(\d*)|oscillations(\d+)_(\d+))(_direct)?")
# Poles of a kind, at most.
MAX_POLES = 12
# Starts of a fit, at most, where a grid of all parameters would have more.
MAX_STARTS = 400


class Rational:
    """H(s) = e^(−Ls) [Σ K_i/(τ_i s + 1) + Σ (K ω² + D ω s)/(s² + 2ζω s + ω²) + K0].

    The kinds say how many lags and oscillations there are, and whether there is feedthrough;
    those with feedthrough have no delay.

    Attributes
    ----------
    K1, K2, ... : float [unit of the output per unit of the drive]
    tau1, tau2, ... : float [s]
    K, D, Kp2, Dp2, ... : float [unit of the output per unit of the drive]
        Of the first oscillation, and of others.
    omega, omega2, ... : float [rad/s]
    zeta, zeta2, ... : float, between 0 and 1
    K0 : float [unit of the output per unit of the drive]
        Direct feedthrough: the output follows the drive of the same row.
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

    @property
    def direct(self) -> float:
        """Direct feedthrough; 0 of kinds without."""
        return float(getattr(self, "K0", 0.0))

    def _oscillations(self) -> Iterator[tuple[float, float, float, float]]:
        """(K, D, omega, zeta) of every oscillation."""
        for name in self.searched:
            if name.startswith("omega"):
                names = oscillation_names(int(name[5:] or 1))
                K, D, omega, zeta = (float(getattr(self, each)) for each in names)
                yield K, D, omega, zeta

    def _pairs(self) -> Iterator[tuple[complex, complex]]:
        """Pole with positive imaginary part, and its residue, of every oscillation."""
        for K, D, w, zeta in self._oscillations():
            damped = w * np.sqrt(1 - zeta**2)
            pole = complex(-zeta * w, damped)
            yield pole, (K * w**2 + D * w * pole) / (2j * damped)

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
        for K, D, w, zeta in self._oscillations():
            value = value + (K * w**2 + D * w * s) / (s**2 + 2 * zeta * w * s + w**2)
        return np.asarray((value + self.direct) * np.exp(-s * self.delay))

    def dc_gain(self) -> float:
        """Sum of the gains."""
        gains = [gain for gain, _ in self._lags()] + [K for K, *_ in self._oscillations()]
        return float(sum(gains) + self.direct)

    def step(self, t: Float) -> Float:
        """Unit-step response; zero before the delay has passed, at t = 0 the feedthrough.

        Parameters
        ----------
        t : ndarray, any shape [s]
        """
        begun = np.asarray(t) >= 0
        t = np.maximum(np.asarray(t, float) - self.delay, 0.0)
        return step_of(self, t) - self.direct * ~begun

    @classmethod
    def unit_steps(cls, t: Float, **searched: float) -> tuple[Float, Float]:
        """`step` and `dc_gain` with each gain at one and the others at zero; no delay.

        Parameters
        ----------
        t : ndarray, shape (m,) [s]
            Zero or later.
        **searched : float
            Time constants, rates and dampings by name.

        Returns
        -------
        steps : ndarray, shape (m, gains)
        steady : ndarray, shape (gains,)
        """
        columns, steady = [], []
        for name in cls.searched:
            if name.startswith("omega"):
                w, zeta = searched[name], searched["zeta" + name[5:]]
                pole = complex(-zeta * w, w * np.sqrt(1 - zeta**2))
                course = np.expm1(pole * t) / (1j * pole.imag * pole)
                columns += [(w**2 * course).real, (w * pole * course).real]
                steady += [1.0, 0.0]
        taus = [searched[name] for name in cls.searched if name.startswith("tau")]
        columns += list(-np.expm1(-t / np.array(taus)[:, None]))
        steady += [1.0] * len(taus)
        if "K0" in cls.gains:
            columns.append(np.ones(len(t)))
            steady.append(1.0)
        return np.column_stack(columns), np.array(steady)

    def slowest(self) -> float:
        """Slowest time constant [s]."""
        times = [tau for _, tau in self._lags()]
        return max([*times, *(-1 / pole.real for pole, _ in self._pairs())])

    def partial_fractions(self) -> tuple[Complex, Complex]:
        """Poles p and residues w of Σ w/(s − p), both of a pair [1/s]; no delay, no feedthrough."""
        poles: list[complex] = [complex(-1 / tau) for _, tau in self._lags()]
        weights: list[complex] = [complex(gain / tau) for gain, tau in self._lags()]
        for pole, residue in self._pairs():
            poles += [pole, pole.conjugate()]
            weights += [residue, residue.conjugate()]
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
        if self.delay:
            return DelayedModes(*parts, delay=self.delay)
        return Modes(*parts, direct=self.direct)

    @classmethod
    def search_box(cls, period: float, duration: float, delay: float = 0.0) -> dict[str, Range]:
        """Where a fit looks, from the sample period and the length of the records [s].

        Parameters
        ----------
        period, duration : float [s]
        delay : float [s]
        """
        lags, turns = (period / 4, 50 * duration), (0.02 / duration, 4 / period)
        ranges = {"omega": turns, "zeta": (0.01, 0.999), "tau": lags}
        return {name: ranges[name.rstrip("0123456789")] for name in cls.searched}

    @classmethod
    def starts(cls, period: float, duration: float, delay: float = 0.0) -> list[tuple[float, ...]]:
        """Coarse grid: every choice of distinct time constants; rates and dampings.

        Parameters
        ----------
        period, duration : float [s]
        delay : float [s]
        """
        lags, pairs = (sum(n.startswith(part) for n in cls.searched) for part in ("tau", "omega"))
        count = {0: 0, 1: 12, 2: 7, 3: 6}.get(lags, lags + 2)
        times = np.geomspace(duration, max(duration / 300, 2 * period), count).tolist()
        chosen = list(itertools.combinations(times, lags))
        if not pairs:
            return chosen
        rates = (1 / np.geomspace(duration, max(duration / 30, 2 * period), 4 + pairs)).tolist()
        turns = itertools.product(itertools.combinations(rates, pairs), (0.2, 0.5, 0.8))
        found = [
            (*itertools.chain(*((rate, zeta) for rate in each)), *place)
            for (each, zeta), place in itertools.product(turns, chosen)
        ]
        return found[:: max(1, -(-len(found) // MAX_STARTS))]


def oscillation_names(k: int) -> tuple[str, str, str, str]:
    """Names of K, D, omega and zeta of oscillation k, counted from 1."""
    return ("K", "D", "omega", "zeta") if k == 1 else (f"Kp{k}", f"Dp{k}", f"omega{k}", f"zeta{k}")


@lru_cache
def rational_kind(lags: int, pairs: int, direct: bool = False) -> Any:
    """The class of so many lags and damped oscillations, with feedthrough or without.

    Parameters
    ----------
    lags, pairs : int
    direct : bool

    Raises
    ------
    ModelError
        No pole, or more than `MAX_POLES`.
    """
    if not 0 < lags + 2 * pairs <= MAX_POLES:
        raise ModelError(
            f"no kind of response has {lags} lags and {pairs} oscillations: 1 to {MAX_POLES} poles"
        )
    turning = [oscillation_names(k) for k in range(1, pairs + 1)]
    lag_gains, taus = ([f"{name}{k}" for k in range(1, lags + 1)] for name in ("K", "tau"))
    name = f"Rational{lags}"
    if pairs:
        name = f"Oscillation{lags or ''}" if pairs == 1 else f"Oscillations{pairs}_{lags}"
    parts = [*itertools.chain(*turning), *itertools.chain(*zip(lag_gains, taus, strict=True))]
    fields: list[Any] = [(part, float) for part in parts]
    extra: dict[str, Any] = {"delay": 0.0, "fixed": {}} if direct else {}
    fields.append(("K0", float) if direct else ("delay", float, 0.0))
    oscillating = f"{pairs} damped oscillations and " if pairs else ""
    return make_dataclass(
        name + "_direct" * direct,
        fields,
        bases=(Rational,),
        frozen=True,
        namespace={
            "__doc__": f"A response of {oscillating}{lags} lags; see `Rational`.",
            "__module__": __name__,
            "kind": name.lower() + "_direct" * direct,
            "searched": (*(n for names in turning for n in names[2:]), *taus),
            "gains": (*(n for names in turning for n in names[:2]), *lag_gains,
                      *(["K0"] if direct else [])),
            **extra,
        },
    )  # fmt: skip


def rational_by_name(kind: str) -> Any:
    """The class of a kind by its name; None where no rational kind has it.

    Parameters
    ----------
    kind : str
        As ``rational3``, ``oscillation1``, ``oscillations2_3``; with ``_direct`` behind it.
    """
    named = NAMES.fullmatch(kind)
    if named is None:
        return None
    real, beside_one, pairs, beside, direct = named.groups()
    lags = int(real or beside_one or beside or 0)
    count = 0 if real else int(pairs or 1)
    if not 0 < lags + 2 * count <= MAX_POLES:
        return None
    found = rational_kind(lags, count, direct is not None)
    # One name for each: not rational03.
    return found if found.kind == kind else None


def __getattr__(name: str) -> Any:
    """Classes of the family by their name, as pickle asks for them."""
    found = rational_by_name(name.lower())
    if found is None or found.__name__ != name:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return found


Rational1, Rational2, Rational3, Rational4, Rational5, Rational6 = (
    rational_kind(k, 0) for k in range(1, 7)
)
Oscillation, Oscillation1, Oscillation2 = (rational_kind(k, 1) for k in range(3))

# What transfer functions of one output are made of, by their number of lags and of oscillations.
KINDS: dict[tuple[int, int], Any] = {
    (sum(name.startswith("tau") for name in cls.searched), int("omega" in cls.searched)): cls
    for cls in (
        Rational1,
        Rational2,
        Rational3,
        Rational4,
        Rational5,
        Rational6,
        Oscillation,
        Oscillation1,
        Oscillation2,
    )
}
