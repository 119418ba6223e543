"""A joint between two bodies: how stiff it is, how it slips and how much heat it passes.

The laws are those of Fraser (1997), section 4.4, for flat rough surfaces, in the units of its
constants: pressure in kg/cm², approach and shear in µm. Pairs of nodes carry them, each with the
area that it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KILOGRAM_PER_CM2 = 98066.5  # [Pa]
_MICROMETRE = 1e-6  # [m]
# Residual of the relative displacements at which the elastic problem counts as solved [µm].
TOLERANCE = 1e-6
_MAX_ITERATIONS = 60
_SHORTEST_STEP = 0.01  # share of a Newton step below which it is taken all the same


@dataclass(frozen=True)
class Surface:
    """Laws of the contact of two flat rough surfaces, with the figures of section 4.4.5.

    Attributes
    ----------
    compliance, exponent : float
        c and m of the approach λ = c p^m [µm, kg/cm²] (4.1).
    shear_compliance, shear_exponent : float
        R and s of the shear compliance R/p^s [µm cm²/kg] (4.5).
    friction : float
        Shear beyond this many times the pressure slips; chosen, for none is printed.
    roughness : float
        Standard deviation σ [µm].
    slope : float
        Mean absolute slope ṁ of the asperities.
    hardness : float
        Of the softer surface [kg/cm²]; Brinell 200.
    """

    compliance: float = 0.65
    exponent: float = 0.5
    shear_compliance: float = 0.75
    shear_exponent: float = 0.5
    friction: float = 0.2
    roughness: float = 1.25
    slope: float = 0.14
    hardness: float = 20000.0

    def pressure(self, approach: Array) -> tuple[Array, Array]:
        """Pressure [kg/cm²] at an approach [µm], zero when open, and its slope."""
        closed = np.maximum(approach, 0.0)
        pressure = (closed / self.compliance) ** (1.0 / self.exponent)
        slope = np.zeros_like(closed)
        np.divide(pressure, self.exponent * closed, out=slope, where=closed > 0)
        return pressure, slope

    def approach(self, pressure: float) -> float:
        """Approach at a pressure [µm]."""
        return float(self.compliance * pressure**self.exponent)

    def shear_stiffness(self, pressure: Array) -> tuple[Array, Array]:
        """Stiffness in shear [kg/cm² per µm], zero when open, and its slope by pressure."""
        stiffness = pressure**self.shear_exponent / self.shear_compliance
        slope = np.zeros_like(stiffness)
        np.divide(self.shear_exponent * stiffness, pressure, out=slope, where=pressure > 0)
        return stiffness, slope

    def conductance(self, pressure: Array, conductivity: float) -> Array:
        """Of the contact [W/(m² K)], for solids of `conductivity` [W/(m K)] (4.25)."""
        roughness = self.roughness * _MICROMETRE
        return np.asarray(self.slope * conductivity / roughness * pressure / self.hardness)


@dataclass(frozen=True)
class Contact:
    """State of a joint in equilibrium.

    Attributes
    ----------
    gap : (3, pairs) ndarray [µm]
        Displacement of the second body relative to the first, from the clamped joint: opening,
        and shear along two axes.
    slip : (2, pairs) ndarray [µm]
        The part of the shear that does not come back.
    pressure : (pairs,) ndarray [kg/cm²]
    force : (3 pairs,) ndarray [N]
        On the second body beyond the clamping, in the order of `gap`.
    iterations : int
    residual : float [µm]
    """

    gap: Array
    slip: Array
    pressure: Array
    force: Array
    iterations: int
    residual: float

    @property
    def converged(self) -> bool:
        """Whether `residual` is below `TOLERANCE`."""
        return self.residual < TOLERANCE


class Joint:
    """Pairs of nodes under a clamping pressure, between elastic bodies.

    Parameters
    ----------
    surface : Surface
    clamping : float
        Pressure of the cold joint [kg/cm²]; what clamps goes on with the same force.
    area : (pairs,) ndarray [m²]
    compliance : (3 pairs, 3 pairs) ndarray [m/N]
        Relative displacements of the bodies under unit forces between the pairs.
    """

    def __init__(self, surface: Surface, clamping: float, area: Array, compliance: Array) -> None:
        self.surface, self.clamping, self.area = surface, clamping, area
        self._rest = surface.approach(clamping)
        newton = np.tile(area * KILOGRAM_PER_CM2, 3)  # per kg/cm²
        self._newton = newton
        self._compliance = compliance / _MICROMETRE * newton  # [µm per kg/cm²]
        self._eye = np.eye(compliance.shape[0])

    def closed(self) -> Contact:
        """The cold joint, without load."""
        pairs = self.area.size
        zero = np.zeros((3, pairs))
        return Contact(zero, zero[1:], np.full(pairs, self.clamping), np.zeros(3 * pairs), 0, 0.0)

    def equilibrium(self, free: Array, before: Contact, slip: Array) -> Contact:
        """The contact in which gap and traction agree, by Newton's method with line search.

        Parameters
        ----------
        free : (3 pairs,) ndarray [µm]
            Gap that heat and load would leave without traction beyond the clamping.
        before : Contact
            Where the search begins.
        slip : (2, pairs) ndarray [µm]
            At the end of the last step: what has slipped since then is found.
        """
        gap = before.gap
        state = self._traction(gap, slip)
        rest = gap.ravel() - free - self._compliance @ state.traction.ravel()
        iterations = 0
        while np.max(np.abs(rest)) >= TOLERANCE and iterations < _MAX_ITERATIONS:
            move = np.linalg.solve(self._eye - self._tangent(state), -rest).reshape(gap.shape)
            length, size = 1.0, np.linalg.norm(rest)
            while True:
                state = self._traction(gap + length * move, slip)
                tried = gap + length * move
                rest = tried.ravel() - free - self._compliance @ state.traction.ravel()
                if np.linalg.norm(rest) < (1 - 0.1 * length) * size or length < _SHORTEST_STEP:
                    break
                length /= 2
            gap = tried
            iterations += 1
        back = np.zeros_like(state.traction[1:])
        np.divide(-state.traction[1:], state.stiffness, out=back, where=state.stiffness > 0)
        return Contact(
            gap,
            gap[1:] - back,
            state.pressure,
            self._newton * state.traction.ravel(),
            iterations,
            float(np.max(np.abs(rest))),
        )

    def _traction(self, gap: Array, slip: Array) -> _Traction:
        """Traction beyond the clamping at a gap, with its derivatives."""
        pressure, slope = self.surface.pressure(self._rest - gap[0])
        stiffness, by_pressure = self.surface.shear_stiffness(pressure)
        trial = stiffness * (gap[1:] - slip)
        size = np.maximum(np.hypot(*trial), 1e-12)
        limit = self.surface.friction * pressure
        slides = size > limit
        share = np.where(slides, limit / size, 1.0)
        traction = np.vstack([pressure - self.clamping, -share * trial])
        # Derivatives: rows of tractions, columns of gaps, pair by pair.
        derivative = np.zeros((3, 3, pressure.size))
        derivative[0, 0] = -slope
        direction = trial / size
        for k in (0, 1):
            elastic = by_pressure * slope * (gap[1 + k] - slip[k])
            derivative[1 + k, 0] = np.where(
                slides, self.surface.friction * slope * direction[k], elastic
            )
            for j in (0, 1):
                across = share * stiffness * (float(k == j) - direction[k] * direction[j])
                derivative[1 + k, 1 + j] = -np.where(slides, across, float(k == j) * stiffness)
        return _Traction(traction, pressure, stiffness, derivative)

    def _tangent(self, state: _Traction) -> Array:
        """Compliance times the derivative of the tractions, shape (3 pairs, 3 pairs)."""
        pairs = state.pressure.size
        blocks = self._compliance.reshape(3 * pairs, 3, pairs)
        columns = [
            sum(blocks[:, row] * state.derivative[row, column] for row in range(3))
            for column in range(3)
        ]
        return np.hstack(columns)


@dataclass(frozen=True)
class _Traction:
    traction: Array
    pressure: Array
    stiffness: Array
    derivative: Array
