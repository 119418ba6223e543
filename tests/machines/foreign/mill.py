"""A milling machine in a shop that is colder or warmer every day: spindle, feed, room."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import duty, spectrum
from machines.foreign.solver import lumped

BEARING, QUILL, HEAD, COLUMN, BED, SCREW, NUT = range(7)
_LINKS = {
    (BEARING, QUILL): 8.0,
    (BEARING, HEAD): 10.0,
    (QUILL, HEAD): 4.0,
    (HEAD, COLUMN): 9.0,
    (COLUMN, BED): 12.0,
    (SCREW, NUT): 5.0,
    (NUT, COLUMN): 4.0,
    (SCREW, BED): 2.0,
}
_CAPACITIES = (900.0, 4000.0, 20000.0, 45000.0, 70000.0, 3500.0, 1200.0)
_FILMS = (0.5, 1.5, 8.0, 14.0, 18.0, 1.5, 0.5)


def mill(generator: Generator) -> Plant:
    """A mill whose links, capacities and films are up to a third off the middling ones."""
    body = lumped(generator, _LINKS, _CAPACITIES, _FILMS)
    turns, slides = np.zeros(7), np.zeros(7)
    turns[[BEARING, QUILL]] = 0.8, 0.2
    slides[[SCREW, NUT]] = 0.4, 0.6
    bearing = generator.uniform(15.0, 30.0) / body.steady(turns)[BEARING]
    nut = generator.uniform(8.0, 15.0) / body.steady(slides)[NUT]
    speed = float(generator.choice([4000, 8000, 12000]))
    sensors = {
        "T_bearing_degC": np.eye(7)[BEARING],
        "T_column_degC": np.eye(7)[COLUMN],
        "T_nut_degC": np.eye(7)[NUT],
    }
    along = np.array([0.1, 1.4, 1.5, -2.2, 0.5, 0.0, 0.0]) * generator.uniform(0.7, 1.3, 7)
    across = np.array([0.0, 0.0, 0.3, 0.6, -0.8, 2.5, 0.3]) * generator.uniform(0.7, 1.3, 7)
    return Plant(
        name="mill",
        body=body,
        drives=(
            Drive("v_feed_1", 1.0, slides, lambda u: nut * u, None, duty, duty),
            Drive("n_spindle_rpm", speed, turns, lambda u: bearing * u, None, spectrum, spectrum),
        ),
        sensors=sensors,
        deflections={"d_z_um": along, "d_x_um": across},
        noise={
            **{name: Noise(generator.uniform(0.01, 0.04), 0.01, 0.01) for name in sensors},
            "d_z_um": Noise(generator.uniform(0.3, 0.8), 0.2, 0.1),
            "d_x_um": Noise(generator.uniform(0.3, 0.8), 0.2, 0.1),
        },
        dt=30.0,
        steps=1500,
        pump="x_conveyor_1",
        source=BED,
        room=generator.uniform(0.8, 2.0),
        days=generator.uniform(0.8, 2.5),
        warm=0.4,
        part=True,
    )
