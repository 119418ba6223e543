"""Chains of tubes: heat in finite volumes, bending by beam theory.

Every tube is cut along its axis and around its girth; each piece has one temperature, conducts to
its neighbours and to the air. Plane sections stay plane: the mean rise of a section stretches the
axis, the moment of the rises about it bends it (Boley and Weiner 1960, chapter 10), and both are
summed along the chain to the tool.

Chosen in place of finite elements, which `thermoelastic` has for the frame: there is no drawing for
a mesh, mean and moment of each section are all that the angle of a slender chain needs, and a
closed loop of a day runs in a tenth of a second. Left out are the temperature through the wall,
which settles in 4 wall²/(π² diffusivity), half a minute for 30 mm of steel and two minutes for
65 mm, warping of sections, and the give of joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECTORS = 8  # pieces around the girth: two a side of a square tube
MICROMETRES = 1e6  # per metre


@dataclass(frozen=True)
class Metal:
    """Conductivity [W/(m K)], heat capacity [J/(m³ K)], linear expansion [1/K]."""

    conductivity: float = 50.0
    capacity: float = 7850.0 * 470.0
    expansion: float = 11.7e-6


@dataclass(frozen=True)
class Tube:
    """A straight tube in the x-z plane.

    Attributes
    ----------
    start, end : (float, float) [m]
        x and z of its axis.
    width : float [m]
        Diameter, or side of a square.
    wall : float [m]
    segments : int
        Pieces along the axis.
    square : bool
    around : float
        Conduction around the girth, as a share of solid metal; below 1 where plates are joined.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    width: float
    wall: float
    segments: int
    square: bool = False
    around: float = 1.0

    @property
    def pieces(self) -> int:
        return self.segments * SECTORS

    @property
    def length(self) -> float:
        """Length between its ends [m]."""
        return float(np.hypot(*np.subtract(self.end, self.start)))

    @property
    def along(self) -> Array:
        """Unit vector of the axis."""
        return np.subtract(self.end, self.start) / self.length

    @property
    def girth(self) -> float:
        return (4.0 if self.square else np.pi) * self.width

    @property
    def piece(self) -> tuple[float, float]:
        """Length along the axis and width around the girth of a piece [m]."""
        return self.length / self.segments, self.girth / SECTORS

    def offsets(self) -> Array:
        """Distance of every sector from the axis, to the left of its direction, shape (8,) [m]."""
        if self.square:
            return self.width * np.array([0.5, 0.25, -0.25, -0.5, -0.5, -0.25, 0.25, 0.5])
        return self.width / 2 * np.cos(2 * np.pi * (np.arange(SECTORS) + 0.5) / SECTORS)

    def middles(self) -> Array:
        """Middle of each segment of the axis, shape (segments, 2) [m]."""
        share = (np.arange(self.segments) + 0.5) / self.segments
        return np.array(self.start) + share[:, None] * np.subtract(self.end, self.start)


@dataclass(frozen=True)
class Chain:
    """Tubes, each fixed to the end of the one before; pieces are numbered along the chain.

    Attributes
    ----------
    tubes : sequence of Tube
    metal : Metal
    foot : float
        Conductance from the first ring to the foundation, as a share of solid metal.
    """

    tubes: Sequence[Tube]
    metal: Metal
    foot: float

    @property
    def pieces(self) -> int:
        return sum(t.pieces for t in self.tubes)

    def at(self, tube: int, segment: int, sector: int) -> int:
        """Number of a piece; `segment` and `sector` count from 0, or from the end below it."""
        t = self.tubes[tube]
        before = sum(each.pieces for each in self.tubes[:tube])
        return before + segment % t.segments * SECTORS + sector % SECTORS

    def capacity(self) -> Array:
        """Heat capacity of every piece, shape (n,) [J/K]."""
        return self.metal.capacity * self._each([t.wall for t in self.tubes]) * self.surface()

    def surface(self) -> Array:
        """Outer surface of every piece, shape (n,) [m²]; the bore is closed."""
        return self._each([t.piece[0] * t.piece[1] for t in self.tubes])

    def _each(self, values: list[float]) -> Array:
        return np.repeat(values, [t.pieces for t in self.tubes])

    def conductance(self) -> Array:
        """Between pieces, and of the first ring to the foundation, shape (n, n) [W/K]."""
        G = np.zeros((self.pieces, self.pieces))
        k = self.metal.conductivity
        for number, t in enumerate(self.tubes):
            length, width = t.piece
            for segment in range(t.segments):
                for sector in range(SECTORS):
                    here, beside = (self.at(number, segment, s) for s in (sector, sector + 1))
                    join(G, here, beside, t.around * k * t.wall * length / width)
                    if segment:
                        before = self.at(number, segment - 1, sector)
                        join(G, here, before, k * t.wall * width / length)
            if number:
                last = self.tubes[number - 1]
                halves = (last.piece[0] / last.piece[1] / last.wall + length / width / t.wall) / 2
                for sector in range(SECTORS):
                    ends = self.at(number - 1, -1, sector), self.at(number, 0, sector)
                    join(G, *ends, k / halves)
        first = self.tubes[0]
        for sector in range(SECTORS):
            here = self.at(0, 0, sector)
            G[here, here] += self.foot * k * first.wall * first.piece[1] / (first.piece[0] / 2)
        return G

    def motion(self, point: tuple[float, float]) -> Array:
        """How a point fixed to the end of the chain moves, shape (3, n).

        Rows along x and z [µm/K], and the turn that carries z towards x [µrad/K].
        """
        rows = []
        for t in self.tubes:
            length, offsets = t.piece[0], t.offsets()
            stretch = self.metal.expansion * length / SECTORS * np.ones(SECTORS)
            # What lies left of the axis and is warmer turns the axis to the right.
            turn = self.metal.expansion * length * offsets / np.sum(offsets**2)
            for middle in t.middles():
                arm = np.subtract(point, middle)
                rows.append([t.along[0] * stretch + arm[1] * turn,
                             t.along[1] * stretch - arm[0] * turn, turn])  # fmt: skip
        return MICROMETRES * np.concatenate(rows, axis=1)


def join(G: Array, a: int, b: int, value: float) -> None:
    """Put a conductance between two pieces into G, shape (n, n), in place.

    Parameters
    ----------
    G : ndarray, shape (n, n) [W/K]
    a, b : int
    value : float [W/K]
    """
    G[[a, b], [a, b]] += value
    G[[a, b], [b, a]] -= value
