"""A body as a TOML file declares it, read field by field; what is wrong is named."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.documents import BODY, Part, above_zero, finite, items, names, text
from thermaltool.errors import ModelError, UnitError
from thermaltool.fitting.declarations import known_fields, named_tables
from thermaltool.placement.body import (
    LEFT,
    RIGHT,
    DeflectionPoint,
    RodSection,
    SolidBody,
    SolidMaterial,
)
from thermaltool.placement.meshes import MeshData, block_mesh, rod_mesh, solid_mesh
from thermaltool.record import hint
from thermaltool.units import UNITS, is_temperature, parse_channel

if TYPE_CHECKING:
    from skfem import Mesh

Array = NDArray[np.float64]
ReadMesh = Callable[[str, float], MeshData]
# Units of coordinates [m].
LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
# The largest heat where none is named [W].
LARGEST_HEAT = 1000.0
# Nodes of a mesh that a declaration makes, at most.
MAX_NODES = 2_000_000
_AXES = ("x", "y", "z")
_SECTIONS = ("format", "version", "name", "mesh", "materials", "regions", "convection", "heat",
             "points", "deflections", "supports")  # fmt: skip


def load_body(document: Mapping[str, Any], source: str, read_mesh: ReadMesh) -> SolidBody:
    """The body in a table of TOML.

    Parameters
    ----------
    document : mapping
    source : str
        What messages call the file.
    read_mesh : callable
        The mesh of a file, given its name and its unit [m].

    Raises
    ------
    ModelError
        Another format or a newer version, an unknown or missing field, a property that it cannot
        have, a region or boundary that the mesh does not have; each names the file and the field.
    """
    whole = Part(BODY.check(document, source))
    try:
        return _body(whole, read_mesh)
    except (ModelError, UnitError) as error:
        raise ModelError(f"{source}: {error}") from error


def _body(whole: Part, read_mesh: ReadMesh) -> SolidBody:
    known_fields(whole, "", *_SECTIONS)
    regions = whole.part("regions").names() if "regions" in whole.names() else ()
    mesh, section, unit = _mesh(whole.part("mesh"), read_mesh, regions)
    dim = len(mesh.p)
    points = {}
    for name, part in named_tables(whole, "points"):
        known_fields(part, f"points.{name}", "at")
        if not is_temperature(parse_channel(name).name):
            raise ModelError(f"points.{name}: is no temperature: its unit is degC or K")
        points[name] = unit * part.read("at", lambda value: _coordinates(value, dim))
    deflections = {
        name: _deflection(name, part, dim, unit)
        for name, part in named_tables(whole, "deflections")
    }
    materials = {
        name: _material(name, part, bool(deflections))
        for name, part in named_tables(whole, "materials")
    }
    if not materials:
        raise ModelError("materials: there is none")
    bare = SolidBody(mesh, section, materials, {}, {}, points, deflections)
    heat, largest = _heat(whole, bare)
    return SolidBody(
        mesh, section, _regions(whole, bare), _convection(whole, bare), heat, points, deflections,
        _supports(whole, bare), largest,
    )  # fmt: skip


def _mesh(
    part: Part, read_mesh: ReadMesh, regions: Sequence[str]
) -> tuple[Mesh, RodSection | None, float]:
    known_fields(part, "mesh", "rod", "block", "file", "unit")
    kinds = [name for name in ("rod", "block", "file") if name in part.names()]
    if len(kinds) != 1:
        raise ModelError("mesh: one of rod, block and file")
    unit = part.read("unit", _unit, 1.0)
    if kinds == ["file"]:
        data = read_mesh(part.read("file", text), unit)
        # Of sets that overlap those count that have a material.
        own = {name: rows for name, rows in data.regions.items() if name in regions}
        overlap = sum(map(len, data.regions.values())) > len(data.elements)
        chosen = overlap and len(own) == len(regions) > 0
        return solid_mesh(replace(data, regions=own) if chosen else data), None, unit
    shape = part.part(kinds[0])
    if kinds == ["rod"]:
        known_fields(shape, "mesh.rod", "length", "area", "perimeter", "elements")
        area = unit**2 * shape.read("area", above_zero)
        circle = 2 * math.sqrt(math.pi * area) / unit
        section = RodSection(area, unit * shape.read("perimeter", above_zero, circle))
        length = unit * shape.read("length", above_zero)
        return rod_mesh(length, shape.read("elements", _count)), section, unit
    known_fields(shape, "mesh.block", "size", "divisions")
    size = shape.read("size", lambda value: [unit * above_zero(x) for x in _three(value)])
    divisions = shape.read("divisions", lambda value: [_count(x) for x in _three(value)])
    if math.prod(each + 1 for each in divisions) > MAX_NODES:
        raise ModelError(f"mesh.block.divisions: more than {MAX_NODES} nodes")
    return block_mesh(size, divisions), None, unit


def _unit(value: Any) -> float:
    if value not in LENGTHS:
        raise ModelError(f"{value!r:.60} is none of {', '.join(LENGTHS)}")
    return LENGTHS[value]


def _count(value: Any) -> int:
    if type(value) is not int or not 0 < value <= MAX_NODES:
        raise ModelError(f"not a whole number of 1 to {MAX_NODES}: {value!r:.60}")
    return value


def _three(value: Any) -> list[Any]:
    if len(items(value)) != 3:
        raise ModelError(f"three numbers, not {len(value)}")
    return list(value)


def _coordinates(value: Any, dim: int) -> Array:
    """A place: a number on a rod, three elsewhere."""
    several = value if isinstance(value, list) else [value]
    if len(several) != dim:
        what = "one number on a rod" if dim == 1 else "three numbers"
        raise ModelError(f"{what}, not {len(several)}")
    return np.array([finite(x) for x in several])


def _direction(value: Any, dim: int) -> Array:
    """A unit vector: the name of an axis, with a sign if need be, or components."""
    if isinstance(value, str):
        axis = value.lstrip("+-")
        if axis not in _AXES[:dim]:
            raise ModelError(f"{value!r:.60} is none of {', '.join(_AXES[:dim])}")
        return np.eye(dim)[_AXES.index(axis)] * (-1.0 if value.startswith("-") else 1.0)
    vector = _coordinates(value, dim)
    if not np.any(vector):
        raise ModelError("a direction of length 0")
    return np.asarray(vector / np.linalg.norm(vector))


def _deflection(name: str, part: Part, dim: int, unit: float) -> DeflectionPoint:
    known_fields(part, f"deflections.{name}", "at", "direction", "against")
    if parse_channel(name).dimension != "length":
        raise ModelError(f"deflections.{name}: is no length: its unit is um, nm, mm or m")
    at = unit * part.read("at", lambda value: _coordinates(value, dim))
    against = part.read("against", lambda value: unit * _coordinates(value, dim), None)
    return DeflectionPoint(
        at, part.read("direction", lambda value: _direction(value, dim)), against
    )


def _material(name: str, part: Part, elastic: bool) -> SolidMaterial:
    place = f"materials.{name}"
    known_fields(part, place, *SolidMaterial.__annotations__)
    ratio = part.read("poisson_ratio", finite, 0.3)
    if not -1 < ratio < 0.5:
        raise ModelError(f"{place}.poisson_ratio: not between -1 and 0.5: {ratio:g}")
    # Without a deflection nobody asks for the elastic properties.
    absent = () if elastic else (None,)
    return SolidMaterial(
        part.read("conductivity", above_zero),
        part.read("density", above_zero),
        part.read("specific_heat", above_zero),
        part.read("expansion", finite, *absent),
        part.read("youngs_modulus", above_zero, *absent),
        ratio,
    )


def _regions(whole: Part, body: SolidBody) -> dict[str, SolidMaterial]:
    """The material of every region."""
    if "regions" not in whole.names():
        if len(body.materials) > 1:
            raise ModelError(
                f"regions: which of {', '.join(body.materials)} is where? the mesh has "
                f"{', '.join(body.regions)}"
            )
        return dict.fromkeys(body.regions, next(iter(body.materials.values())))
    part = whole.part("regions")
    for name in part.names():
        if name not in body.regions:
            raise ModelError(
                f"regions: the mesh has no region {name!r:.60}{hint(name, body.regions)}"
            )
    found = {}
    for name in body.regions:
        material = part.read(name, text)
        if material not in body.materials:
            near = hint(material, body.materials)
            raise ModelError(f"regions.{name}: no material {material!r:.60}{near}")
        found[name] = body.materials[material]
    return found


def _boundary(body: SolidBody, name: str, place: str, *others: str) -> str:
    """A name that the mesh has."""
    there = (*body.boundaries, *others)
    if not body.boundaries and name not in there:
        raise ModelError(
            f"{place}: the mesh has no boundary: name its surfaces, as physical groups of Gmsh or "
            "sets of facets, and save them with it"
        )
    if name not in there:
        raise ModelError(f"{place}: the mesh has no boundary {name!r:.60}{hint(name, there)}")
    return name


def _convection(whole: Part, body: SolidBody) -> dict[str, float]:
    part = whole.part("convection")
    return {
        _boundary(body, name, "convection"): part.read(name, above_zero) for name in part.names()
    }


def _heat(whole: Part, body: SolidBody) -> tuple[dict[str, tuple[str, ...]], dict[str, float]]:
    """Boundaries or regions of every heat, and its largest value."""
    found, largest = {}, {}
    for name, part in named_tables(whole, "heat"):
        place = f"heat.{name}"
        known_fields(part, place, "on", "largest")
        if parse_channel(name).dimension != "power":
            raise ModelError(f"{place}: is no power: its unit is W, mW or kW")
        on = part.read("on", lambda value: names([value] if isinstance(value, str) else value))
        if not on:
            raise ModelError(f"{place}.on: names nothing")
        found[name] = tuple(_boundary(body, each, f"{place}.on", *body.regions) for each in on)
        _one_measure(body, on, f"{place}.on")
        usual = LARGEST_HEAT / UNITS[parse_channel(name).unit][1]
        largest[name] = part.read("largest", above_zero, usual)
    if not found:
        raise ModelError("heat: there is none")
    return found, largest


def _one_measure(body: SolidBody, on: Sequence[str], place: str) -> None:
    """A heat is spread over areas or over volumes, and each name is one of them."""
    both = [each for each in on if each in body.regions and each in body.boundaries]
    if both:
        raise ModelError(f"{place}: {both[0]!r:.60} is a region and a boundary: rename one of them")
    inside = [each for each in on if each in body.regions]
    if inside and len(inside) < len(on):
        outside = next(each for each in on if each not in inside)
        raise ModelError(
            f"{place}: {outside} is a boundary and {inside[0]} a region: a heat is spread over "
            "areas or over volumes; declare two heats"
        )


def _supports(whole: Part, body: SolidBody) -> tuple[str, ...]:
    if "supports" not in whole.names():
        return ()
    part = whole.part("supports")
    known_fields(part, "supports", "fixed")
    fixed = tuple(_boundary(body, each, "supports.fixed") for each in part.read("fixed", names))
    if body.section is not None and fixed not in ((LEFT,), (RIGHT,)):
        raise ModelError(f"supports.fixed: a rod is held at {LEFT} or at {RIGHT}")
    return fixed
