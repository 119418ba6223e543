"""A granite block that carries an interferometer, in a laboratory whose air conditioning cycles.

A lamp warms its post within minutes, the stone within half a day; the path is read in nanometres.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import conditioned, jobs, staircase
from machines.foreign.solver import Body

ALONG, UP = 12, 5
LAMP, POST = ALONG * UP, ALONG * UP + 1


def bench(generator: Generator) -> Plant:
    """A block of 0.8 to 1.6 m on feet, a post of aluminium, steel or invar upon it."""
    length, width = generator.uniform(0.8, 1.6), generator.uniform(0.4, 0.7)
    height = generator.uniform(0.1, 0.2)
    conductivity, capacity = generator.uniform(2.2, 3.4), generator.uniform(2.0e6, 2.4e6)
    stone, metal = generator.uniform(5e-6, 8e-6), float(generator.choice([1.5e-6, 12e-6, 23e-6]))
    dx, dz, n = length / ALONG, height / UP, ALONG * UP + 2
    number = np.arange(ALONG * UP).reshape(ALONG, UP)
    exchange = np.zeros((n, n))

    def join(a: np.ndarray, b: np.ndarray, g: float) -> None:
        for i, j in zip(np.ravel(a), np.ravel(b), strict=True):
            exchange[np.ix_([i, j], [i, j])] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])

    join(number[:-1], number[1:], conductivity * width * dz / dx)
    join(number[:, :-1], number[:, 1:], conductivity * width * dx / dz)
    place = int(generator.integers(2, ALONG - 4))  # of the post
    foot = number[place, -1]
    join(np.array([POST]), np.array([foot]), generator.uniform(0.8, 2.5))
    join(np.array([LAMP]), np.array([POST]), generator.uniform(0.3, 0.8))
    area = np.zeros(n)
    area[number[:, [0, -1]]] = width * dx
    area[number[[0, -1]]] += width * dz
    area[[LAMP, POST]] = 0.02, 0.03
    film = generator.uniform(5.0, 9.0) * area
    film[number[:, 0]] *= generator.uniform(0.3, 0.6)  # below it stands in its frame
    capacities = np.full(n, capacity * width * dx * dz)
    capacities[[LAMP, POST]] = generator.uniform(80.0, 250.0), generator.uniform(300.0, 900.0)
    body = Body(capacities, exchange, film, area)
    # Part of the light falls on the stone.
    inlet = np.zeros(n)
    inlet[LAMP], lit = generator.uniform(0.4, 0.7), number[place : place + 4, -1]
    inlet[lit] = (1.0 - inlet[LAMP]) / 4
    watts = round(generator.uniform(15.0, 30.0) / body.steady(inlet)[LAMP], 1)
    # Path between two mirrors on the stone, which also tilts them; its post pushes one of them.
    z = (np.arange(UP) - (UP - 1) / 2) * dz
    beam = height / 2 + generator.uniform(0.05, 0.12)
    path = np.zeros(n)
    path[number[1:-1]] = 1e9 * stone * dx * (1 / UP + 12 * z * dz * beam / height**3)
    path[POST] = -1e9 * metal * generator.uniform(0.03, 0.1)
    return Plant(
        name="bench",
        body=body,
        drives=(
            Drive("P_lamp_mW", 1e3 * watts, inlet, lambda u: watts * u, None, staircase, jobs),
        ),
        sensors={"T_post_degC": np.eye(n)[POST], "T_stone_degC": np.eye(n)[lit[-1]]},
        deflections={"d_path_nm": path},
        noise={
            "T_post_degC": Noise(0.004, 0.002, 0.001),
            "T_stone_degC": Noise(0.002, 0.002, 0.001),
            "T_room_degC": Noise(0.01, 0.004, 0.001),
            "d_path_nm": Noise(generator.uniform(5.0, 15.0), 5.0, 1.0),
        },
        dt=float(np.clip(round(5 * body.slowest / 2400), 30, 120)),
        steps=2400,
        pump="x_vacuum_1",
        source=int(number[generator.integers(ALONG), generator.integers(UP - 1)]),
        room=generator.uniform(0.2, 0.7),
        weather=conditioned,
        days=generator.uniform(0.1, 0.5),
    )
