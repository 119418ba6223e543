"""A mirror of glass in a dome: warm by day, cold by night, never at rest when its log begins.

Its face follows the air, its back a pad; it bends by what the two differ, read in nanometres.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import jobs
from machines.foreign.solver import Array, Body

LAYERS = 16
CELL = LAYERS  # the steel behind the glass


def mirror(generator: Generator) -> Plant:
    """A blank of 60 to 110 mm before a cell of steel."""
    thickness, area = generator.uniform(0.06, 0.11), generator.uniform(0.2, 0.6)
    conductivity, capacity = generator.uniform(1.0, 1.6), generator.uniform(1.7e6, 2.1e6)
    layer = thickness / LAYERS
    n = LAYERS + 1
    exchange = np.zeros((n, n))
    between = [conductivity * area / layer] * (LAYERS - 1) + [generator.uniform(3.0, 8.0) * area]
    for k, g in enumerate(between):
        exchange[k : k + 2, k : k + 2] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])
    faces = np.zeros(n)
    faces[[0, CELL]] = area
    film = faces * np.array([generator.uniform(8.0, 16.0), *np.zeros(n - 2), 5.0])
    capacities = np.full(n, capacity * area * layer)
    capacities[CELL] = generator.uniform(2.0e4, 5.0e4) * area
    inlet = np.zeros(n)
    inlet[LAYERS - 1] = 1.0
    body = Body(capacities, exchange, film, faces)
    watts = round(generator.uniform(6.0, 12.0) / body.steady(inlet)[LAYERS - 1], 1)
    # Its figure: what the layers differ about their middle, and a little of the cell's warmth.
    lever = np.linspace(-1.0, 1.0, LAYERS)
    bend = generator.uniform(400.0, 900.0) * lever / np.sum(lever**2)

    def glass(share: float) -> Array:
        row = np.zeros(n)
        row[int(share * LAYERS)] = 1.0
        return row

    slowest = capacity * thickness / (film.sum() / area)
    return Plant(
        name="mirror",
        body=body,
        drives=(Drive("P_pad_W", watts, inlet, lambda u: watts * u, None, jobs, jobs),),
        sensors={
            "T_face_degC": glass(generator.uniform(0.0, 0.2)),
            "T_back_degC": glass(generator.uniform(0.7, 0.95)),
            "T_cell_degC": np.eye(n)[CELL],
        },
        deflections={"d_figure_nm": np.append(bend, generator.uniform(-8.0, 8.0))},
        noise={
            "T_face_degC": Noise(0.01, 0.003, 0.005),
            "T_back_degC": Noise(0.01, 0.003, 0.005),
            "T_cell_degC": Noise(0.02, 0.005, 0.01),
            "d_figure_nm": Noise(generator.uniform(4.0, 9.0), 2.0, 0.1),
        },
        dt=float(np.clip(round(6 * slowest / 1500), 20, 120)),
        steps=1500,
        pump="P_laser_1",
        source=int(generator.integers(2, LAYERS)),
        room=generator.uniform(1.5, 4.0),
        days=generator.uniform(1.0, 4.0),
    )
