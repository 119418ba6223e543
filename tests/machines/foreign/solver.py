"""Heat in a body of nodes, stepped through time: capacities, exchange, film, what acts on it.

Stepped by the L-stable diagonally implicit Runge-Kutta scheme of second order (Alexander 1977), its
matrices formed once for every state of film and mass. numpy alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Step and temperatures in; factor of the film coefficients, and heat into the nodes [W], out.
React = Callable[[int, Array], tuple[float, Array | float]]

STEFAN_BOLTZMANN = 5.670374e-8  # [W/(m² K⁴)]
REST_KELVIN = 293.15
_GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
_SUBSTEPS = 2  # of a step of the grid


@dataclass(frozen=True)
class Body:
    """Nodes that exchange heat.

    Parameters
    ----------
    capacity : (n,) ndarray [J/K]
    exchange : (n, n) ndarray [W/K]
        Heat that leaves a node (row) to the others; rows sum to zero.
    film : (n,) ndarray [W/K]
        To the air.
    area : (n,) ndarray [m²]
        That may radiate.
    properties : function, optional
        From temperatures above rest to capacities and exchange, where they depend on them.
    """

    capacity: Array
    exchange: Array
    film: Array
    area: Array
    properties: Callable[[Array], tuple[Array, Array]] | None = None

    @property
    def nodes(self) -> int:
        return len(self.capacity)

    @property
    def slowest(self) -> float:
        """Largest time constant [s]."""
        rates = np.linalg.eigvals((self.exchange + np.diag(self.film)) / self.capacity[:, None])
        return float(1.0 / rates.real.min())

    def steady(self, heat: Array, air: float = 0.0) -> Array:
        """Temperatures above rest that a constant `heat` (n,) [W] and `air` [K] lead to."""
        ends: Array = np.zeros(self.nodes)
        for _ in range(60 if self.properties else 1):
            exchange = self.properties(ends)[1] if self.properties else self.exchange
            driven = heat + self.film * air
            ends = np.asarray(np.linalg.solve(exchange + np.diag(self.film), driven), float)
        return ends


def lumped(
    generator: np.random.Generator,
    links: Mapping[tuple[int, int], float],
    capacities: Sequence[float],
    films: Sequence[float],
) -> Body:
    """A network of lumps, each number up to a third off the middling one that is given.

    Parameters
    ----------
    generator : Generator
    links : mapping of pair of nodes to float [W/K]
    capacities : sequence of float [J/K]
    films : sequence of float [W/K]
    """

    def about(values: Sequence[float]) -> Array:
        return np.array(values) * np.exp(generator.uniform(-0.3, 0.3, len(values)))

    exchange = np.zeros((len(capacities), len(capacities)))
    for (a, b), g in zip(links, about(list(links.values())), strict=True):
        exchange[np.ix_([a, b], [a, b])] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])
    areas = [film / 12 for film in films]
    return Body(about(capacities), exchange, about(films), about(areas))


@dataclass
class Loads:
    """What acts on a body at the instants of an even grid, held from each to the next.

    Parameters
    ----------
    heat : (m, n) ndarray [W]
    air : (m,) ndarray [K]
        Above rest.
    film, mass : (m,) ndarray
        Factors of all film coefficients and of all capacities.
    emissivity : float
    react : list of functions
        What answers the temperatures of the moment.
    """

    heat: Array
    air: Array
    film: Array
    mass: Array
    emissivity: float = 0.0
    react: list[React] = field(default_factory=list)


def simulate(body: Body, dt: float, loads: Loads) -> Array:
    """Temperatures above rest (m, n) at the instants of a grid of step `dt` [s], from rest.

    At rest all nodes are as warm as the air.
    """
    m, n = loads.heat.shape
    here = np.full(n, loads.air[0])
    temperature = np.empty((m, n))
    temperature[0] = here
    known: dict[tuple[float, float], tuple[Array, Array]] = {}
    for k in range(m - 1):
        film, heat = float(loads.film[k]), loads.heat[k]
        for react in loads.react:
            factor, more = react(k, here)
            film, heat = film * factor, heat + more
        if loads.emissivity:
            heat = heat - loads.emissivity * body.area * _radiated(here)
        air = 0.5 * (loads.air[k] + loads.air[k + 1])
        heat = heat + film * body.film * air
        key = round(film, 5), round(float(loads.mass[k]), 5)
        if body.properties:
            operators = _operators(body, dt, *key, *body.properties(here))
        elif key not in known:
            known[key] = operators = _operators(body, dt, *key, body.capacity, body.exchange)
        else:
            operators = known[key]
        here = operators[0] @ here + operators[1] @ heat
        temperature[k + 1] = here
    return temperature


def _radiated(above: Array) -> Array:
    """What is radiated beyond the linear law of rest [W/m²]: that is in the film coefficient."""
    rest = REST_KELVIN
    return STEFAN_BOLTZMANN * ((rest + above) ** 4 - rest**4 - 4 * rest**3 * above)


def _operators(
    body: Body, dt: float, film: float, mass: float, capacity: Array, exchange: Array
) -> tuple[Array, Array]:
    """What a step makes of the temperatures and of the heat."""
    h, one = dt / _SUBSTEPS, np.eye(body.nodes)
    inverse = 1.0 / (mass * capacity)
    a = inverse[:, None] * (exchange + np.diag(film * body.film))
    s = np.linalg.inv(one + _GAMMA * h * a)
    sa = s @ a
    first = -sa, s
    second = (
        -sa @ (one + (1 - _GAMMA) * h * first[0]),
        s - (1 - _GAMMA) * h * sa @ first[1],
    )
    keep, add = (h * ((1 - _GAMMA) * x + _GAMMA * y) for x, y in zip(first, second, strict=True))
    keep = one + keep
    whole, driven = one, np.zeros_like(one)
    for _ in range(_SUBSTEPS):
        whole, driven = keep @ whole, keep @ driven + add
    return whole, driven * inverse
