"""Finite elements of a body: capacity, conduction with convection, heat, readings, deflections.

Linear elements carry temperature and displacement. Deflections follow temperatures without inertia
(quasi-static thermoelasticity), so that each is one row: the adjoint of the elastic problem.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import (
    Basis,
    BilinearForm,
    ElementHex1,
    ElementLineP1,
    ElementTetP1,
    FacetBasis,
    LinearForm,
    MeshHex,
    MeshLine,
)
from skfem.helpers import dot, grad

from thermaltool.errors import ModelError
from thermaltool.placement.body import LEFT, SIDE, DeflectionPoint, SolidBody, SolidMaterial
from thermaltool.placement.sparse_solver import symmetric_solver

Array = NDArray[np.float64]
# Two Gauss points per direction integrate products of linear shapes exactly.
_QUADRATURE = 2
# What a chord of a curved surface leaves out at most, over the size of an element [1].
CHORD = 0.25


@dataclass(frozen=True)
class BodyEquations:
    """``capacity T' + conduction T = Σ loads Q``, temperatures T above those around [K].

    Attributes
    ----------
    capacity, conduction : sparse array, shape (n, n) [J/K], [W/K]
        `conduction` with convection.
    loads : ndarray, shape (n, heat)
        Of 1 W of every heat.
    readings : sparse array, shape (points, n)
        Temperatures at the points.
    deflections : ndarray, shape (deflections, n) [m/K]
    """

    capacity: sparse.csr_array
    conduction: sparse.csr_array
    loads: Array
    readings: sparse.csr_array
    deflections: Array


class FiniteElements:
    """Assembly over the mesh of one body."""

    def __init__(self, body: SolidBody) -> None:
        self.body, mesh = body, body.mesh
        self.element = (
            ElementLineP1() if isinstance(mesh, MeshLine)
            else ElementHex1() if isinstance(mesh, MeshHex) else ElementTetP1()
        )  # fmt: skip
        # Line elements stand for a volume, and their ends for an area.
        self.area = 1.0 if body.section is None else body.section.area
        self.basis = Basis(mesh, self.element, intorder=_QUADRATURE)

    def equations(self) -> BodyEquations:
        """Everything that the declaration asks for.

        Raises
        ------
        ModelError
            Nothing convects; a point outside the body; a deflection of a body that nothing holds.
        """
        body, n = self.body, self.basis.N
        if not body.convection:
            raise ModelError("convection: nothing cools the body: it would warm up without end")
        loads = [self.load(parts) for parts in body.heat.values()]
        readings = [self.reading(name, at) for name, at in body.points.items()]
        deflections = (
            Thermoelasticity(self).rows(body.deflections) if body.deflections else np.zeros((0, n))
        )
        empty = sparse.csr_array((0, n))
        return BodyEquations(
            self.capacity(),
            self.conduction(),
            np.array(loads).T.reshape(n, len(loads)),
            sparse.csr_array(sparse.vstack(readings)) if readings else empty,
            deflections,
        )

    def capacity(self) -> sparse.csr_array:
        """Consistent heat capacity [J/K]."""
        return self._by_material(
            lambda m: BilinearForm(lambda u, v, _: self.area * m.density * m.specific_heat * u * v)
        )

    def conduction(self) -> sparse.csr_array:
        """Conduction and convection [W/K]."""
        return sparse.csr_array(_total((*self.conductances().values(), *self.films().values())))

    def conductances(self) -> dict[str, sparse.csr_array]:
        """Conduction of every region [W/K]."""
        return {
            name: sparse.csr_array(
                BilinearForm(
                    lambda u, v, _, m=material: self.area * m.conductivity * dot(grad(u), grad(v))
                ).assemble(self._region(name))
            )
            for name, material in self.body.materials.items()
        }

    def films(self) -> dict[str, sparse.csr_array]:
        """Convection of every boundary [W/K]."""
        found = {}
        for name, film in self.body.convection.items():
            basis, width = self._surface(name)
            form = BilinearForm(lambda u, v, _, film=film, width=width: film * width * u * v)
            found[name] = sparse.csr_array(form.assemble(basis))
        return found

    def load(self, parts: Sequence[str]) -> Array:
        """Nodal load of 1 W spread evenly over boundaries or regions, shape (n,)."""
        total = np.zeros(self.basis.N)
        for name in parts:
            if name in self.body.regions:
                total += LinearForm(lambda v, _: self.area * v).assemble(self._region(name))
            else:
                basis, width = self._surface(name)
                form = LinearForm(lambda v, _, width=width: width * v)
                total += form.assemble(basis)
        return np.asarray(total / total.sum())

    def reading(self, name: str, at: Array) -> sparse.csr_array:
        """Row that interpolates nodal temperatures at a point, shape (1, n).

        Raises
        ------
        ModelError
            A point outside the body by more than a chord of a curved surface leaves out.
        """
        nearest = self.nearest_node(name, at)
        places = self.body.mesh.p
        if np.all((at >= places.min(axis=1)) & (at <= places.max(axis=1))):
            # Rounding, or a chord of a curved surface, may leave a point in no element.
            with contextlib.suppress(ValueError, IndexError):
                return sparse.csr_array(self.basis.probes(at[:, None]))
        row = sparse.coo_array(([1.0], ([0], [nearest])), shape=(1, self.basis.N))
        return sparse.csr_array(row)

    def nearest_node(self, name: str, at: Array) -> int:
        """The node nearest to a point; raises as `reading`."""
        mesh = self.body.mesh
        distance = np.linalg.norm(mesh.p - at[:, None], axis=0)
        nearest = int(np.argmin(distance))
        corners = mesh.p[:, mesh.t[:, np.any(mesh.t == nearest, axis=0)]]
        size = float(np.max(np.ptp(corners, axis=1)))
        outside = at - np.clip(at, mesh.p.min(axis=1), mesh.p.max(axis=1))
        if distance[nearest] > size or np.linalg.norm(outside) > CHORD * size:
            place = ", ".join(f"{x:g}" for x in at)
            raise ModelError(f"{name}: ({place}) m is {distance[nearest]:.3g} m from the body")
        return nearest

    def by_region(self) -> Iterator[tuple[SolidMaterial, Any]]:
        """Every material with the elements that it fills (None for all)."""
        for name, material in self.body.materials.items():
            yield material, (self.body.mesh.subdomains or {}).get(name)

    def _by_material(self, form: Callable[[SolidMaterial], BilinearForm]) -> sparse.csr_array:
        return sparse.csr_array(_total(
            form(material).assemble(self.part(elements)) for material, elements in self.by_region()
        ))  # fmt: skip

    def _region(self, name: str) -> Basis:
        return self.part((self.body.mesh.subdomains or {}).get(name))

    def part(self, elements: Any) -> Basis:
        """Basis of some elements; None for all."""
        if elements is None:
            return self.basis
        return Basis(self.body.mesh, self.element, intorder=_QUADRATURE, elements=elements)

    def _surface(self, name: str) -> tuple[Any, float]:
        """Basis of a boundary, and what its integral is multiplied by [m² per its measure]."""
        section = self.body.section
        if section is not None and name == SIDE:
            return self.basis, section.perimeter
        facets = self.body.mesh.boundaries[name]
        basis = FacetBasis(self.body.mesh, self.element, facets=facets, intorder=_QUADRATURE)
        return basis, self.area


class Thermoelasticity:
    """Displacements that temperatures cause."""

    def __init__(self, elements: FiniteElements) -> None:
        self.elements, self.body = elements, elements.body
        if not self.body.fixed:
            raise ModelError(
                "deflections: nothing holds the body: [supports] fixed names what does"
            )

    def rows(self, wanted: Mapping[str, DeflectionPoint]) -> Array:
        """Rows that give deflections from nodal temperatures, shape (deflections, n) [m/K].

        With K u = F θ the output pᵀu equals (Fᵀ K⁻¹ p)ᵀ θ: one elastic solve for each.
        """
        rows = []
        for name, point in wanted.items():
            row = self._row(name, point.at, point.direction)
            if point.against is not None:
                row = row - self._row(name, point.against, point.direction)
            rows.append(row)
        return np.array(rows)

    def displacements(self, temperatures: Array) -> Array:
        """Displacement of every node, shape (dim, n) [m], for nodal temperatures [K]."""
        if self.body.section is not None:
            return np.array([[self._rod_row(x) @ temperatures for x in self.body.mesh.p[0]]])
        dofs, free, solve = self._solver
        found = np.zeros(dofs.size)
        found[free] = solve((self._expansion @ temperatures)[free])
        return np.asarray(found[dofs])

    def _row(self, name: str, at: Array, direction: Array) -> Array:
        if self.body.section is not None:
            self.elements.nearest_node(name, at)
            return self._rod_row(float(at[0])) * direction[0]
        reading = self.elements.reading(name, at).tocoo()
        dofs, free, solve = self._solver
        output, adjoint = np.zeros(dofs.size), np.zeros(dofs.size)
        for axis, part in enumerate(direction):
            output[dofs[axis, reading.col]] += part * reading.data
        adjoint[free] = solve(output[free])
        return np.asarray(self._expansion.T @ adjoint)

    def _rod_row(self, x: float) -> Array:
        """u(x) = ∫ α T dx from the end that is held: linear elements are integrated exactly."""
        left, right = (self.body.mesh.p[0, each] for each in self.body.mesh.t)
        held = min(left) if self.body.fixed == (LEFT,) else max(right)
        alpha = np.zeros(len(left))
        for material, elements in self.elements.by_region():
            alpha[slice(None) if elements is None else elements] = material.expansion
        low, high = (
            np.clip((end - left) / (right - left), 0.0, 1.0) for end in (min(held, x), max(held, x))
        )
        row = np.zeros(self.elements.basis.N)
        scale = alpha * (right - left) * (1.0 if x >= held else -1.0)
        moments = (high - high**2 / 2 - low + low**2 / 2, (high**2 - low**2) / 2)
        for nodes, moment in zip(self.body.mesh.t, moments, strict=True):
            np.add.at(row, nodes, scale * moment)
        return row

    @cached_property
    def _solver(self) -> tuple[NDArray[np.integer], Any, Callable[[Array], Array]]:
        """Unknowns of every node, those that are free, and the solver of the stiffness."""
        mesh = self.body.mesh
        held = np.unique(np.concatenate([mesh.facets[:, mesh.boundaries[name]].ravel()
                                         for name in self.body.fixed]))  # fmt: skip
        dofs = np.arange(mesh.p.size).reshape(mesh.p.shape)
        free = np.setdiff1d(dofs.ravel(), dofs[:, held].ravel())
        stiffness = _total(self._stiffness(*each) for each in self._moduli())
        return dofs, free, symmetric_solver(stiffness[free][:, free])

    def _stiffness(self, lame: float, shear: float, _: float, elements: Any) -> sparse.csr_array:
        """λ div u div v + 2μ ε(u) : ε(v), one block for each pair of axes.

        All follow from G_ab = ∫ ∂_a v ∂_b u, which costs far less than forms of vectors do.
        """
        basis = self.elements.part(elements)
        axes = range(len(self.body.mesh.p))
        slopes: dict[tuple[int, int], Any] = {}
        for a in axes:
            for b in range(a, len(axes)):
                form = BilinearForm(lambda u, v, _, a=a, b=b: v.grad[a] * u.grad[b])
                slopes[a, b] = sparse.csr_array(form.assemble(basis))
                slopes[b, a] = sparse.csr_array(slopes[a, b].T)
        blocks = [[lame * slopes[a, b] + shear * slopes[b, a] for b in axes] for a in axes]
        laplace = shear * _total(slopes[a, a] for a in axes)
        for a in axes:
            blocks[a][a] = blocks[a][a] + laplace
        return sparse.csr_array(sparse.block_array(blocks, format="csr"))

    @cached_property
    def _expansion(self) -> sparse.csr_array:
        """Forces of nodal temperatures, shape (dim · n, n) [N/K]."""
        return sparse.csr_array(sparse.vstack([
            _total(
                BilinearForm(lambda u, v, _, a=a, stress=stress: stress * u * v.grad[a])
                .assemble(self.elements.part(elements))
                for _, _, stress, elements in self._moduli()
            )
            for a in range(len(self.body.mesh.p))
        ]))  # fmt: skip

    def _moduli(self) -> Iterator[tuple[float, float, float, Any]]:
        """Lamé's constants, thermal stress per kelvin [Pa, Pa, Pa/K], elements."""
        for material, elements in self.elements.by_region():
            modulus, nu = material.youngs_modulus or 0.0, material.poisson_ratio
            shear = modulus / (2.0 * (1.0 + nu))
            lame = modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
            yield lame, shear, (3.0 * lame + 2.0 * shear) * (material.expansion or 0.0), elements


def _total(matrices: Iterable[Any]) -> Any:
    first, *others = matrices
    for other in others:
        first = first + other
    return first
