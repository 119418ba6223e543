"""Mesh files of other programs (Gmsh, Abaqus, Nastran, VTK …), read by meshio."""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.sources import max_bytes

if TYPE_CHECKING:
    from thermaltool.placement.meshes import MeshData

# Solid elements with their corners, the facets that belong to them, and corners of those. Nodes on
# edges (tetra10, hexahedron20) are left out.
_SOLIDS = {"tetra": 4, "tetra10": 4, "hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8}
_FACETS = {4: {"triangle": 3, "triangle6": 3}, 8: {"quad": 4, "quad8": 4, "quad9": 4}}
_FLAT = ("vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8", "quad9")
# Physical groups of Gmsh by number; their names are in `field_data`.
_PHYSICAL = "gmsh:physical"


def read_mesh(path: str, unit: float) -> MeshData:
    """The solid elements of a mesh file, its named regions and boundaries.

    Parameters
    ----------
    path : str
        A format that meshio knows, by its suffix.
    unit : float
        Of the coordinates in the file [m].

    Raises
    ------
    ModelError
        The file cannot be read, or has no solid elements, or of several kinds.
    """
    mesh = _read(path)
    blocks = [block for block in mesh.cells if block.type not in _FLAT]
    kinds = sorted({block.type for block in blocks})
    if not kinds:
        raise ModelError(f"{path}: no tetrahedra or hexahedra: the mesh has no solid")
    if unknown := [kind for kind in kinds if kind not in _SOLIDS]:
        raise ModelError(
            f"{path}: elements of {', '.join(unknown)}: it takes tetrahedra or hexahedra"
        )
    corners = {_SOLIDS[kind] for kind in kinds}
    if len(corners) > 1:
        raise ModelError(f"{path}: tetrahedra and hexahedra in one mesh: take one kind")
    points = np.asarray(mesh.points, float)
    if points.shape[1] != 3 or not np.all(np.isfinite(points)):
        raise ModelError(f"{path}: points are not three finite coordinates")
    count = corners.pop()
    elements = np.vstack([block.data[:, :count] for block in blocks])
    regions, boundaries = _named(mesh, dict.fromkeys(kinds, count)), _named(mesh, _FACETS[count])
    # Elements are numbered over all blocks of solids.
    begins = np.cumsum([0, *(len(block.data) for block in blocks)])
    place = {id(block): begin for block, begin in zip(blocks, begins, strict=False)}
    from thermaltool.placement.meshes import MeshData

    return MeshData(
        unit * points,
        elements,
        {name: np.concatenate([place[id(block)] + rows for block, rows in parts])
         for name, parts in regions.items()},
        {name: np.vstack([block.data[rows, : _FACETS[count][block.type]] for block, rows in parts])
         for name, parts in boundaries.items()},
    )  # fmt: skip


def _read(path: str) -> Any:
    """What meshio makes of a file; it prints, and may leave the interpreter."""
    import meshio

    try:
        if os.path.getsize(path) > max_bytes.get():
            raise ModelError(f"{path}: more than {max_bytes.get()} bytes (--max-bytes)")
        with open(os.devnull, "w") as nowhere, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(nowhere):
                return meshio.read(path)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ModelError:
        raise
    # Its readers raise whatever a damaged file makes them run into.
    except (Exception, SystemExit) as error:
        known = isinstance(error, meshio.ReadError)
        why = f": {str(error).splitlines()[0]}" if known and str(error) else ""
        raise ModelError(f"{path}: meshio cannot read this mesh{why}") from error


def _named(mesh: Any, kinds: dict[str, int]) -> dict[str, list[tuple[Any, Any]]]:
    """Blocks and rows of every name among cells of these kinds."""
    found: dict[str, list[tuple[Any, Any]]] = {}
    numbers = mesh.cell_data.get(_PHYSICAL, [None] * len(mesh.cells))
    by_number = {
        (int(number), int(dim)): name for name, (number, dim) in (
            (name, np.ravel(value)[:2]) for name, value in mesh.field_data.items()
            if np.size(value) >= 2
        )
    }  # fmt: skip
    for k, block in enumerate(mesh.cells):
        if block.type not in kinds:
            continue
        if numbers[k] is not None:
            for number in np.unique(numbers[k]):
                name = by_number.get((int(number), block.dim))
                if name is None and int(number):
                    name = str(int(number))
                if name is not None:
                    rows = np.flatnonzero(numbers[k] == number)
                    found.setdefault(name, []).append((block, rows))
        for name, sets in mesh.cell_sets.items():
            if not name.startswith("gmsh:") and sets[k] is not None and len(sets[k]):
                entry = (block, np.asarray(sets[k], int))
                if all(each is not block for each, _ in found.get(name, [])):
                    found.setdefault(name, []).append(entry)
    return found
