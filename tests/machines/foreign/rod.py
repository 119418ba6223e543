"""A rod that is heated at one end and cooled along its side: 60 cells, two thermocouples."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.solver import Body

CELLS = 60
# Conductivity [W/(m K)], volumetric heat capacity [J/(m³ K)], expansion [1/K].
_MATERIALS = {
    "steel": (45.0, 3.7e6, 12e-6),
    "aluminium": (170.0, 2.45e6, 23e-6),
    "brass": (115.0, 3.2e6, 19e-6),
}


def rod(generator: Generator) -> Plant:
    """A rod of 0.25 to 0.45 m."""
    conductivity, capacity, expansion = _MATERIALS[str(generator.choice(list(_MATERIALS)))]
    length, radius = generator.uniform(0.25, 0.45), generator.uniform(0.008, 0.014)
    film = generator.uniform(8.0, 25.0)
    cell, section = length / CELLS, np.pi * radius**2
    conductance = conductivity * section / cell
    exchange = np.zeros((CELLS, CELLS))
    for k in range(CELLS - 1):
        exchange[k : k + 2, k : k + 2] += conductance * np.array([[1.0, -1.0], [-1.0, 1.0]])
    area = np.full(CELLS, 2 * np.pi * radius * cell)
    area[[0, -1]] += section
    body = Body(np.full(CELLS, capacity * section * cell), exchange, film * area, area)
    inlet = np.zeros(CELLS)
    inlet[:2] = 0.5
    # Up to 35 to 60 K at the heater.
    largest = round(generator.uniform(35.0, 60.0) / body.steady(inlet)[0], 1)

    def place(share: float) -> np.ndarray:
        at = share * CELLS - 0.5
        return np.maximum(1.0 - np.abs(np.arange(CELLS) - at), 0.0)

    slowest = capacity / (film * 2 / radius + conductivity * (np.pi / length) ** 2 / 4)
    dt = float(np.clip(round(6 * slowest / 1600), 5, 30))
    return Plant(
        name="rod",
        body=body,
        drives=(Drive("Q_heater_W", largest, inlet, lambda u: largest * u),),
        sensors={
            "T_near_degC": place(generator.uniform(0.12, 0.3)),
            "T_far_degC": place(generator.uniform(0.55, 0.9)),
        },
        deflections={"d_x_um": np.full(CELLS, 1e6 * expansion * cell)},
        noise={
            "T_near_degC": Noise(generator.uniform(0.005, 0.02), 0.005),
            "T_far_degC": Noise(generator.uniform(0.005, 0.02), 0.005),
            "d_x_um": Noise(generator.uniform(0.3, 0.6), 0.15, 0.01),
        },
        dt=dt,
        steps=1600,
        pump="Q_laser_1",
        source=int(generator.integers(20, 50)),
    )
