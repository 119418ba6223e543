"""Meshes with named regions and boundaries: a rod, a block, and what a mesh file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from skfem import Mesh, MeshHex, MeshLine, MeshTet

from thermaltool.errors import ModelError
from thermaltool.placement.body import LEFT, RIGHT

Array = NDArray[np.float64]
Index = NDArray[np.integer]
# Ends of a block along its axes.
_ENDS = (("left", "right"), ("front", "back"), ("bottom", "top"))
# Corners of a hexahedron: order of mesh files (VTK) to that of scikit-fem.
_HEXAHEDRON = [0, 4, 3, 1, 7, 5, 2, 6]
# An element is flat below this volume, over the cube of its size [1].
FLAT = 1e-10


@dataclass(frozen=True)
class MeshData:
    """A mesh of one kind of solid element, as files hold it.

    Attributes
    ----------
    points : ndarray, shape (n, 3) [m]
    elements : ndarray of int, shape (m, 4) or (m, 8)
        Corners of tetrahedra or hexahedra.
    regions : mapping of name to ndarray of int
        Elements of each.
    boundaries : mapping of name to ndarray of int, shape (facets, 3) or (facets, 4)
        Corners of the facets of each.
    """

    points: Array
    elements: Index
    regions: Mapping[str, Index] = field(default_factory=dict)
    boundaries: Mapping[str, Index] = field(default_factory=dict)


def rod_mesh(length: float, elements: int) -> MeshLine:
    """Line elements of equal length from 0 to `length` [m]."""
    mesh = MeshLine(np.linspace(0.0, length, elements + 1))
    return mesh.with_boundaries({
        LEFT: lambda x: x[0] < length / 2, RIGHT: lambda x: x[0] > length / 2,
    })  # fmt: skip


def block_mesh(size: Sequence[float], divisions: Sequence[int]) -> MeshHex:
    """Equal hexahedra between the origin and the corner at `size` [m]."""
    mesh = MeshHex.init_tensor(
        *(
            np.linspace(0.0, length, count + 1)
            for length, count in zip(size, divisions, strict=True)
        )
    )
    names = {}
    for axis, (length, ends) in enumerate(zip(size, _ENDS, strict=True)):
        for name, end in zip(ends, (0.0, length), strict=True):
            names[name] = mesh.facets_satisfying(
                lambda x, axis=axis, end=end, length=length: abs(x[axis] - end) < 1e-9 * length,
                boundaries_only=True,
            )
    return mesh.with_boundaries(names)


def solid_mesh(data: MeshData) -> Mesh:
    """The mesh that a file holds; points that belong to no element are left out.

    Raises
    ------
    ModelError
        Flat elements, pieces that share no points, a boundary whose facets belong to no element,
        elements in no region or in several.
    """
    _check_regions(data)
    _check_volumes(data)
    used, elements = np.unique(data.elements, return_inverse=True)
    elements = elements.reshape(data.elements.shape)
    place = np.full(len(data.points), -1)
    place[used] = np.arange(len(used))
    _check_one_piece(elements, len(used))
    corners, kind = elements.T, MeshTet
    if len(corners) == 8:
        corners, kind = corners[_HEXAHEDRON], MeshHex
    mesh = kind(np.ascontiguousarray(data.points[used].T), np.ascontiguousarray(corners))
    boundaries = {
        name: _facets(mesh, name, place[facets]) for name, facets in data.boundaries.items()
    }
    if boundaries:
        mesh = mesh.with_boundaries(boundaries)
    return mesh.with_subdomains(dict(data.regions)) if data.regions else mesh


def _check_one_piece(elements: Index, points: int) -> None:
    first, rest = np.repeat(elements[:, 0], elements.shape[1] - 1), elements[:, 1:].ravel()
    graph = sparse.coo_array((np.ones(len(rest)), (first, rest)), shape=(points, points))
    pieces, piece = connected_components(graph, directed=False)
    if pieces > 1:
        largest = int(np.bincount(piece).max())
        raise ModelError(
            f"the mesh is in {pieces} pieces that share no points ({largest} of {points} points "
            "in the largest): merge coincident points, so that heat passes"
        )


def _check_volumes(data: MeshData) -> None:
    corners = data.points[data.elements]
    if corners.shape[1] == 4:
        edges = corners[:, 1:] - corners[:, :1]
    else:
        # Of a hexahedron the means of four edges along each of its axes.
        ends = [1, 2, 5, 6], [2, 3, 6, 7], [4, 5, 6, 7]
        middle = corners.mean(axis=1)
        edges = np.stack([2 * (corners[:, end].mean(axis=1) - middle) for end in ends], axis=1)
    volume, size = np.abs(np.linalg.det(edges)), np.max(np.ptp(corners, axis=1), axis=1)
    flat = np.flatnonzero(volume <= FLAT * size**3)
    if len(flat):
        at = ", ".join(f"{x:.3g}" for x in corners[flat[0]].mean(axis=0))
        raise ModelError(
            f"{len(flat)} of {len(volume)} elements are flat, the first is element "
            f"{flat[0] + 1} at ({at}) m"
        )


def _check_regions(data: MeshData) -> None:
    if not data.regions:
        return
    times = np.bincount(np.concatenate(list(data.regions.values())), minlength=len(data.elements))
    for wrong, what in ((times == 0, "no region"), (times > 1, "several regions")):
        if np.any(wrong):
            raise ModelError(
                f"{np.count_nonzero(wrong)} of {len(data.elements)} elements are in {what} "
                f"({', '.join(data.regions)}): every element has one material; [regions] names "
                "the sets that count"
            )


def _facets(mesh: Mesh, name: str, corners: Index) -> Index:
    """Numbers of the facets with these corners."""
    own, wanted = np.sort(mesh.facets, axis=0), np.sort(corners.T, axis=0)
    if len(own) == len(wanted):
        _, key = np.unique(np.hstack([own, wanted]), axis=1, return_inverse=True)
        key = key.ravel()
        by_key = np.full(key.max() + 1, -1)
        by_key[key[: own.shape[1]]] = np.arange(own.shape[1])
        found = by_key[key[own.shape[1] :]]
        if np.all(found >= 0):
            return np.unique(found)
    raise ModelError(f"boundary {name}: its facets are none of the elements'")
