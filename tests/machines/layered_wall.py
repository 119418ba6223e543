"""Walls of two materials: layers with a joint between, or a block behind the back face.

Heated on the front and read on the far side, both faces losing heat to the air: finite volumes of
unequal conductances and capacities, of numpy alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LayeredWall:
    """Layers of unit area, one behind the other; the thermocouple sits on the last one's far side.

    Parameters
    ----------
    thickness : tuple of float [m]
    conductivity : tuple of float [W/(m K)]
        A layer of no thickness in cells (``cells`` of 1) is a block of one temperature.
    capacity : tuple of float [J/(m³ K)]
    joint : tuple of float [W/(m² K)]
        Conductance between a layer and the next one.
    film, back_film : float [W/(m² K)]
    cells : tuple of int
    """

    thickness: tuple[float, ...]
    conductivity: tuple[float, ...]
    capacity: tuple[float, ...]
    joint: tuple[float, ...]
    film: float
    back_film: float
    cells: tuple[int, ...]

    def modes(self) -> tuple[Array, Array, Array]:
        """Rates [1/s], what the flux feeds into each mode, and what the back face shows of it."""
        stored, half = [], []
        for thick, conducts, holds, count in zip(
            self.thickness, self.conductivity, self.capacity, self.cells, strict=True
        ):
            stored += [holds * thick / count] * count
            half += [thick / count / conducts / 2] * count
        ends = np.cumsum(self.cells)[:-1] - 1
        joints = dict(zip(ends.tolist(), self.joint, strict=True))
        n = len(stored)
        exchange = np.zeros((n, n))
        for k in range(n - 1):
            resistance = half[k] + half[k + 1] + (1 / joints[k] if k in joints else 0.0)
            exchange[k : k + 2, k : k + 2] += np.array([[-1.0, 1.0], [1.0, -1.0]]) / resistance
        exchange[0, 0] -= self.film
        exchange[-1, -1] -= self.back_film
        root = np.sqrt(np.array(stored))
        rates, vectors = np.linalg.eigh(exchange / np.outer(root, root))
        return rates, vectors[0] / root[0], vectors[-1] / root[-1]

    def time_constants(self) -> Array:
        """The slowest first [s]."""
        return np.sort(-1 / self.modes()[0])[::-1]

    def back_face(self, flux: Array, dt: float) -> Array:
        """Rise of the far side [K], from rest, for a flux [W/m²] held from row to row."""
        rates, fed, shown = self.modes()
        stays, grown = np.exp(rates * dt), np.expm1(rates * dt) / rates * fed
        x, out = np.zeros(len(rates)), np.empty(len(flux))
        for k, q in enumerate(flux):
            out[k] = shown @ x
            x = stays * x + grown * q
        return out
