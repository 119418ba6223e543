"""A furnace wall whose conductivity and heat capacity change with temperature."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import ramps
from machines.foreign.solver import Array, Body

CELLS = 30


def slab(generator: Generator) -> Plant:
    """A slab of 60 to 120 mm, heated on one face up to 150 to 300 K above the room."""
    thickness, area = generator.uniform(0.06, 0.12), generator.uniform(0.2, 0.5)
    conductivity, capacity = generator.uniform(1.0, 3.0), generator.uniform(2.0e6, 2.8e6)
    # Change over 100 K: of fireclay, which conducts better and stores more when hot.
    better, more = generator.uniform(0.01, 0.04), generator.uniform(0.01, 0.04)
    cell = thickness / CELLS

    def properties(above: Array) -> tuple[Array, Array]:
        between = 0.5 * (above[1:] + above[:-1])
        g = conductivity * area / cell * (1.0 + better * between / 100)
        exchange = np.zeros((CELLS, CELLS))
        k = np.arange(CELLS - 1)
        exchange[k, k] += g
        exchange[k + 1, k + 1] += g
        exchange[k, k + 1] -= g
        exchange[k + 1, k] -= g
        return capacity * area * cell * (1.0 + more * above / 100), exchange

    surface = np.zeros(CELLS)
    surface[[0, -1]] = area
    film = generator.uniform(10.0, 20.0) * surface
    film[0] *= 0.3  # the hot face looks into the furnace
    start = properties(np.zeros(CELLS))
    body = Body(start[0], start[1], film, surface, properties)
    inlet = np.zeros(CELLS)
    inlet[0] = 1.0
    watts = generator.uniform(150.0, 300.0) / body.steady(inlet)[0]
    largest = round(watts / 1000, 3)
    expansion = generator.uniform(5e-6, 8e-6)

    def depth(share: float) -> Array:
        row = np.zeros(CELLS)
        row[int(share * CELLS)] = 1.0
        return row

    slowest = capacity * thickness / (film.sum() / area)
    dt = float(np.clip(round(5 * slowest / 1600), 10, 60))
    return Plant(
        name="slab",
        body=body,
        drives=(
            Drive("Q_furnace_kW", largest, inlet, lambda u: 1e3 * largest * u, None, ramps, ramps),
        ),
        sensors={
            "T_hot_degC": depth(generator.uniform(0.1, 0.3)),
            "T_cold_degC": depth(generator.uniform(0.6, 0.95)),
        },
        deflections={"d_x_um": np.full(CELLS, 1e6 * expansion * cell)},
        noise={
            "T_hot_degC": Noise(0.03, 0.02, 0.01),
            "T_cold_degC": Noise(0.03, 0.02, 0.01),
            "d_x_um": Noise(generator.uniform(0.3, 1.0), 0.2, 0.01),
        },
        dt=dt,
        steps=1600,
        pump="x_burner_1",
        source=int(generator.integers(8, 25)),
        own=frozenset({"conductivity", "heat_capacity", "material"}),
    )
