"""Finite elements of heat conduction and linear thermoelasticity on hexahedral meshes.

Trilinear hexahedra carry temperature and displacement. Deflections are linear in the nodal
temperatures, so each is one row: the adjoint of the elastic problem, solved once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg
from skfem import Basis, BilinearForm, ElementHex1, ElementVector, FacetBasis, LinearForm, MeshHex
from skfem.helpers import ddot, div, dot, grad, sym_grad

Array = NDArray[np.float64]
Facets = NDArray[np.integer]

MICROMETRES = 1e6  # per metre
# Two Gauss points per direction integrate every form exactly on rectangular elements.
_QUADRATURE = 3
# Expansion points of a reduction [1/s]; with 25 it is within 1e-8 of the mesh (tested).
_SHIFTS = np.geomspace(1e-4, 30.0, 25)
SDIRK = 1.0 - np.sqrt(0.5)  # makes the two-stage scheme L-stable


@dataclass(frozen=True)
class Material:
    """Properties of an isotropic solid; the defaults are those of structural steel.

    Parameters
    ----------
    conductivity : float
        [W/(m K)]
    density : float
        [kg/m³]
    specific_heat : float
        [J/(kg K)]
    expansion : float
        Coefficient of linear thermal expansion [1/K].
    youngs_modulus : float
        [Pa]; scales out of a deflection that heat alone causes.
    poisson_ratio : float
        [1]
    """

    conductivity: float = 50.0
    density: float = 7850.0
    specific_heat: float = 480.0
    expansion: float = 12e-6
    youngs_modulus: float = 205e9
    poisson_ratio: float = 0.29


@dataclass(frozen=True)
class ThermalSystem:
    """Semi-discrete heat conduction, ``capacity θ' + conduction θ = load Q + film T_ambient``.

    `conduction` includes convection at the surface; `film` holds, per node, the film coefficient
    integrated over the surface [W/K], so that ``film @ (θ - T_ambient)`` is the heat convected [W].
    """

    capacity: sparse.csc_array
    conduction: sparse.csc_array
    film: Array


def thermal_system(
    mesh: MeshHex, material: Material, film_coefficient: float, facets: Facets
) -> ThermalSystem:
    """Assemble conduction in `mesh` with convection on `facets`.

    Parameters
    ----------
    mesh : MeshHex
        Coordinates in metres.
    film_coefficient : float
        [W/(m² K)]
    facets : (m,) ndarray of int
        The surface that convects; the rest is adiabatic.
    """
    basis = Basis(mesh, ElementHex1(), intorder=_QUADRATURE)
    surface = FacetBasis(mesh, ElementHex1(), facets=facets, intorder=_QUADRATURE)
    heat_capacity = material.density * material.specific_heat
    capacity = BilinearForm(lambda u, v, _: heat_capacity * u * v).assemble(basis)
    interior = BilinearForm(lambda u, v, _: material.conductivity * dot(grad(u), grad(v)))
    exchange = BilinearForm(lambda u, v, _: film_coefficient * u * v).assemble(surface)
    return ThermalSystem(
        sparse.csc_array(capacity),
        sparse.csc_array(interior.assemble(basis) + exchange),
        LinearForm(lambda v, _: film_coefficient * v).assemble(surface),
    )


def surface_heat(mesh: MeshHex, facets: Facets) -> Array:
    """Nodal load of 1 W spread evenly over `facets`, shape (nodes,)."""
    basis = FacetBasis(mesh, ElementHex1(), facets=facets, intorder=_QUADRATURE)
    load: Array = LinearForm(lambda v, _: 1.0 * v).assemble(basis)
    return load / load.sum()


def temperature_row(mesh: MeshHex, point: Sequence[float]) -> Array:
    """Row that interpolates nodal temperatures at `point` [m], shape (nodes,)."""
    at_point = Basis(mesh, ElementHex1(), intorder=_QUADRATURE).probes(np.reshape(point, (3, 1)))
    row: Array = at_point.toarray()[0]
    return row


def nearest_node(mesh: MeshHex, point: Sequence[float]) -> int:
    """Index of the mesh node nearest to `point` [m]."""
    return int(np.argmin(np.sum((mesh.p - np.reshape(point, (3, 1))) ** 2, axis=0)))


@dataclass(frozen=True)
class ElasticSystem:
    """Semi-discrete thermoelasticity, ``stiffness u = expansion θ + forces``.

    Attributes
    ----------
    stiffness : (dofs, dofs) csc_array
        [N/m]
    expansion : (dofs, nodes) array
        Forces of nodal temperature rises [N/K].
    dofs : (3, nodes) ndarray of int
        Index of the displacement of a node along each axis.
    """

    stiffness: sparse.csc_array
    expansion: sparse.csr_array
    dofs: NDArray[np.integer]


def elastic_system(
    mesh: MeshHex, material: Material, relative_modulus: Array | None = None
) -> ElasticSystem:
    """Assemble linear thermoelasticity of a free body.

    Parameters
    ----------
    relative_modulus : (elements,) ndarray, optional
        Young's modulus of each element over that of the material.
    """
    temperature = Basis(mesh, ElementHex1(), intorder=_QUADRATURE)
    displacement = Basis(mesh, ElementVector(ElementHex1()), intorder=_QUADRATURE)
    modulus, nu = material.youngs_modulus, material.poisson_ratio
    shear = modulus / (2.0 * (1.0 + nu))
    lame = modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    thermal_stress = (3.0 * lame + 2.0 * shear) * material.expansion
    factor = np.ones((1, 1)) if relative_modulus is None else relative_modulus[:, None]
    stiffness = BilinearForm(
        lambda u, v, _: factor * (2.0 * shear * ddot(sym_grad(u), grad(v)) + lame * div(u) * div(v))
    ).assemble(displacement)
    expansion = BilinearForm(lambda u, v, _: factor * (thermal_stress * u * div(v))).assemble(
        temperature, displacement
    )
    return ElasticSystem(
        sparse.csc_array(stiffness), sparse.csr_array(expansion), displacement.nodal_dofs
    )


def elastic_responses(system: ElasticSystem, loads: Array, held: Sequence[int]) -> Array:
    """Displacements under each column of `loads`, shape (dofs, loads).

    Parameters
    ----------
    system : ElasticSystem
    loads : (dofs, loads) ndarray
        [N]
    held : sequence of int
        Displacements held at zero.
    """
    free = np.setdiff1d(np.arange(loads.shape[0]), held)
    displacements = np.zeros_like(loads)
    displacements[free] = symmetric_factor(system.stiffness[free][:, free]).solve(loads[free])
    return displacements


def deflection_rows(
    mesh: MeshHex,
    material: Material,
    pairs: Sequence[tuple[int, int, int]],
    supports: Sequence[tuple[int, int]],
) -> Array:
    """Rows that give relative displacements from nodal temperature rises, by the adjoint method.

    With K u = F θ the output pᵀu equals (Fᵀ K⁻¹ p)ᵀ θ: one elastic solve per output, none per step.

    Parameters
    ----------
    pairs : sequence of (node, node, axis)
        An output is the displacement of the first node less that of the second along `axis`.
    supports : sequence of (node, axis)
        Displacements held at zero; six that hold the body without straining it.

    Returns
    -------
    ndarray, shape (pairs, nodes)
        [µm/K]
    """
    system = elastic_system(mesh, material)
    dofs = system.dofs
    outputs = np.zeros((dofs.size, len(pairs)))
    for column, (node, other, axis) in enumerate(pairs):
        outputs[dofs[axis, node], column] += 1.0
        outputs[dofs[axis, other], column] -= 1.0
    adjoint = elastic_responses(system, outputs, [dofs[axis, node] for node, axis in supports])
    rows: Array = MICROMETRES * (system.expansion.T @ adjoint).T
    return rows


def symmetric_factor(matrix: sparse.sparray) -> sparse_linalg.SuperLU:
    """LU factors of a symmetric positive definite matrix, ordered for its symmetry."""
    return sparse_linalg.splu(
        sparse.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def galerkin_modes(
    capacity: sparse.csc_array, conduction: sparse.csc_array, loads: Array, observe: Array
) -> tuple[Array, Array, Array]:
    """Thermal modes on a rational Krylov space: ``x' = -rates x + inputs u``, ``y = outputs x``.

    Parameters
    ----------
    capacity, conduction : (nodes, nodes) sparse, symmetric positive definite
    loads : (nodes, m) ndarray
        [W] per unit of each input.
    observe : (p, nodes) ndarray

    Returns
    -------
    rates : (k,) ndarray
        [1/s]
    inputs : (k, m) ndarray
    outputs : (p, k) ndarray
    """
    sources = np.column_stack([loads, observe.T])
    blocks = [symmetric_factor(conduction + s * capacity).solve(sources) for s in _SHIFTS]
    directions = np.hstack(blocks)
    directions /= np.linalg.norm(directions, axis=0)
    basis, _, _ = linalg.svd(directions, full_matrices=False)
    rates, modes = linalg.eigh(basis.T @ (conduction @ basis), basis.T @ (capacity @ basis))
    shapes = basis @ modes
    return rates, shapes.T @ loads, observe @ shapes


class HeatStepper:
    """Advance a `ThermalSystem` by `dt` [s] under a load that is constant over the step.

    Two-stage singly diagonally implicit Runge-Kutta scheme, second order and L-stable
    (Alexander 1977): the jump of a heater being switched on does not ring.
    """

    def __init__(self, system: ThermalSystem, dt: float) -> None:
        self.dt = dt
        self._conduction = sparse.csr_array(system.conduction)
        self._factor = symmetric_factor(system.capacity + SDIRK * dt * system.conduction)

    def __call__(self, state: Array, load: Array) -> Array:
        """Nodal temperatures [K] one step after `state`; `load` in W per node."""
        first = self._factor.solve(load - self._conduction @ state)
        middle = state + (1.0 - SDIRK) * self.dt * first
        second = self._factor.solve(load - self._conduction @ middle)
        return middle + SDIRK * self.dt * second
