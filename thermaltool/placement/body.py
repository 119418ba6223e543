"""A body as it is declared: mesh, materials, convection, heat, points and deflections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
# Name of what has none: all of a mesh without regions.
WHOLE = "body"
# The lateral surface of a rod; its ends are called as the ends of an axis.
SIDE, LEFT, RIGHT = "side", "left", "right"


@dataclass(frozen=True)
class SolidMaterial:
    """Isotropic solid.

    Attributes
    ----------
    conductivity : float
        [W/(m K)]
    density : float
        [kg/m³]
    specific_heat : float
        [J/(kg K)]
    expansion : float or None
        Coefficient of linear thermal expansion [1/K]; None: no deflection is asked for.
    youngs_modulus : float or None
        [Pa]; None as for `expansion`.
    poisson_ratio : float
        [1]
    """

    conductivity: float
    density: float
    specific_heat: float
    expansion: float | None = None
    youngs_modulus: float | None = None
    poisson_ratio: float = 0.3


@dataclass(frozen=True)
class RodSection:
    """Cross-section of a rod of line elements.

    Attributes
    ----------
    area : float
        [m²]
    perimeter : float
        Of the lateral surface [m].
    """

    area: float
    perimeter: float


@dataclass(frozen=True)
class DeflectionPoint:
    """Displacement of a point along a direction, less that of another point where one is named.

    Attributes
    ----------
    at : ndarray, shape (dim,)
        [m]
    direction : ndarray, shape (dim,)
        Unit vector.
    against : ndarray, shape (dim,), or None
        [m]
    """

    at: Array
    direction: Array
    against: Array | None = None


@dataclass(frozen=True)
class SolidBody:
    """What conducts, what cools and heats it, and where it is looked at.

    Attributes
    ----------
    mesh : skfem.Mesh
        Lines, tetrahedra or hexahedra; coordinates in metres; named regions and boundaries.
    section : RodSection or None
        Of line elements.
    materials : mapping of region to SolidMaterial
    convection : mapping of boundary to float
        Film coefficient [W/(m² K)].
    heat : mapping of channel to sequence of str
        Boundaries or regions over which a heat of 1 W is spread evenly.
    points : mapping of channel to ndarray, shape (dim,)
        Where temperatures are looked at [m].
    deflections : mapping of channel to DeflectionPoint
    fixed : tuple of str
        Boundaries that are held.
    largest : mapping of channel to float [unit of the heat]
        The largest value of every heat, for a model document.
    """

    mesh: Mesh
    section: RodSection | None
    materials: Mapping[str, SolidMaterial]
    convection: Mapping[str, float]
    heat: Mapping[str, tuple[str, ...]]
    points: Mapping[str, Array]
    deflections: Mapping[str, DeflectionPoint]
    fixed: tuple[str, ...] = ()
    largest: Mapping[str, float] = field(default_factory=dict)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the boundaries of the mesh."""
        own = tuple(self.mesh.boundaries or ())
        return own if self.section is None else (SIDE, *own)

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions of the mesh."""
        return tuple(self.mesh.subdomains or ()) or (WHOLE,)
