"""A machine of lumped heat capacities: a column of two walls, an arm, and a bearing that heats.

Column and arm are cut into segments, each of one temperature (finite volumes): heat is conducted
between neighbours, the foot rests on a foundation of constant temperature, and every surface loses
heat to the air. Deflections follow from free expansion and from bending by the temperature
difference of the two walls. Temperatures here are rises [K] above rest, the machine and its
surroundings being at `REST`.

Every `machine_seed` draws another material, geometry and air film, so that each machine is a
different one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REST = 20.0  # [degC]
KELVIN = 273.15
STEFAN_BOLTZMANN = 5.670374419e-8  # [W/(m² K⁴)], CODATA 2018
OUTPUTS = ("dT_near_K", "dT_far_K", "T_column_degC", "d_x_um", "d_y_um")

# Segments of a wall and of the arm; nodes are numbered front, back, arm, bearing.
WALL, ARM = 10, 6
BEARING = 2 * WALL + ARM
NODES = BEARING + 1

# Density [kg/m³], specific heat [J/(kg K)], conductivity [W/(m K)], expansion [1/K]: handbook
# values of structural steel, grey cast iron and an aluminium alloy.
MATERIALS = (
    (7850.0, 470.0, 50.0, 11.7e-6),
    (7200.0, 500.0, 48.0, 10.5e-6),
    (2700.0, 900.0, 160.0, 23.5e-6),
)
_SLOWEST = (200.0, 3000.0)  # accepted slowest time constant [s]


@dataclass(frozen=True)
class Network:
    """Heat balance of the nodes and what sensors and tool see of it.

    Parameters
    ----------
    capacity : (n,) ndarray
        Heat capacities [J/K].
    conductance : (n, n) ndarray
        Symmetric conductances between nodes, and of nodes to the foundation [W/K].
    film : (n,) ndarray
        Film coefficient times surface [W/K].
    area : (n,) ndarray
        Surface [m²].
    heated : int
        Wall segment that carries the bearing.
    power : float
        Heat at full drive [W].
    rows : (k, n) ndarray
        `OUTPUTS` of the temperatures, in their units per kelvin.
    """

    capacity: Array
    conductance: Array
    film: Array
    area: Array
    heated: int
    power: float
    rows: Array

    def balance(self, film: float = 1.0) -> Array:
        """Matrix G [W/K] of C dT/dt = -G T + heat, the film coefficient times `film`."""
        return self.conductance + np.diag(film * self.film)

    def modes(self, film: float = 1.0) -> tuple[Array, Array]:
        """Rates [1/s] ascending, and shapes V (n, n) with V' C V = 1."""
        root = np.sqrt(self.capacity)
        rates, shapes = np.linalg.eigh(self.balance(film) / np.outer(root, root))
        return np.asarray(rates), shapes / root[:, None]

    @property
    def slowest(self) -> float:
        """Slowest time constant [s]."""
        return float(1.0 / self.modes()[0][0])

    def steady(self, heat: Array) -> Array:
        """Temperatures (n,) that a constant `heat` (n,) [W] ends at."""
        return np.asarray(np.linalg.solve(self.balance(), heat))

    def swinging(self, heat: Array, period: float) -> NDArray[np.complex128]:
        """Temperatures (n,) under `heat` (n,) [W] times exp(2 pi i t / period), once settled."""
        stored = 2j * np.pi / period * np.diag(self.capacity)
        return np.asarray(np.linalg.solve(self.balance() + stored, heat))

    def source(self, node: int, power: float) -> Array:
        """Heat (n,) of `power` [W] at one node."""
        heat = np.zeros(len(self.capacity))
        heat[node] = power
        return heat

    def simulate(
        self,
        heat: Array,
        dt: float,
        film: Array | None = None,
        air: Array | None = None,
        emissivity: float = 0.0,
    ) -> Array:
        """Temperatures from rest, at the samples.

        Parameters
        ----------
        heat : (m, n) ndarray
            Heat into the nodes [W], held from each sample to the next.
        dt : float
            Sample period [s].
        film : (m,) ndarray, optional
            Film coefficient relative to its usual one, held likewise; few different values.
        air : (m,) ndarray, optional
            Rise of the air [K] above rest, held likewise.
        emissivity : float
            Of all surfaces. The film holds the linear part of radiation, as a calibration at low
            temperature finds it; this adds what the fourth power has beyond it.

        Returns
        -------
        temperature : (m, n) ndarray
            Exact for held inputs; of second order in `dt` by the radiation.
        """
        length = len(heat)
        factors, state = np.unique(np.ones(length) if film is None else film, return_inverse=True)
        steps = [self._propagator(float(f), dt) for f in factors]
        flux = heat if air is None else heat + np.outer(factors[state] * air, self.film)
        radiated = emissivity * STEFAN_BOLTZMANN * self.area
        rest = REST + KELVIN
        temperature = np.zeros((length, len(self.capacity)))
        now = temperature[0]
        for k in range(length - 1):
            decay, gain = steps[state[k]]
            free = decay @ now + gain @ flux[k]
            if emissivity:
                # Mean loss over the sample; the corrections shrink by dt/time constant each.
                before = radiated * _beyond_linear(now, rest)
                after = before
                for _ in range(2):
                    after = radiated * _beyond_linear(free - gain @ (before + after) / 2, rest)
                free = free - gain @ (before + after) / 2
            temperature[k + 1] = now = free
        return temperature

    def _propagator(self, film: float, dt: float) -> tuple[Array, Array]:
        """Temperature after `dt` by the one before, and by the heat held meanwhile."""
        rates, shapes = self.modes(film)
        decay = (shapes * np.exp(-rates * dt)) @ (shapes.T * self.capacity)
        gain = (shapes * (-np.expm1(-rates * dt) / rates)) @ shapes.T
        return decay, gain


def _beyond_linear(rise: Array, rest: float) -> Array:
    """T⁴ - T0⁴ - 4 T0³ (T - T0) [K⁴], T in kelvin a `rise` above T0."""
    squared: Array = rise * rise
    return squared * (6 * rest**2 + rise * (4 * rest + rise))


@lru_cache(maxsize=256)
def machine(machine_seed: int) -> Network:
    """The machine of a seed: the first draw of plausible time constants and deflections."""
    generator = np.random.default_rng([machine_seed, 101])
    while True:
        drawn = _draw(generator)
        if drawn is not None:
            return drawn


def _draw(generator: np.random.Generator) -> Network | None:
    """A machine of random material, geometry and film; None where it is not a plausible one."""
    uniform = generator.uniform
    density, heat_capacity, conductivity, expansion = MATERIALS[generator.integers(len(MATERIALS))]
    height, depth, breadth = uniform(0.25, 0.7), uniform(0.08, 0.3), uniform(0.08, 0.3)
    arm = uniform(0.3, 0.8) * height
    thickness = np.exp(uniform(np.log(0.003), np.log(0.015)))
    film = np.exp(uniform(np.log(8.0), np.log(50.0)))
    web = uniform(0.1, 1.0)  # material between the walls, as a share of a closed box
    heated = int(generator.integers(5, 9))

    front, back, beam = range(WALL), range(WALL, 2 * WALL), range(2 * WALL, BEARING)
    dz, dx = height / WALL, arm / ARM
    area = np.zeros(NODES)
    area[:BEARING] = breadth * np.r_[np.full(2 * WALL, dz), np.full(ARM, dx)]
    capacity = density * heat_capacity * thickness * area
    along = conductivity * breadth * thickness

    conductance = np.zeros((NODES, NODES))

    def join(a: int, b: int, value: float) -> None:
        conductance[[a, b], [a, b]] += value
        conductance[[a, b], [b, a]] -= value

    for wall in (front, back):
        for a, b in pairwise(wall):
            join(a, b, along / dz)
        conductance[wall[0], wall[0]] += uniform(0.1, 1.0) * along / (dz / 2)
    for a, b in zip(front, back, strict=True):
        join(a, b, web * conductivity * 2 * thickness * dz / depth)
    join(front[heated], beam[0], uniform(0.3, 1.0) * along / ((dz + dx) / 2))
    for a, b in pairwise(beam):
        join(a, b, along / dx)
    # The bearing: a block that passes its heat to the wall within 20 to 100 s.
    capacity[BEARING] = uniform(0.3, 2.0) * capacity[heated]
    area[BEARING] = 0.3 * area[heated]
    join(BEARING, front[heated], capacity[BEARING] / np.exp(uniform(np.log(20.0), np.log(100.0))))

    rows = np.zeros((len(OUTPUTS), NODES))
    # Sensors on the front wall begin a segment below the source; the far pair ends at the back.
    rows[0, [heated - 1, heated - 4]] = 1.0, -1.0
    rows[1, [heated - 3, WALL + 1]] = 1.0, -1.0
    rows[2, heated - 1] = 1.0
    # A front wall warmer than the back tilts the column backwards and lifts the arm.
    lever = np.maximum((heated - np.arange(WALL)) * dz, 0.0)
    tilt = expansion * dz / depth * (lever > 0)
    rows[3, beam.start : beam.stop] = expansion * dx * 1e6
    rows[3, :BEARING] -= np.r_[tilt * lever, -tilt * lever, np.zeros(ARM)] * 1e6
    rows[4, :BEARING] = np.r_[tilt * arm, -tilt * arm, np.zeros(ARM)] * 1e6
    rows[4, : 2 * WALL] += np.tile(expansion * dz / 2 * (lever > 0), 2) * 1e6

    network = Network(capacity, conductance, film * area, area, heated, 1.0, rows)
    reached = rows @ network.steady(network.source(BEARING, 1.0))
    power = uniform(15.0, 45.0) / max(abs(reached[0]), abs(reached[1]))
    near, far, rise, x, y = np.abs(power * reached)
    plausible = min(near, far) > 8.0 and rise < 80.0 and all(40.0 < d < 180.0 for d in (x, y))
    if not plausible or not _SLOWEST[0] < network.slowest < _SLOWEST[1]:
        return None
    return Network(capacity, conductance, film * area, area, heated, float(power), rows)
