"""A plate in two dimensions, heated on a part of its face: it bends by what its two faces differ.

Its logger has a clock of its own: rows jitter, some are lost, and commands change between them.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import binary
from machines.foreign.solver import Body

ALONG, THROUGH = 14, 5


def plate(generator: Generator) -> Plant:
    """A plate of cast iron or stone, 0.4 to 0.7 m long, clamped at one end."""
    conductivity, capacity, expansion = [(50.0, 3.6e6, 11e-6), (3.0, 2.2e6, 7e-6)][
        int(generator.random() < 0.4)
    ]
    length, width = generator.uniform(0.4, 0.7), 0.3
    thickness = (
        generator.uniform(0.05, 0.09) if conductivity > 10 else generator.uniform(0.03, 0.05)
    )
    dx, dz = length / ALONG, thickness / THROUGH
    n = ALONG * THROUGH
    number = np.arange(n).reshape(ALONG, THROUGH)
    exchange = np.zeros((n, n))

    def join(a: np.ndarray, b: np.ndarray, g: float) -> None:
        for i, j in zip(a.ravel(), b.ravel(), strict=True):
            exchange[np.ix_([i, j], [i, j])] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])

    join(number[:-1], number[1:], conductivity * width * dz / dx)
    join(number[:, :-1], number[:, 1:], conductivity * width * dx / dz)
    area = np.zeros(n)
    area[number[:, 0]] += width * dx
    area[number[:, -1]] += width * dx
    area[number[-1]] += width * dz
    film = generator.uniform(8.0, 20.0) * area
    film[number[:, 0]] *= generator.uniform(0.3, 0.8)  # its lower face is sheltered
    film[number[0]] += generator.uniform(5.0, 20.0) * width * dz * 10  # the clamp
    body = Body(np.full(n, capacity * width * dx * dz), exchange, film, area)
    inlet = np.zeros((ALONG, THROUGH))
    begin = int(generator.integers(2, 8))
    inlet[begin : begin + 4, -1] = 0.25
    largest = round(generator.uniform(15.0, 30.0) / body.steady(inlet.ravel()).max(), 1)
    # Curvature of a cell from its temperatures, and the end's deflection from all curvatures.
    z = (np.arange(THROUGH) - (THROUGH - 1) / 2) * dz
    lever = length - (np.arange(ALONG) + 0.5) * dx
    moment = 12 * expansion / thickness**3 * z * dz
    bend = 1e6 * np.outer(lever * dx, moment)

    def at(share: float, layer: int) -> np.ndarray:
        row = np.zeros((ALONG, THROUGH))
        row[int(share * ALONG), layer] = 1.0
        return row.ravel()

    share = generator.uniform(0.3, 0.8)
    slowest = capacity * thickness / film.sum() * length * width
    dt = float(np.clip(round(5 * slowest / 6400, 1), 0.5, 5.0))
    return Plant(
        name="plate",
        body=body,
        drives=(
            Drive("Q_mat_W", largest, inlet.ravel(), lambda u: largest * u, None, binary, binary),
        ),
        sensors={"T_top_degC": at(share, -1), "T_bottom_degC": at(share, 0)},
        deflections={"d_z_um": bend.ravel()},
        noise={
            "T_top_degC": Noise(generator.uniform(0.003, 0.01), 0.003),
            "T_bottom_degC": Noise(generator.uniform(0.003, 0.01), 0.003),
            "d_z_um": Noise(generator.uniform(0.3, 0.8), 0.2, 0.01),
        },
        dt=dt,
        steps=6400,
        pump="Q_lamp_1",
        source=int(number[int(generator.integers(3, ALONG - 2)), -1]),
        jitter=generator.uniform(0.1, 0.35),
        dropped=generator.uniform(0.03, 0.12),
        # A command acts up to a row before it is logged.
        own=frozenset({"transport_delay"}),
    )
