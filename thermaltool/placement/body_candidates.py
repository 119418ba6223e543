"""Candidates on a finite-element model: nodes of its surface or points, under random heat.

Each heat switches at random between nothing and its largest value. With a correlation time T (it
stays at a level for 2 T on average) its autocovariance is σ² e^(−|t|/T), and modes with the rates
λ and the forcing ξ have the covariance σ² ξ_i ξ_j (1/(λ_i + 1/T) + 1/(λ_j + 1/T))/(λ_i + λ_j) (the
stationary Lyapunov equation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import ModelError
from thermaltool.fitting.data import Array
from thermaltool.placement.body import SIDE, SolidBody
from thermaltool.placement.candidates import DutyCycle
from thermaltool.placement.sensor_sets import SensorSet
from thermaltool.placement.thermal_modes import ThermalEigenmodes
from thermaltool.record import hint
from thermaltool.units import UNITS, parse_channel

# Correlation times of a heat, in slowest time constants: from steady states to switching.
CORRELATION_TIMES = (1.0, 0.1, 0.01)
# Nodes among which sensors are sought, at most; of a finer mesh evenly spread ones.
MAX_NODES = 5000
# A candidate is near a heat within this part of the body's largest extent.
NEAR_HEAT = 0.25
# Part of the largest variance below which a combination of modes is none.
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class BodySites:
    """Places on a body where a sensor may be.

    Attributes
    ----------
    names : tuple of str
        Points as declared; T_n12_degC is node 12 of the mesh.
    places : ndarray, shape (N, dim) [m]
    shapes : ndarray, shape (N, modes) [K]
        Every mode there.
    distance : ndarray, shape (N,) [m]
        To the nearest node that is heated.
    nodes : ndarray of int, shape (N,)
        The node nearest to each place.
    """

    names: tuple[str, ...]
    places: Array
    shapes: Array
    distance: Array
    nodes: NDArray[np.int64]

    def at(self, body: SolidBody, name: str) -> NDArray[np.bool_]:
        """Which of them a point (the nearest) or a boundary of the body has, shape (N,).

        Raises
        ------
        ModelError
            No such point or boundary.
        """
        if name in self.names:
            return np.array([each == name for each in self.names])
        if name in body.points:
            away = np.linalg.norm(self.places - body.points[name], axis=1)
            return np.asarray(away == away.min())
        boundaries = body.mesh.boundaries or {}
        if body.section is not None and name == SIDE:
            return np.ones(len(self.names), bool)
        if name not in boundaries:
            message = f"no point or boundary is called {name}"
            raise ModelError(f"{message}{hint(name, [*body.points, *body.boundaries])}")
        return np.isin(self.nodes, body.mesh.facets[:, boundaries[name]])


@dataclass(frozen=True)
class BodySensors:
    """Where on a body sensors belong.

    Attributes
    ----------
    name : str
        Of the body.
    body : SolidBody
    modes : ThermalEigenmodes
    outputs : tuple of str
        Deflections that are to be predicted.
    criterion : {"I", "A", "D", "modes"}
    sets : tuple of SensorSet
        For 1, 2, 3 … sensors; by the rule of the modes one.
    sites : BodySites
        All candidates.
    reading_noise : float [K]
    """

    name: str
    body: SolidBody
    modes: ThermalEigenmodes
    outputs: tuple[str, ...]
    criterion: str
    sets: tuple[SensorSet, ...]
    sites: BodySites
    reading_noise: float

    @property
    def chosen(self) -> dict[str, int]:
        """Sensors of any set, and which of the sites each is."""
        number = {name: k for k, name in enumerate(self.sites.names)}
        return {name: number[name] for each in self.sets for name in each.sensors}


def surface_nodes(body: SolidBody) -> NDArray[np.int64]:
    """Nodes of the surface, at most `MAX_NODES` of them; of a rod all nodes.

    Parameters
    ----------
    body : SolidBody
    """
    mesh = body.mesh
    nodes = np.arange(mesh.p.shape[1])
    if body.section is None:
        nodes = np.unique(mesh.facets[:, mesh.boundary_facets()])
    return np.asarray(nodes[:: -(-len(nodes) // MAX_NODES)], np.int64)


def sites_of(modes: ThermalEigenmodes, body: SolidBody, points: Sequence[str] = ()) -> BodySites:
    """Declared points as candidates; without any the nodes of the surface.

    Parameters
    ----------
    modes : ThermalEigenmodes
    body : SolidBody
    points : sequence of str

    Raises
    ------
    ModelError
        A point that is not declared.
    """
    where = body.mesh.p.T
    heated = where[np.any(modes.equations.loads != 0, axis=1)]
    if points:
        for name in points:
            if name not in body.points:
                raise ModelError(f"no point is called {name}{hint(name, body.points)}")
        rows = [list(body.points).index(name) for name in points]
        places = np.array([body.points[name] for name in points], float)
        shapes = np.asarray(modes.equations.readings @ modes.shapes)[rows]
        nodes = np.array([np.argmin(np.linalg.norm(where - at, axis=1)) for at in places], np.int64)
        names = tuple(points)
    else:
        nodes = surface_nodes(body)
        places, shapes = where[nodes], modes.shapes[nodes]
        names = tuple(f"T_n{node}_degC" for node in nodes)
    distance = np.array([np.linalg.norm(heated - at, axis=1).min() for at in places])
    return BodySites(names, places, shapes, distance, nodes)


def far_from_heat(
    modes: ThermalEigenmodes, body: SolidBody, sites: BodySites, allowed: NDArray[np.bool_]
) -> list[str]:
    """A sentence for every heat that no candidate is near to.

    Parameters
    ----------
    modes : ThermalEigenmodes
    body : SolidBody
    sites : BodySites
    allowed : ndarray of bool, shape (N,)
        Candidates that can be taken.
    """
    where = body.mesh.p.T
    reach = NEAR_HEAT * float(np.ptp(where, axis=0).max())
    found = []
    for name, load in zip(body.largest, np.asarray(modes.equations.loads).T, strict=True):
        heated = where[load != 0]
        away = [float(np.linalg.norm(heated - at, axis=1).min()) for at in sites.places[allowed]]
        if away and min(away) > reach:
            nearest = np.array(sites.names)[allowed][int(np.argmin(away))]
            found.append(
                f"no candidate is near {name}, within {reach:.3g} m (a quarter of the body): the "
                f"nearest, {nearest}, is {min(away):.3g} m away, and sees late what the heat does"
            )
    return found


def largest_heats(body: SolidBody) -> Array:
    """Largest value of every heat, shape (heat,) [W]."""
    return np.array([
        value * UNITS[parse_channel(name).unit][1] for name, value in body.largest.items()
    ])  # fmt: skip


def duty_cycles_of(
    modes: ThermalEigenmodes, sites: BodySites, deflections: Array, largest: Array
) -> list[DutyCycle]:
    """Each heat alone, switched at random, slowly and quickly.

    Parameters
    ----------
    modes : ThermalEigenmodes
    sites : BodySites
    deflections : ndarray, shape (p, n) [unit of the deflections / K]
        Rows of nodal temperatures.
    largest : ndarray, shape (heat,) [W]
    """
    rates = 1 / modes.time_constants
    moved = np.asarray(deflections @ modes.shapes)
    found = []
    for forcing, size in zip((modes.modal_heat * rates[:, None]).T, largest, strict=True):
        for part in CORRELATION_TIMES:
            passed = 1 / (rates + 1 / (part * modes.time_constants[0]))
            cover = np.outer(forcing, forcing) * np.add.outer(passed, passed)
            cover /= np.add.outer(rates, rates)
            steady = forcing / rates
            # The second moment about rest: a heat that is on half of the time has a mean.
            values, vectors = np.linalg.eigh((size / 2) ** 2 * (cover + np.outer(steady, steady)))
            kept = values > NEGLIGIBLE * values[-1]
            root = vectors[:, kept] * np.sqrt(values[kept])
            found.append(DutyCycle(sites.shapes @ root, moved @ root))
    return found


def dominant_weights(modes: ThermalEigenmodes, largest: Array) -> Array:
    """Weights of the modes over all heats at their largest, shape (modes,)."""
    return np.asarray(modes.weights @ largest)


def costs_of(sites: BodySites, body: SolidBody, costs: Mapping[str, float]) -> Array:
    """What a sensor costs at every site, shape (N,); 1 where nothing is said.

    Parameters
    ----------
    sites : BodySites
    body : SolidBody
    costs : mapping of point or boundary to float
    """
    found = np.ones(len(sites.names))
    for name, cost in costs.items():
        found[sites.at(body, name)] = cost
    return found
