"""Sections: what N poles are made of, two poles each, of an odd number one alone.

A section of second order is ω²/(s² + 2ζωs + ω²) and ωs/(s² + 2ζωs + ω²), for a pair (ζ < 1) and for
two real poles (ζ > 1) alike, so that a search goes from one to the other without a break; one of
first order is 1/(τs + 1). All are searched by logarithms: stable whatever a step is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from thermaltool.fitting.data import Array
from thermaltool.units import Hold

Complex = NDArray[np.complex128]

# Poles are kept apart by this share of their size: partial fractions of a double pole have none.
MIN_GAP = 1e-3
# Rates [1/sample period] up to which a response to a ramp is a power series.
MAX_SERIES_RATE = 1e-3


@dataclass(frozen=True)
class PoleSection:
    """One section.

    Attributes
    ----------
    theta : tuple of float
        ln ω and ln ζ, or −ln τ; ω and 1/τ in radians by sample period.
    """

    theta: tuple[float, ...]

    @property
    def states(self) -> int:
        """Number of poles."""
        return len(self.theta)

    @property
    def is_pair(self) -> bool:
        """Whether the poles are complex."""
        return bool(self.poles[0].imag)

    @cached_property
    def poles(self) -> Complex:
        """Poles in s, the slowest first [1/sample period]."""
        if self.states == 1:
            return np.array([-np.exp(self.theta[0])], complex)
        omega, zeta = np.exp(self.theta)
        if zeta < 1:
            damped = 1j * np.sqrt(max(1 - zeta**2, MIN_GAP**2 / 4))
            return np.asarray(omega * np.array([-zeta + damped, -zeta - damped]))
        fast = zeta + np.sqrt(max(zeta**2 - 1, MIN_GAP**2 / 4))
        return np.array([-omega / fast, -omega * fast], complex)

    def recursion(self, hold: Hold) -> tuple[Array, Array]:
        """Numerators and denominator in 1/q of what the input makes of each state.

        Parameters
        ----------
        hold : "zero" or "first"

        Returns
        -------
        numerators : ndarray, shape (states, states + 1)
        denominator : ndarray, shape (states + 1,)
        """
        n = self.states
        if n == 1:
            return _lag_recursion(float(np.exp(self.theta[0])), hold)
        held = np.zeros((n + 2, n + 2))
        held[:n, : n + 1] = self._continuous()
        held[n, n + 1] = 1.0
        grown = expm(held)
        F, whole, ramp = grown[:n, :n], grown[:n, n], grown[:n, n + 1]
        later = ramp if hold == "first" else np.zeros(n)
        before = whole - later
        turned = F - np.trace(F) * np.eye(2)
        numerators = np.column_stack([later, before + turned @ later, turned @ before])
        # The product of the poles: the determinant of F cancels where they are slow.
        return numerators, np.array([1.0, -np.trace(F), np.exp(self.poles.sum().real)])

    def _continuous(self) -> Array:
        """The matrix of two states and the column of the input, side by side."""
        omega, zeta = np.exp(self.theta)
        return np.asarray(omega * np.array([[0.0, 1.0, 0.0], [-1.0, -2 * zeta, 1.0]]))

    def free(self, rows: int) -> Array:
        """What any state at the first row leaves behind, shape (states, rows).

        Parameters
        ----------
        rows : int
        """
        time = np.arange(rows)
        p = self.poles
        if self.states == 1:
            return np.exp(p.real[:, None] * time)
        if p[0].imag:
            decay = np.exp(p[0].real * time)
            return np.array([decay * np.cos(p[0].imag * time), decay * np.sin(p[0].imag * time)])
        slow, fast = np.exp(p.real[:, None] * time)
        return np.array([slow, (slow - fast) / (1 - p[0].real / p[1].real)])


def _lag_recursion(rate: float, hold: Hold) -> tuple[Array, Array]:
    """As `PoleSection.recursion`, of one pole."""
    whole = -np.expm1(-rate)
    later = 0.0
    if hold == "first":
        # 1 - whole / rate, which cancels where the pole is slow.
        slow = rate / 2 - rate**2 / 6 + rate**3 / 24 - rate**4 / 120
        later = slow if rate < MAX_SERIES_RATE else 1 - whole / rate
    return np.array([[later, whole - later]]), np.array([1.0, -np.exp(-rate)])


def moved(sections: tuple[PoleSection, ...], step: Array) -> tuple[PoleSection, ...]:
    """Sections after a step of all their logarithms.

    Parameters
    ----------
    sections : tuple of PoleSection
    step : ndarray, shape (N,)
    """
    found, at = [], 0
    for section in sections:
        n = section.states
        found.append(PoleSection(tuple((np.array(section.theta) + step[at : at + n]).tolist())))
        at += n
    return tuple(found)


def of_poles(poles: Complex) -> tuple[PoleSection, ...]:
    """Sections of poles in s: pairs, then real ones two by two, the slowest of an odd number alone.

    Parameters
    ----------
    poles : ndarray, shape (N,) [1/sample period]
    """
    found = [
        PoleSection((float(np.log(abs(p))), float(np.log(-p.real / abs(p)))))
        for p in poles[poles.imag > 0]
    ]
    rates = np.sort(-poles[poles.imag == 0].real)
    if len(rates) % 2:
        found.append(PoleSection((float(np.log(rates[0])),)))
        rates = rates[1:]
    for slow, fast in zip(rates[::2], rates[1::2], strict=True):
        omega = float(np.sqrt(slow * fast))
        found.append(
            PoleSection((float(np.log(omega)), float(np.log((slow + fast) / (2 * omega)))))
        )
    return tuple(found)


def all_poles(sections: tuple[PoleSection, ...]) -> Complex:
    """Poles of all sections in s, section by section [1/sample period]."""
    return np.concatenate([section.poles for section in sections])


def responses(section: PoleSection, inputs: Array, holds: tuple[Hold, ...]) -> Array:
    """Both states for every input, from rest with an input of zero before the first row.

    Parameters
    ----------
    section : PoleSection
    inputs : ndarray, shape (m, n)
    holds : tuple of "zero" or "first", one for each input

    Returns
    -------
    ndarray, shape (m · states, n)
        Input by input.
    """
    found = np.empty((len(inputs), section.states, inputs.shape[1]))
    for hold in set(holds):
        own = np.flatnonzero([each == hold for each in holds])
        numerators, denominator = section.recursion(hold)
        for k, numerator in enumerate(numerators):
            found[own, k] = lfilter(numerator, denominator, inputs[own], axis=-1)
    return found.reshape(-1, inputs.shape[1])


def combined(section: PoleSection, inputs: Array, holds: tuple[Hold, ...], weights: Array) -> Array:
    """What some outputs take of a section, all inputs together, shape (p, n).

    Parameters
    ----------
    section : PoleSection
    inputs : ndarray, shape (m, n)
    holds : tuple of "zero" or "first"
    weights : ndarray, shape (p, m · states)
        As the rows of `responses`.
    """
    p, n, states = len(weights), inputs.shape[1], section.states
    each = weights.reshape(p, len(inputs), states)
    driven = np.zeros((p, n))
    denominator = np.ones(1)
    for hold in set(holds):
        own = np.flatnonzero([one == hold for one in holds])
        numerators, denominator = section.recursion(hold)
        lags = np.einsum("pms,sk->kpm", each[:, own], numerators)
        for k, lag in enumerate(lags):
            if np.any(lag):
                driven[:, k:] += lag @ inputs[own, : n - k]
    return np.asarray(lfilter([1.0], denominator, driven, axis=-1))
