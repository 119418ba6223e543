"""Thermal modes: K Φ = C Φ Λ, time constants τ = 1/λ, and what a heat excites of each.

Zhu, Ni, Shih 2008, (1) to (11): with Φᵀ C Φ = I the heat Q decouples into θ' + θ/τ = ξ = Φᵀ Q, and
a step leaves ξτ(1 − exp(−t/τ)). The weight of a mode is |ξτ|.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from thermaltool.errors import FitError
from thermaltool.placement.finite_elements import BodyEquations
from thermaltool.placement.sparse_solver import symmetric_solver

Array = NDArray[np.float64]
# Unknowns up to which all modes are found at once.
MAX_COMPLETE = 600
# Modes beyond.
DEFAULT_MODES = 20
# Relative error of the eigenvalues that Lanczos' iterations leave.
TOLERANCE = 1e-8
# A point is near a node of a mode below this part of the mode's largest value.
NEAR_NODE = 0.1
# Extremes of a shape that differ by less of the largest are one to rounding.
EQUAL_EXTREMES = 1e-6


@dataclass(frozen=True)
class ThermalEigenmodes:
    """Modes of a body, the slowest first, and what heat does to them.

    Attributes
    ----------
    equations : BodyEquations
    time_constants : ndarray, shape (N,) [s]
    shapes : ndarray, shape (n, N)
        Nodal temperatures, Φᵀ C Φ = I [K/√(J K)]; the largest value is above zero.
    is_complete : bool
        Whether these are all modes of the mesh.
    """

    equations: BodyEquations
    time_constants: Array
    shapes: Array
    is_complete: bool

    @property
    def modal_heat(self) -> Array:
        """Steady state ξτ of every mode for 1 W of each heat, shape (N, heat)."""
        return np.asarray(self.time_constants[:, None] * (self.shapes.T @ self.equations.loads))

    @property
    def weights(self) -> Array:
        """w = |ξτ| (11), shape (N, heat)."""
        return np.abs(self.modal_heat)

    @property
    def relative_weights(self) -> Array:
        """Weights as parts of their sum over the modes that were found, shape (N, heat)."""
        total = self.weights.sum(axis=0)
        return np.asarray(self.weights / np.where(total > 0, total, 1.0))

    @property
    def unit_shapes(self) -> Array:
        """Shapes with a largest value of 1, shape (n, N).

        Where several nodes go equally far, to rounding, the first of them is at 1.
        """
        size = np.abs(self.shapes)
        first = np.argmax(size > (1 - EQUAL_EXTREMES) * np.max(size, axis=0), axis=0)
        largest = np.take_along_axis(self.shapes, first[None], axis=0)
        return np.asarray(self.shapes / largest)

    @property
    def at_points(self) -> Array:
        """Shapes with a largest value of 1 at the points, shape (points, N)."""
        return np.asarray(self.equations.readings @ self.unit_shapes)

    @cached_property
    def contributions(self) -> Array:
        """Steady state of every output by every mode, for 1 W, shape (outputs, N, heat)."""
        at_outputs = np.vstack([self.equations.readings @ self.shapes,
                                self.equations.deflections @ self.shapes])  # fmt: skip
        return np.asarray(at_outputs[:, :, None] * self.modal_heat)

    @cached_property
    def steady_states(self) -> Array:
        """Nodal temperatures in the steady state of 1 W of each heat, shape (n, heat) [K/W]."""
        solve = symmetric_solver(self.equations.conduction)
        return np.array([solve(load) for load in self.equations.loads.T]).T

    @cached_property
    def gains(self) -> Array:
        """Steady state of every output for 1 W of each heat, shape (outputs, heat)."""
        states = self.steady_states
        return np.vstack([self.equations.readings @ states, self.equations.deflections @ states])

    def dominant(self, heat: int, least: float = 0.05) -> list[int]:
        """Modes with at least this part of the weight of a heat, the heaviest first."""
        parts = self.relative_weights[:, heat]
        return [int(j) for j in np.argsort(-parts) if parts[j] >= least]


def thermal_modes(equations: BodyEquations, count: int | None = None) -> ThermalEigenmodes:
    """The slowest modes of a body; all of them where the mesh is small.

    Parameters
    ----------
    equations : BodyEquations
    count : int, optional
        Number of modes. Default: all of a small mesh, else `DEFAULT_MODES`.

    Raises
    ------
    FitError
        Equations that cannot be solved.

    Notes
    -----
    Shift-invert Lanczos about λ = 0 (ARPACK): K⁻¹ by a factor or by conjugate gradients.
    """
    n = equations.capacity.shape[0]
    wanted = n if count is None and n <= MAX_COMPLETE else min(count or DEFAULT_MODES, n)
    if n <= MAX_COMPLETE:
        rates, shapes = linalg.eigh(
            equations.conduction.toarray(), equations.capacity.toarray(),
            subset_by_index=[0, wanted - 1],
        )  # fmt: skip
    else:
        wanted = min(wanted, n - 1)
        conduction = sparse.csc_matrix(equations.conduction)
        solve = symmetric_solver(equations.conduction)
        try:
            rates, shapes = sparse_linalg.eigsh(
                conduction,
                k=wanted,
                M=sparse.csc_matrix(equations.capacity),
                sigma=0.0,
                tol=TOLERANCE,
                v0=np.ones(n),
                OPinv=sparse_linalg.LinearOperator(
                    conduction.shape, lambda b: solve(b.ravel()), dtype=np.float64
                ),
            )
        except sparse_linalg.ArpackNoConvergence as error:
            raise FitError(
                f"{wanted} modes are not found after many iterations: ask for fewer (--count)"
            ) from error
        order = np.argsort(rates)
        rates, shapes = rates[order], shapes[:, order]
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]
    return ThermalEigenmodes(equations, 1 / rates, shapes * np.sign(largest), wanted == n)
