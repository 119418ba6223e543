"""The hot chuck of a die bonder: a disc of rings with two heaters on a column, above 150 degrees.

It radiates. Its thermocouples tell tenths of a degree, its dial gauges ten-thousandths of an inch,
its logger hours.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import jobs, ramps, staircase
from machines.foreign.solver import Body

RINGS, LAYERS = 20, 8
BASE = RINGS + LAYERS
_INCH = 25.4
# Conductivity [W/(m K)], volumetric heat capacity [J/(m³ K)], expansion [1/K].
_MATERIALS = {"stainless": (16.0, 4.0e6, 16e-6), "tool steel": (28.0, 3.6e6, 11.5e-6)}


def bonder(generator: Generator) -> Plant:
    """A chuck of 60 to 95 mm radius on a column of 80 to 140 mm."""
    conductivity, capacity, expansion = _MATERIALS[str(generator.choice(list(_MATERIALS)))]
    radius, thick = generator.uniform(0.06, 0.095), generator.uniform(0.012, 0.02)
    tall, section = generator.uniform(0.08, 0.14), generator.uniform(0.8e-3, 2.0e-3)
    dr, dz, n = radius / RINGS, tall / LAYERS, BASE + 1
    edges = dr * np.arange(RINGS + 1)
    face = np.pi * np.diff(edges**2)
    exchange = np.zeros((n, n))

    def join(a: int, b: int, g: float) -> None:
        exchange[np.ix_([a, b], [a, b])] += g * np.array([[1.0, -1.0], [-1.0, 1.0]])

    for k in range(RINGS - 1):
        join(k, k + 1, conductivity * 2 * np.pi * edges[k + 1] * thick / dr)
    seat = int(generator.integers(5, 9))  # rings that stand on the column
    for k in range(seat):
        join(k, RINGS, 2 * conductivity * section / dz * face[k] / face[:seat].sum())
    for k in range(RINGS, BASE):
        join(k, k + 1, conductivity * section / dz)
    area = np.concatenate([1.3 * face, np.full(LAYERS, 2.5 * np.sqrt(section) * dz), [0.08]])
    area[RINGS - 1] += 2 * np.pi * radius * thick
    film = generator.uniform(9.0, 16.0) * area
    film[BASE] = generator.uniform(1.5, 4.0)
    capacities = np.append(capacity * face * thick, np.full(LAYERS, capacity * section * dz))
    body = Body(np.append(capacities, generator.uniform(3e3, 8e3)), exchange, film, area)
    inner, outer = np.zeros(n), np.zeros(n)
    inner[2:8] = face[2:8] / face[2:8].sum()
    outer[13:18] = face[13:18] / face[13:18].sum()
    watts = np.array([generator.uniform(75.0, 120.0), generator.uniform(85.0, 130.0)])
    watts /= body.steady(inner)[0], body.steady(outer)[15]
    height, rim = np.zeros(n), np.zeros(n)
    height[RINGS:BASE] = 1e3 * expansion * dz
    height[0], height[BASE] = 1e3 * expansion * thick, 1e3 * generator.uniform(0.2e-6, 0.8e-6)
    rim[:RINGS] = 1e3 * expansion * radius * face / face.sum()
    rim[BASE] = -generator.uniform(0.5, 1.0) * 1e3 * 11e-6 * radius  # the gauge's arm
    couple = Noise(generator.uniform(0.05, 0.12), 0.05, 0.1)
    dial = Noise(generator.uniform(0.4e-3, 1.0e-3), 0.4e-3, 1e-4 * _INCH)
    return Plant(
        name="bonder",
        body=body,
        drives=(
            Drive("Q_inner_pct", 100.0, inner, lambda u: watts[0] * u, None, staircase, jobs),
            Drive("Q_outer_pct", 100.0, outer, lambda u: watts[1] * u, None, staircase, ramps),
        ),
        sensors={"T_centre_degC": np.eye(n)[1], "T_edge_degC": np.eye(n)[RINGS - 2]},
        deflections={"d_height_mm": height, "d_rim_mm": rim},
        noise={"T_centre_degC": couple, "T_edge_degC": couple, "T_room_degC": couple}
        | {"d_height_mm": dial, "d_rim_mm": dial},
        dt=float(np.clip(round(5 * body.slowest / 3000), 2, 10)),
        steps=3000,
        pump="x_vacuum_1",
        source=int(generator.integers(RINGS, BASE)),
        emissivity=generator.uniform(0.1, 0.3),
        own=frozenset({"radiation"}),
        foreign={"time_s": ("Elapsed [h]", 3600.0, 0.0)}
        | {"Q_inner_pct": ("Zone 1 [%]", 1.0, 0.0), "Q_outer_pct": ("Zone 2 [%]", 1.0, 0.0)}
        | {"T_centre_degC": ("TC1", 1.0, 0.0), "T_edge_degC": ("TC2", 1.0, 0.0)}
        | {"T_room_degC": ("Ambient", 1.0, 0.0), "x_fan_1": ("Fume fan", 1.0, 0.0)}
        | {"x_vacuum_1": ("Vacuum", 1.0, 0.0)}
        | {"d_height_mm": ("Dial Z [in]", _INCH, 0.0), "d_rim_mm": ("Dial R [in]", _INCH, 0.0)},
    )
