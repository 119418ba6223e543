"""A ball screw between two bearings: its nut warms the stretch that it travels, in a shop.

The control logs the feed in millimetres a minute, under names of its own.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import duty, staircase
from machines.foreign.solver import Array, Body

CELLS = 80
FRONT, REAR, NUT, BED = range(CELLS, CELLS + 4)
_STEEL, _HEAT, _GROWTH = 45.0, 3.7e6, 11.7e-6  # conductivity, heat capacity, expansion


def screw(generator: Generator) -> Plant:
    """A screw of 0.7 to 1.6 m and 25 to 50 mm, held by its front bearing."""
    length, diameter = generator.uniform(0.7, 1.6), generator.uniform(0.025, 0.05)
    cell, section, n = length / CELLS, np.pi * diameter**2 / 4, CELLS + 4
    near = int(CELLS * generator.uniform(0.2, 0.4))
    far = int(CELLS * generator.uniform(0.6, 0.9))
    travelled = np.arange(near, far)
    exchange = np.zeros((n, n))

    def join(a: int, b: int, g: float) -> None:
        exchange[np.ix_([a, b], [a, b])] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])

    for k in range(CELLS - 1):
        join(k, k + 1, _STEEL * section / cell)
    balls = generator.uniform(5.0, 15.0)
    for k in range(near, far):
        join(NUT, k, balls / len(travelled))
    links = {(FRONT, 0): 6.0, (REAR, CELLS - 1): 4.0, (FRONT, BED): 5.0, (REAR, BED): 3.0}
    for (a, b), g in (links | {(NUT, BED): 2.0}).items():
        join(a, b, g * generator.uniform(0.6, 1.5))
    lumps = np.array([4000.0, 2500.0, 5000.0, 60000.0]) * generator.uniform(0.6, 1.5, 4)
    films = np.array([0.7, 0.5, 1.5, 22.0]) * generator.uniform(0.7, 1.4, 4)
    side = np.full(CELLS, np.pi * diameter * cell)
    film = np.concatenate([generator.uniform(12.0, 30.0) * side, films])
    area = np.concatenate([side, films / 12])
    body = Body(np.append(np.full(CELLS, _HEAT * section * cell), lumps), exchange, film, area)
    inlet, front = np.zeros(n), generator.uniform(0.2, 0.45)
    inlet[[FRONT, REAR]] = front, 0.1
    inlet[NUT] = inlet[travelled] = 0.5 * (0.9 - front)
    inlet[travelled] /= len(travelled)
    friction = generator.uniform(16.0, 32.0) / body.steady(inlet)[NUT]
    speed = float(generator.choice([1500, 2000, 3000]))
    lead = float(generator.choice([5, 10, 20]))  # [mm]

    def error(end: int) -> Array:
        """Of the table at a place: what the screw has grown up to there beyond the bed."""
        row = np.where(np.arange(n) < end, 1e6 * _GROWTH * cell, 0.0)
        row[BED] = -1e6 * _GROWTH * cell * end * generator.uniform(0.6, 1.0)
        return row

    thermometer = Noise(generator.uniform(0.02, 0.05), 0.02, float(generator.choice([0.01, 0.05])))
    micrometre = Noise(generator.uniform(0.2, 0.6), 0.15, 0.1)
    return Plant(
        name="screw",
        body=body,
        # The preload's torque does not go with the speed.
        drives=(Drive("n_screw_rpm", speed, inlet, lambda u: friction * u, None, staircase, duty),),
        sensors={"T_front_degC": np.eye(n)[FRONT], "T_nut_degC": np.eye(n)[NUT]},
        deflections={"d_near_um": error(near), "d_far_um": error(far)},
        noise={"T_front_degC": thermometer, "T_nut_degC": thermometer}
        | {"d_near_um": micrometre, "d_far_um": micrometre},
        dt=float(np.clip(round(5 * body.slowest / 2000), 5, 40)),
        steps=2000,
        pump="x_hydraulics_1",
        source=BED,
        room=generator.uniform(0.8, 2.5),
        days=generator.uniform(0.5, 2.0),
        warm=0.4,
        part=True,
        foreign={"n_screw_rpm": ("Feed X [mm/min]", 1 / lead, 0.0)}
        | {"x_hydraulics_1": ("Hydraulics", 1.0, 0.0), "x_fan_1": ("Fan", 1.0, 0.0)}
        | {"T_front_degC": ("Bearing X", 1.0, 0.0), "T_nut_degC": ("Nut X", 1.0, 0.0)}
        | {"d_near_um": ("Error at start [um]", 1.0, 0.0), "T_room_degC": ("Shop", 1.0, 0.0)}
        | {"d_far_um": ("Error at end [um]", 1.0, 0.0), "T_part_degC": ("Work", 1.0, 0.0)},
    )
