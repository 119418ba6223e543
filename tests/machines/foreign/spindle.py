"""A spindle whose friction goes with a power of its speed, often still warm when a log begins."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import spectrum
from machines.foreign.solver import lumped

FRONT, REAR, SHAFT, HOUSING, HEAD, COLUMN = range(6)
_LINKS = {
    (FRONT, SHAFT): 6.0,
    (REAR, SHAFT): 5.0,
    (FRONT, HOUSING): 14.0,
    (REAR, HOUSING): 9.0,
    (HOUSING, HEAD): 12.0,
    (HEAD, COLUMN): 7.0,
}
_CAPACITIES = (700.0, 600.0, 3500.0, 9000.0, 24000.0, 60000.0)
_FILMS = (0.5, 0.5, 1.5, 4.0, 7.0, 16.0)


def spindle(generator: Generator) -> Plant:
    """A spindle whose links, capacities and films are up to a third off the middling ones."""
    body = lumped(generator, _LINKS, _CAPACITIES, _FILMS)
    inlet = np.zeros(6)
    inlet[[FRONT, REAR, SHAFT]] = 0.55, 0.35, 0.1
    heat = generator.uniform(20.0, 35.0) / body.steady(inlet)[FRONT]
    exponent = generator.uniform(1.0, 1.15)
    speed = float(generator.choice([6000, 8000, 12000]))
    sensors = {"T_bearing_degC": np.eye(6)[FRONT], "T_head_degC": np.eye(6)[HEAD]}
    growth = np.array([0.3, 0.1, 1.6, 1.1, 2.0, -1.2]) * generator.uniform(0.7, 1.3, 6)
    return Plant(
        name="spindle",
        body=body,
        drives=(
            Drive(
                "n_spindle_rpm",
                speed,
                inlet,
                lambda u: heat * np.sign(u) * np.abs(u) ** exponent,
                None,
                spectrum,
                spectrum,
            ),
        ),
        sensors=sensors,
        deflections={"d_z_um": growth},
        noise={
            **{name: Noise(generator.uniform(0.01, 0.03), 0.01, 0.01) for name in sensors},
            "d_z_um": Noise(generator.uniform(0.4, 1.0), 0.2, 0.1),
        },
        dt=20.0,
        steps=1600,
        pump="x_chiller_1",
        source=HEAD,
        warm=0.5,
        part=True,
        own=frozenset({"drive_nonlinearity"}),
    )
