"""A chain of lumped heat capacities with process noise, by matrix exponentials of the whole system.

Motor, frame, foot, ... : the first is heated and measured, the last loses its heat to the room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """Capacities [J/K], conductances to the next one and from the last to the room [W/K].

    Attributes
    ----------
    capacity, conductance : sequence of float
    diffusion : float [W √s]
        Process noise of the heated node.
    noise : float [K]
        Of a reading.
    """

    capacity: Sequence[float]
    conductance: Sequence[float]
    diffusion: float = 2.0
    noise: float = 0.05

    def system(self) -> tuple[Array, Array]:
        """A [1/s] and B, of heat [W] and room [°C]."""
        n = len(self.capacity)
        A, B = np.zeros((n, n)), np.zeros((n, 2))
        for i, G in enumerate(self.conductance):
            A[i, i] -= G / self.capacity[i]
            if i + 1 < n:
                A[i, i + 1] += G / self.capacity[i]
                A[i + 1, i] += G / self.capacity[i + 1]
                A[i + 1, i + 1] -= G / self.capacity[i + 1]
        B[0, 0], B[-1, 1] = 1 / self.capacity[0], self.conductance[-1] / self.capacity[-1]
        return A, B

    def run(
        self, time: Array, heat: Array, room: Array, rng: np.random.Generator, every: bool = False
    ) -> Array:
        """Readings of the heated node, shape (n,), or temperatures of all nodes without noise.

        Heat is held from row to row, the room runs straight; everything begins at the room's first
        temperature.
        """
        A, B = self.system()
        n = len(A)
        intensity = np.zeros((n, n))
        intensity[0, 0] = (self.diffusion / self.capacity[0]) ** 2
        state, found = np.full(n, room[0]), np.empty((len(time), n))
        steps: dict[float, tuple[Array, Array]] = {}
        for k in range(len(time)):
            found[k] = state
            if k + 1 == len(time):
                break
            dt = float(time[k + 1] - time[k])
            if dt not in steps:
                steps[dt] = _discrete(A, B, intensity, dt)
            move, root = steps[dt]
            slope = np.array([0.0, (room[k + 1] - room[k]) / dt])
            state = move @ np.concatenate([state, [heat[k], room[k]], slope])
            state = state + root @ rng.standard_normal(n)
        if every:
            return found
        return np.asarray(found[:, 0] + self.noise * rng.standard_normal(len(time)))


def _discrete(A: Array, B: Array, intensity: Array, dt: float) -> tuple[Array, Array]:
    """What state, inputs and their slopes become after dt, and a root of the noise."""
    n = len(A)
    whole = np.zeros((n + 4, n + 4))
    whole[:n, :n], whole[:n, n : n + 2], whole[n : n + 2, n + 2 :] = A, B, np.eye(2)
    pair = np.block([[-A, intensity], [np.zeros((n, n)), A.T]])
    both = expm(pair * dt)
    noise = both[n:, n:].T @ both[:n, n:]
    values, vectors = np.linalg.eigh((noise + noise.T) / 2)
    return expm(whole * dt)[:n], vectors * np.sqrt(np.maximum(values, 0.0))


def inputs(rows: int, period: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Time [s], heat in blocks of random levels up to 150 W, and a room that wanders [°C]."""
    heat: Array = np.repeat(rng.uniform(0.0, 150.0, rows // 25 + 1), 25)[:rows]
    heat[: min(20, rows)] = 0.0
    wander: Array = np.cumsum(0.01 * rng.standard_normal(rows))
    clock: Array = period * np.arange(rows, dtype=np.float64)
    return clock, heat, 20.0 + wander


def declaration(nodes: int, **start: float) -> dict[str, object]:
    """The chain as a network of ``thermaltool rc``; `start` by short names like C1, G2, s, r."""
    names = ["motor", "frame", "foot", "base"][:nodes]
    document: dict[str, dict[str, dict[str, object]]] = {"nodes": {}, "links": {}, "heat": {}}
    for k, name in enumerate(names):
        node: dict[str, object] = {}
        if f"C{k + 1}" in start:
            node["capacity"] = start[f"C{k + 1}"]
        document["nodes"][name] = node
        ends = [name, names[k + 1] if k + 1 < nodes else "T_room_degC"]
        link: dict[str, object] = {"between": ends}
        if f"G{k + 1}" in start:
            link["conductance"] = start[f"G{k + 1}"]
        document["links"][f"{ends[0]}-{ends[1]}"] = link
    motor = document["nodes"]["motor"]
    motor["measured"] = "T_motor_degC"
    for field, short in (("diffusion", "s"), ("noise", "r")):
        if short in start:
            motor[field] = start[short]
    document["heat"]["motor"] = {"channel": "Q_motor_W", "node": "motor"}
    return {"format": "thermaltool-rc", "version": 1, "name": f"{nodes} nodes", **document}
