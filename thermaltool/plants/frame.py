"""A welded C-frame of thin-walled square steel tube, heated by a pad on either side of its column.

After the linear structure of Fraser (1997), sections 4.3 and 6.2: a one-piece scale model of a
vertical milling machine out of 6 mm wall, surface thermistors in pairs at increasing distance from
the pad, and the displacement between overarm and base along x (arms) and y (column). Its drawings
are not in the text. Dimensions and heat are chosen so that Q = 1 gives the published temperature
rise (58 K) and deflections (78 and 242 µm): 85 W into the column where the source spends 280 W in
four pads, for elongation alone is expansion * power / (film coefficient * girth).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from skfem import MeshHex

from thermaltool.plants.thermoelastic import (
    Array,
    Facets,
    HeatStepper,
    Material,
    ThermalSystem,
    deflection_rows,
    nearest_node,
    surface_heat,
    temperature_row,
    thermal_system,
)

# Probes of each pair: distances below the lower edge of the pad [m]. Pair 1 is Fraser's
# section 6.2 (one and two inches), pairs 2 and 3 are those of his section 8.
PROBE_PAIRS = {
    "dT_pair1_K": (0.0254, 0.0508),
    "dT_pair2_K": (0.017, 0.037),
    "dT_pair3_K": (0.007, 0.017),
}
HOTTEST_PROBE = 0.007
DEFLECTIONS = ("d_x_um", "d_y_um", "d_z_um")
OUTPUTS = ("T_column_degC", *PROBE_PAIRS, "d_x_um", "d_y_um")
_MESH_TOLERANCE = 1e-6  # smaller than any feature of the mesh [m]


@dataclass(frozen=True)
class PadArea:
    """Rectangle on each side wall of the column through which heat enters: x and y ranges [m]."""

    x: tuple[float, float]
    y: tuple[float, float]


@dataclass(frozen=True)
class FrameGeometry:
    """Dimensions [m], film coefficient [W/(m² K)] and full heat [W] of the C-frame.

    x runs along the arms, y up the column, z out of the plane of symmetry; `tool` is the x of the
    two points between which deflection is measured. `refinement` divides every element but those
    across the wall.
    """

    tube: float = 0.1
    wall: float = 0.006
    length: float = 0.35
    height: float = 0.8
    pad: PadArea = PadArea((0.05, 0.09), (0.39, 0.5))
    tool: float = 0.26
    film_coefficient: float = 13.5
    full_power: float = 85.0
    material: Material = field(default_factory=Material)
    refinement: int = 1


@dataclass(frozen=True)
class FramePlant:
    """The assembled frame: heat in, probe temperatures and deflections out.

    Attributes
    ----------
    thermal : ThermalSystem
    heat : (nodes,) ndarray
        Nodal load at Q = 1 [W].
    rows : mapping of str to (nodes,) ndarray
        Output channel to the row that gives it from the nodal temperature rises, in the unit of
        its name. Besides `OUTPUTS` there is ``d_z_um``, which symmetry makes zero.
    """

    thermal: ThermalSystem
    heat: Array
    rows: Mapping[str, Array]

    def simulate(
        self, heat: Array, ambient: Array, dt: float, substeps: int = 1
    ) -> dict[str, Array]:
        """Outputs without noise, from rest at the first ambient temperature.

        Parameters
        ----------
        heat : (n,) ndarray
            Q relative to full scale [1]; value k acts from sample k to sample k + 1.
        ambient : (n,) ndarray
            Temperature of the air [degC], held likewise.
        dt : float
            Sample period [s].
        substeps : int
            Integration steps per sample.

        Returns
        -------
        dict of str to (n,) ndarray
            `OUTPUTS`. Deflections count from the first sample.
        """
        observe = np.array([self.rows[name] for name in OUTPUTS])
        advance = HeatStepper(self.thermal, dt / substeps)
        state = np.zeros(self.heat.size)
        samples = np.empty((len(heat), len(OUTPUTS)))
        for k, (level, air) in enumerate(zip(heat, ambient - ambient[0], strict=True)):
            samples[k] = observe @ state
            load = level * self.heat + air * self.thermal.film
            for _ in range(substeps):
                state = advance(state, load)
        columns = dict(zip(OUTPUTS, samples.T, strict=True))
        columns["T_column_degC"] = columns["T_column_degC"] + ambient[0]
        return columns


def build(geometry: FrameGeometry | None = None) -> FramePlant:
    """Mesh and assemble the frame."""
    geometry = geometry or FrameGeometry()
    mesh = frame_mesh(geometry)
    outer = outer_facets(mesh, geometry)
    thermal = thermal_system(mesh, geometry.material, geometry.film_coefficient, outer)
    heat = geometry.full_power * surface_heat(mesh, pad_facets(mesh, outer, geometry))
    return FramePlant(thermal, heat, _output_rows(mesh, geometry))


def frame_mesh(geometry: FrameGeometry) -> MeshHex:
    """Hexahedra of the wall: inside the C-shaped outline, outside the same one inset by the wall.

    One element spans the wall. Lines lie on the edges of the pads and on the probes, and are dense
    between them, where the temperature gradient is largest.
    """
    tube, wall, half = geometry.tube, geometry.wall, geometry.tube / 2
    (left, right), (bottom, top) = geometry.pad.x, geometry.pad.y
    length, height, arm = geometry.length, geometry.height, geometry.height - tube
    probes = sorted({distance for pair in PROBE_PAIRS.values() for distance in pair})
    n = geometry.refinement
    x = _lines(
        (wall, 1),
        (left, 2 * n),
        (right, 4 * n),
        (tube - wall, n),
        (tube, 1),
        (geometry.tool, 5 * n),
        (length - wall, 2 * n),
        (length, 1),
    )
    y = _lines(
        (wall, 1),
        (tube - wall, 3 * n),
        (tube, 1),
        (bottom - 0.09, 5 * n),
        (bottom - 0.07, 2 * n),
        (bottom - probes[-1], 3 * n),
        *((bottom - distance, 2 * n) for distance in reversed(probes[:-1])),
        (bottom, 2 * n),
        (bottom + 0.015, 2 * n),
        (top - 0.015, 4 * n),
        (top, 2 * n),
        (top + 0.02, n),
        (arm, 5 * n),
        (arm + wall, 1),
        (height - wall, 3 * n),
        (height, 1),
    )
    z = _lines((wall - half, 1), (half - wall, 4 * n), (half, 1), start=-half)
    block = MeshHex.init_tensor(x, y, z)
    centres = block.p[:, block.t].mean(axis=1)
    solid = _inside(centres, geometry) & ~_inside(centres, geometry, inset=wall)
    return block.restrict(np.flatnonzero(solid))


def outer_facets(mesh: MeshHex, geometry: FrameGeometry) -> Facets:
    """Facets that the air touches; those of the closed cavity are left out."""
    facets = mesh.boundary_facets()
    cavity = _inside(facet_centres(mesh, facets), geometry, inset=geometry.wall / 2)
    return facets[~cavity]


def pad_facets(mesh: MeshHex, facets: Facets, geometry: FrameGeometry) -> Facets:
    """Those of `facets` that the pads cover, on both side walls."""
    x, y, z = facet_centres(mesh, facets)
    pad = geometry.pad
    side = np.abs(np.abs(z) - geometry.tube / 2) < _MESH_TOLERANCE
    covered = (pad.x[0] < x) & (x < pad.x[1]) & (pad.y[0] < y) & (y < pad.y[1])
    return facets[side & covered]


def facet_centres(mesh: MeshHex, facets: Facets) -> Array:
    """Midpoints of `facets` [m], shape (3, m)."""
    centres: Array = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    return centres


def _lines(*segments: tuple[float, int], start: float = 0.0) -> Array:
    """Grid lines from `start` through segments (end, number of elements)."""
    ends = [start, *(end for end, _ in segments)]
    pieces = [
        np.linspace(low, high, count + 1)[1:]
        for low, high, (_, count) in zip(ends, ends[1:], segments, strict=False)
    ]
    return np.concatenate([[start], *pieces])


def _inside(points: Array, geometry: FrameGeometry, inset: float = 0.0) -> NDArray[np.bool_]:
    """Whether points (3, n) lie inside the C-shaped outline drawn in by `inset`."""
    x, y, z = points
    block = (inset < x) & (x < geometry.length - inset)
    block &= (inset < y) & (y < geometry.height - inset)
    block &= np.abs(z) < geometry.tube / 2 - inset
    gap = (x > geometry.tube - inset) & (y > geometry.tube - inset)
    gap &= y < geometry.height - geometry.tube + inset
    return block & ~gap


def _output_rows(mesh: MeshHex, geometry: FrameGeometry) -> dict[str, Array]:
    middle, bottom = sum(geometry.pad.x) / 2, geometry.pad.y[0]
    half = geometry.tube / 2

    def probe(distance: float) -> Array:
        return temperature_row(mesh, (middle, bottom - distance, half))

    rows = {"T_column_degC": probe(HOTTEST_PROBE)}
    rows |= {name: probe(near) - probe(far) for name, (near, far) in PROBE_PAIRS.items()}
    tool = nearest_node(mesh, (geometry.tool, geometry.height - geometry.tube, 0.0))
    table = nearest_node(mesh, (geometry.tool, geometry.tube, 0.0))
    # Three feet under the base: two at the back, one in front; the front one guides along x.
    back, front = (0.0, 0.0, 0.0), (geometry.length, 0.0, 0.0)
    supports = [
        (nearest_node(mesh, (0.0, 0.0, -half)), 1),
        (nearest_node(mesh, (0.0, 0.0, half)), 1),
        (nearest_node(mesh, back), 0),
        (nearest_node(mesh, back), 2),
        (nearest_node(mesh, front), 1),
        (nearest_node(mesh, front), 2),
    ]
    pairs = [(tool, table, axis) for axis in range(3)]
    deflections = deflection_rows(mesh, geometry.material, pairs, supports)
    return rows | dict(zip(DEFLECTIONS, deflections, strict=True))
