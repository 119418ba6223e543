"""A wall heated on one face and measured on the other: finite volumes, of numpy alone.

After the flux sensors of heat shields: a metal slab takes the heat of a re-entry on its front and
loses it on both faces; a thermocouple sits on the back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Wall:
    """A slab of unit area in equal cells.

    Parameters
    ----------
    thickness : float [m]
    conductivity : float [W/(m K)]
    capacity : float [J/(m³ K)]
    film : float [W/(m² K)]
        Of each face.
    back_film : float, optional [W/(m² K)]
        Of the back, where it is another one.
    cells : int
    """

    thickness: float = 0.020
    conductivity: float = 16.0
    capacity: float = 3.9e6
    film: float = 65.0
    cells: int = 40
    back_film: float | None = None

    def matrices(self) -> tuple[Array, Array, Array]:
        """A [1/s], b [K/s per W/m²] and the row of the back face: x' = A x + b q, y = c x."""
        n, cell = self.cells, self.thickness / self.cells
        between = self.conductivity / cell
        exchange = np.zeros((n, n))
        for k in range(n - 1):
            exchange[k : k + 2, k : k + 2] += between * np.array([[-1.0, 1.0], [1.0, -1.0]])
        exchange[0, 0] -= self.film
        exchange[-1, -1] -= self.film if self.back_film is None else self.back_film
        b = np.zeros(n)
        b[0] = 1.0
        c = np.zeros(n)
        c[-1] = 1.0
        stored = self.capacity * cell
        return exchange / stored, b / stored, c

    def time_constants(self) -> Array:
        """The slowest first [s]."""
        return np.sort(-1 / np.linalg.eigvalsh(self.matrices()[0]))[::-1]

    def recursion(self, dt: float) -> tuple[Array, Array, Array]:
        """F, g, c of a sample of `dt` [s] with the flux held: x ← F x + g q."""
        A, b, c = self.matrices()
        rates, vectors = np.linalg.eigh(A)  # equal cells: A is symmetric
        grown = np.expm1(rates * dt) / rates
        F = (vectors * np.exp(rates * dt)) @ vectors.T
        return F, vectors @ (grown * (vectors.T @ b)), c

    def back_face(self, flux: Array, dt: float) -> Array:
        """Rise of the back face [K], from rest, for a flux [W/m²] held from row to row."""
        F, g, c = self.recursion(dt)
        x, out = np.zeros(self.cells), np.empty(len(flux))
        for k, q in enumerate(flux):
            out[k] = c @ x
            x = F @ x + g * q
        return out


def reentry(time: Array, generator: np.random.Generator, peak: float) -> Array:
    """A flux that rises in steps, stays, and falls again [W/m²]: 12 to 60 s a step."""
    flux = np.zeros(len(time))
    start = time[0] + generator.uniform(60.0, 120.0)
    heights = peak * np.array([0.15, 0.4, 0.75, 1.0, 0.8, 0.5, 0.2, 0.0])
    for height in heights * generator.uniform(0.85, 1.0, len(heights)):
        flux[time >= start] = height
        start += generator.uniform(40.0, 160.0)
    return flux
