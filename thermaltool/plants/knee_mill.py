"""A horizontal milling machine whose knee is clamped to its column over two contact strips.

After the nonlinear structure of Fraser (1997), sections 4.4.5 and 7.5: boxes of cast iron in an
envelope of 145 x 115 x 50 cm, a column with an overarm, a knee with the table on its guideways and
on a stiff support screw, and a heat source in the column close to the joint. As the structure
warms, the joint opens at one place and is pressed together at another, and passes heat otherwise
than at rest: what the machine does is no longer in proportion to the heat.

From print: the envelope, walls of 5 cm, strips of 40 x 7.5 cm, the material, the screw's modulus,
the laws of the contact and its clamping, 197.5 W as Q = 1, deflection between overarm and table,
1000 lb on the edge of the table. Its drawings are not in the text: the other dimensions, where the
heat enters and where temperatures are read are chosen, the heat so that Q = 2 departs from twice
Q = 1 by the published share. The film coefficient is taken as 6 kcal/(m² h °C), for the printed
unit is none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from thermaltool.plants.contact import KILOGRAM_PER_CM2, Joint, Surface
from thermaltool.plants.jointed import Bodies, JointedPlant
from thermaltool.plants.thermoelastic import (
    MICROMETRES,
    Array,
    ElasticSystem,
    Facets,
    Material,
    elastic_responses,
    elastic_system,
    nearest_node,
    surface_heat,
    temperature_row,
    thermal_system,
)

CAST_IRON = Material(
    conductivity=46.5,  # 40 kcal/(m h °C)
    density=7200.0,
    specific_heat=500.0,
    expansion=13.7e-6,
    youngs_modulus=1.06e6 * KILOGRAM_PER_CM2,
    poisson_ratio=0.27,
)
# Temperatures down the knee's side of the joint: heights above its lower edge [m].
JOINT_PROBES = {
    "T_joint1_degC": 0.36,
    "T_joint2_degC": 0.28,
    "T_joint3_degC": 0.16,
    "T_joint4_degC": 0.04,
}
_MESH_TOLERANCE = 1e-6  # smaller than any feature of the mesh [m]


@dataclass(frozen=True)
class KneeMillGeometry:
    """Dimensions [m], film coefficient [W/(m² K)] and full heat [W] of the machine.

    x runs along the overarm, y up the column, z out of the plane of symmetry; half of it is
    meshed. `heater` is a range of heights on the inside of the column's front wall, behind the
    joint. `refinement` divides the mesh.
    """

    depth: float = 1.15
    height: float = 1.45
    half_width: float = 0.25
    wall: float = 0.05
    column: float = 0.45
    arm: float = 0.25
    base: float = 0.2
    knee: tuple[float, float] = (0.45, 0.85)
    strip: float = 0.075
    strip_depth: float = 0.02
    screw: tuple[float, float] = (0.65, 0.75)
    heater: tuple[float, float] = (0.68, 0.83)
    tool: float = 0.9
    film_coefficient: float = 7.0
    full_power: float = 197.5
    clamping: float = 45.0
    screw_modulus: float = 3.0e7 / 1.06e6
    surface: Surface = field(default_factory=Surface)
    material: Material = CAST_IRON
    refinement: float = 1.0


def build(geometry: KneeMillGeometry | None = None) -> JointedPlant:
    """Mesh and assemble the machine."""
    geometry = geometry or KneeMillGeometry()
    mesh, column_side, knee_side = knee_mill_mesh(geometry)
    inside = _inside_facets(mesh, geometry, np.concatenate([column_side, knee_side]))
    free = np.setdiff1d(mesh.boundary_facets(), np.concatenate(inside))
    thermal = thermal_system(mesh, geometry.material, geometry.film_coefficient, free)
    strip, cavities, _ = inside
    heat = geometry.full_power / 2 * surface_heat(mesh, _heater_facets(mesh, cavities, geometry))
    # Each pair stands for its part of the strip, half of which belongs to either side.
    area = surface_heat(mesh, strip)[knee_side]
    area *= geometry.strip * (geometry.knee[1] - geometry.knee[0]) / area.sum()

    elastic = elastic_system(mesh, geometry.material, _relative_modulus(mesh, geometry))
    loads, held = _loads(mesh, elastic, geometry, column_side, knee_side)
    moves = elastic_responses(elastic, loads, held)
    compliance = loads.T @ moves
    thermal_moves = (elastic.expansion.T @ moves).T
    pairs = 3 * knee_side.size
    bodies = Bodies(
        joint=Joint(geometry.surface, geometry.clamping, area, compliance[:pairs, :pairs]),
        sides=(column_side, knee_side),
        gap_by_heat=MICROMETRES * thermal_moves[:pairs],
        gap_by_load=MICROMETRES * compliance[:pairs, -1],
        deflection_by_heat=MICROMETRES * thermal_moves[pairs:-1],
        deflection_by_force=MICROMETRES * compliance[pairs:-1, :pairs],
    )
    rows = _temperature_rows(mesh, geometry)
    return JointedPlant(thermal, heat, bodies, rows, geometry.material.conductivity)


def knee_mill_mesh(
    geometry: KneeMillGeometry,
) -> tuple[MeshHex, NDArray[np.integer], NDArray[np.integer]]:
    """Hexahedra of one half, and the nodes on either side of the joint, pair by pair.

    Both sides of the joint have nodes of their own at the same places.
    """
    g, n = geometry, geometry.refinement
    (bottom, top), (low, high), wall = g.knee, g.heater, g.wall
    front = g.column + g.strip_depth
    back_of_screw, front_of_screw = g.screw
    x = _lines(n, (wall, 1), (g.column - wall, 2), (g.column, 1), (front, 0), (front + wall, 1),
               (back_of_screw, 1), (front_of_screw, 1), (g.tool, 2), (g.depth - wall, 2),
               (g.depth, 1))  # fmt: skip
    y = _lines(n, (wall, 1), (g.base, 2), (bottom, 2), (bottom + wall, 1), (low, 2),
               (top - wall, 2), (high, 1), (top, 1), (g.height - g.arm, 4),
               (g.height - g.arm + wall, 1), (g.height - wall, 2), (g.height, 1))  # fmt: skip
    screw = (front_of_screw - back_of_screw) / 2
    z = _lines(n, (screw, 1), (g.half_width - g.strip, 2), (g.half_width - wall, 1),
               (g.half_width, 1))  # fmt: skip
    block = MeshHex.init_tensor(x, y, z)
    mesh = block.restrict(np.flatnonzero(_solid(_centres(block), g)))

    on_strip = np.abs(mesh.p[0] - g.column) < _MESH_TOLERANCE
    on_strip &= (mesh.p[1] > bottom - _MESH_TOLERANCE) & (mesh.p[1] < top + _MESH_TOLERANCE)
    on_strip &= mesh.p[2] > g.half_width - g.strip - _MESH_TOLERANCE
    column_side = np.flatnonzero(on_strip)
    knee_side = mesh.p.shape[1] + np.arange(column_side.size)
    renumbered = np.arange(mesh.p.shape[1])
    renumbered[column_side] = knee_side
    centre_x, centre_y, _ = _centres(mesh)
    knee = (centre_x > g.column) & (centre_y > bottom) & (centre_y < top)
    elements = mesh.t.copy()
    elements[:, knee] = renumbered[elements[:, knee]]
    points = np.hstack([mesh.p, mesh.p[:, column_side]])
    return MeshHex(points, elements, sort_t=False), column_side, knee_side


def _lines(refinement: float, *segments: tuple[float, int]) -> Array:
    """Grid lines from 0 through segments (end, elements); 0 elements are one that stays one."""
    lines = [np.zeros(1)]
    for end, count in segments:
        start = lines[-1][-1]
        if end > start + _MESH_TOLERANCE:
            elements = max(1, round(refinement * count))
            lines.append(np.linspace(start, end, elements + 1)[1:])
    return np.concatenate(lines)


def _solid(centres: Array, geometry: KneeMillGeometry) -> NDArray[np.bool_]:
    """Whether elements with their `centres` (3, n) are of iron."""
    x, y, z = centres
    g, (bottom, top), wall = geometry, geometry.knee, geometry.wall
    front, arm = g.column + g.strip_depth, g.height - g.arm
    thin = z < g.half_width - wall

    def box(lines: tuple[float, float], heights: tuple[float, float]) -> NDArray[np.bool_]:
        return (lines[0] < x) & (x < lines[1]) & (heights[0] < y) & (y < heights[1])

    column = box((0.0, g.column), (0.0, g.height))
    column &= ~(box((wall, g.column - wall), (wall, g.height - wall)) & thin)
    overarm = box((g.column, g.depth), (arm, g.height))
    overarm &= ~(box((g.column, g.depth - wall), (arm + wall, g.height - wall)) & thin)
    base = box((g.column, g.depth), (0.0, g.base))
    knee = box((front, g.depth), (bottom, top))
    knee &= ~(box((front + wall, g.depth - wall), (bottom + wall, top - wall)) & thin)
    strip = box((g.column, front), (bottom, top)) & (z > g.half_width - g.strip)
    return column | overarm | base | knee | strip | _of_screw(centres, g)


def _of_screw(centres: Array, geometry: KneeMillGeometry) -> NDArray[np.bool_]:
    x, y, z = centres
    back, front = geometry.screw
    inside = (back < x) & (x < front) & (z < (front - back) / 2)
    return inside & (geometry.base < y) & (y < geometry.knee[0])


def _relative_modulus(mesh: MeshHex, geometry: KneeMillGeometry) -> Array:
    return np.where(_of_screw(_centres(mesh), geometry), geometry.screw_modulus, 1.0)


def _centres(mesh: MeshHex) -> Array:
    centres: Array = mesh.p[:, mesh.t].mean(axis=1)
    return centres


def _inside_facets(
    mesh: MeshHex, geometry: KneeMillGeometry, joint: NDArray[np.integer]
) -> tuple[Facets, Facets, Facets]:
    """Facets that the air does not cool: both sides of the joint, the cavities, the symmetry."""
    g, (bottom, top) = geometry, geometry.knee
    facets = mesh.boundary_facets()
    nodes = mesh.facets[:, facets]
    x, y, z = mesh.p[:, nodes].mean(axis=1)
    at_joint = np.isin(nodes, joint).all(axis=0)
    edge = g.wall / 2
    inner = (z > _MESH_TOLERANCE) & (z < g.half_width - edge)
    column = (edge < x) & (x < g.column - edge) & (edge < y) & (y < g.height - edge)
    overarm = (g.column - edge < x) & (x < g.depth - edge)
    overarm &= (g.height - g.arm + edge < y) & (y < g.height - edge)
    knee = (g.column + g.strip_depth + edge < x) & (x < g.depth - edge)
    knee &= (bottom + edge < y) & (y < top - edge)
    cavity = inner & (column | overarm | knee) & ~at_joint
    return facets[at_joint], facets[cavity], facets[z < _MESH_TOLERANCE]


def _heater_facets(mesh: MeshHex, cavities: Facets, geometry: KneeMillGeometry) -> Facets:
    """Those of the `cavities` through which the heat enters the column's front wall."""
    low, high = geometry.heater
    x, y, _ = mesh.p[:, mesh.facets[:, cavities]].mean(axis=1)
    on_wall = np.abs(x - (geometry.column - geometry.wall)) < _MESH_TOLERANCE
    return cavities[on_wall & (low < y) & (y < high)]


def _loads(
    mesh: MeshHex,
    elastic: ElasticSystem,
    geometry: KneeMillGeometry,
    column_side: NDArray[np.integer],
    knee_side: NDArray[np.integer],
) -> tuple[Array, list[int]]:
    """Unit forces: between the pairs, at the deflections, on the table's end; what is held."""
    g, dofs, pairs = geometry, elastic.dofs, knee_side.size
    loads = np.zeros((dofs.size, 3 * pairs + 3))
    for axis in range(3):
        columns = axis * pairs + np.arange(pairs)
        loads[dofs[axis, knee_side], columns] += 1.0
        loads[dofs[axis, column_side], columns] -= 1.0
    tool = nearest_node(mesh, (g.tool, g.height - g.arm, 0.0))
    table = nearest_node(mesh, (g.tool, g.knee[1], 0.0))
    for axis in range(2):
        loads[dofs[axis, tool], 3 * pairs + axis] = 1.0
        loads[dofs[axis, table], 3 * pairs + axis] = -1.0
    edge = np.abs(mesh.p[0] - g.depth) + np.abs(mesh.p[1] - g.knee[1]) < _MESH_TOLERANCE
    loads[dofs[1, edge], -1] = -0.5 / np.count_nonzero(edge)
    # Feet at the four corners; the plane of symmetry stays where it is.
    held = [
        *dofs[2, np.abs(mesh.p[2]) < _MESH_TOLERANCE].tolist(),
        int(dofs[1, nearest_node(mesh, (0.0, 0.0, g.half_width))]),
        int(dofs[1, nearest_node(mesh, (g.depth, 0.0, g.half_width))]),
        int(dofs[0, nearest_node(mesh, (0.0, 0.0, 0.0))]),
    ]
    return loads, held


def _temperature_rows(mesh: MeshHex, geometry: KneeMillGeometry) -> dict[str, Array]:
    g, (bottom, top) = geometry, geometry.knee
    inner, outer = g.column - g.wall, g.half_width
    beside_strip = g.column + g.strip_depth / 2

    def at(x: float, y: float, z: float) -> Array:
        return temperature_row(mesh, (x, y, z))

    rows = {"dT_main_K": at(inner, g.heater[1] + 0.02, 0.0) - at(inner, g.heater[1] + 0.12, 0.0)}
    rows |= {
        name: at(beside_strip, bottom + height, outer) for name, height in JOINT_PROBES.items()
    }
    rows["T_column_degC"] = at(0.0, top, 0.0)
    rows["T_table_degC"] = at(g.tool, top, 0.0)
    return rows
