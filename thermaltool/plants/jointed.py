"""Two bodies with a joint in time: heat, displacement and contact in equilibrium at each step.

Heat that crosses the joint and forces between its nodes are few beside the nodes of the bodies.
Both problems are solved once for each of them; a step is one solve of the heat without the joint,
then small dense systems, iterated until heat and contact agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from thermaltool.plants import SettingError
from thermaltool.plants.contact import Contact, Joint
from thermaltool.plants.thermoelastic import SDIRK, Array, ThermalSystem, symmetric_factor

DEFLECTIONS = ("d_x_um", "d_y_um")
# Heat and contact agree where no pressure moves by more than this [kg/cm²].
PRESSURE_TOLERANCE = 1e-5
_MAX_ITERATIONS = 50


@dataclass(frozen=True)
class Bodies:
    """The elastic side of the plant, reduced to the joint and the deflections.

    Attributes
    ----------
    joint : Joint
    sides : pair of (pairs,) ndarray of int
        Nodes of the first and of the second body.
    gap_by_heat : (3 pairs, nodes) ndarray [µm/K]
    gap_by_load : (3 pairs,) ndarray [µm/N]
    deflection_by_heat : (2, nodes) ndarray [µm/K]
    deflection_by_force : (2, 3 pairs) ndarray [µm/N]
    """

    joint: Joint
    sides: tuple[NDArray[np.integer], NDArray[np.integer]]
    gap_by_heat: Array
    gap_by_load: Array
    deflection_by_heat: Array
    deflection_by_force: Array


@dataclass(frozen=True)
class JointedPlant:
    """The assembled machine: heat in, temperatures and deflections out.

    Attributes
    ----------
    thermal : ThermalSystem
        Without the joint.
    heat : (nodes,) ndarray
        Nodal load at Q = 1 [W].
    bodies : Bodies
    rows : mapping of str to (nodes,) ndarray
        Of the temperatures.
    conductivity : float [W/(m K)]
    """

    thermal: ThermalSystem
    heat: Array
    bodies: Bodies
    rows: Mapping[str, Array]
    conductivity: float

    def start(self, dt: float, load: float = 0.0) -> JointedRun:
        """A run from rest with a load on the end of the table [N]."""
        return JointedRun(self, dt, load)

    def simulate(
        self, heat: Array, ambient: Array, dt: float, load: float = 0.0, substeps: int = 1
    ) -> dict[str, Array]:
        """Outputs without noise, from rest at the first ambient temperature.

        Parameters
        ----------
        heat : (n,) ndarray
            Q relative to 197.5 W [1]; value k acts from sample k to sample k + 1.
        ambient : (n,) ndarray
            Temperature of the air [degC], held likewise.
        dt : float
            Sample period [s].
        load : float
            On the end of the table [N], there before the first sample.
        substeps : int
            Integration steps per sample.

        Returns
        -------
        dict of str to (n,) ndarray
            Deflections count from the first sample.

        Raises
        ------
        SettingError
            Heat and contact find no equilibrium in a step.
        """
        run = self.start(dt / substeps, load)
        names = (*self.rows, *DEFLECTIONS)
        samples = np.empty((len(heat), len(names)))
        for k, (level, air) in enumerate(zip(heat, ambient - ambient[0], strict=True)):
            samples[k] = run.outputs()
            for _ in range(substeps):
                run.advance(float(level), float(air))
        columns = dict(zip(names, samples.T, strict=True))
        for name in self.rows:
            if name.startswith("T_"):
                columns[name] = columns[name] + ambient[0]
        return columns


class JointedRun:
    """A plant in time; `outputs` before `advance`, sample by sample.

    Attributes
    ----------
    contact : Contact
        The joint now.
    iterations : int
        Of heat and contact, the most that a step has taken.
    residual : float [µm]
        Of the contact, the largest that a step has left.
    rise : (nodes,) ndarray [K]
        Temperatures above the start.
    """

    def __init__(self, plant: JointedPlant, dt: float, load: float) -> None:
        self._plant, self._dt = plant, dt
        thermal, bodies = plant.thermal, plant.bodies
        self._inner = SDIRK * dt
        self._capacity = sparse.csr_array(thermal.capacity) / self._inner
        self._factor = symmetric_factor(thermal.capacity / self._inner + thermal.conduction)
        column, knee = bodies.sides
        pairs = np.arange(column.size)
        across = np.zeros((plant.heat.size, column.size))
        across[knee, pairs] = 1.0
        across[column, pairs] = -1.0
        # Temperatures, differences across the joint and gaps by 1 W out of the knee at each pair.
        self._by_flux = self._factor.solve(across)
        self._drop_by_flux = self._by_flux[knee] - self._by_flux[column]
        self._gap_by_flux = bodies.gap_by_heat @ self._by_flux
        self._observe = np.vstack([*plant.rows.values(), bodies.deflection_by_heat])
        self.rise = np.zeros(plant.heat.size)
        self._load = load * bodies.gap_by_load
        self.iterations, self.residual, self._steps = 0, 0.0, 0
        closed = bodies.joint.closed()
        self.contact = bodies.joint.equilibrium(self._load, closed, closed.slip)
        self._check(self.contact)
        self._first = bodies.deflection_by_force @ self.contact.force

    def outputs(self) -> Array:
        """Temperature rises, then deflections from the first sample."""
        values = self._observe @ self.rise
        values[-2:] += self._plant.bodies.deflection_by_force @ self.contact.force - self._first
        return values

    def advance(self, level: float, air: float) -> None:
        """One step with held heat Q [1] and air [K above the first]."""
        load = level * self._plant.heat + air * self._plant.thermal.film
        first, _ = self._stage(self.rise, load)
        middle = self.rise + (1 - SDIRK) / SDIRK * (first - self.rise)
        self.rise, self.contact = self._stage(middle, load)
        self._steps += 1

    def _stage(self, before: Array, load: Array) -> tuple[Array, Contact]:
        """An implicit step from `before` in which heat and contact agree."""
        bodies, area = self._plant.bodies, self._plant.bodies.joint.area
        column, knee = bodies.sides
        free = self._factor.solve(self._capacity @ before + load)
        drop = free[knee] - free[column]
        gap = bodies.gap_by_heat @ free + self._load
        slip, contact = self.contact.slip, self.contact
        pressure, count = np.full(area.size, np.inf), 0
        while np.max(np.abs(contact.pressure - pressure)) >= PRESSURE_TOLERANCE:
            if count == _MAX_ITERATIONS:
                raise SettingError(self._where("heat and contact do not agree"))
            pressure, count = contact.pressure, count + 1
            passes = area * bodies.joint.surface.conductance(pressure, self._plant.conductivity)
            flux = np.linalg.solve(
                np.eye(area.size) + passes[:, None] * self._drop_by_flux, passes * drop
            )
            contact = bodies.joint.equilibrium(gap - self._gap_by_flux @ flux, contact, slip)
            self._check(contact)
        self.iterations = max(self.iterations, count)
        return free - self._by_flux @ flux, contact

    def _check(self, contact: Contact) -> None:
        if not contact.converged:
            raise SettingError(self._where("the contact finds no equilibrium"))
        self.residual = max(self.residual, contact.residual)

    def _where(self, what: str) -> str:
        time = self._steps * self._dt
        return f"{what} {time:g} s from the start: less heat or load, or a shorter --dt"
