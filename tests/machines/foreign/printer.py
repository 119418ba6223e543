"""A printer of ten lumped nodes in a room with day and night: bed on a thermostat, motors."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant, Thermostat
from machines.foreign.schedules import jobs
from machines.foreign.solver import lumped

BED, GLASS, LEFT, RIGHT, BEAM, CARRIAGE, NOZZLE, MOTOR_X, MOTOR_Z, CHAMBER = range(10)
# Pairs that exchange heat [W/K], capacities [J/K] and films [W/K] of a middling machine.
_LINKS = {
    (BED, GLASS): 12.0,
    (BED, LEFT): 0.35,
    (BED, RIGHT): 0.35,
    (GLASS, CHAMBER): 0.9,
    (BED, CHAMBER): 0.5,
    (LEFT, BEAM): 1.2,
    (RIGHT, BEAM): 1.0,
    (BEAM, CARRIAGE): 0.6,
    (CARRIAGE, NOZZLE): 0.5,
    (BEAM, MOTOR_X): 1.1,
    (LEFT, MOTOR_Z): 1.3,
    (LEFT, CHAMBER): 0.6,
    (RIGHT, CHAMBER): 0.6,
    (BEAM, CHAMBER): 0.5,
    (CARRIAGE, CHAMBER): 0.3,
}
_CAPACITIES = (900.0, 600.0, 2600.0, 2500.0, 1500.0, 350.0, 120.0, 450.0, 450.0, 400.0)
_FILMS = (0.3, 0.2, 0.7, 0.7, 0.5, 0.15, 0.1, 0.3, 0.3, 1.8)
_STEP = 1 / 16  # of the readings [K]


def printer(generator: Generator) -> Plant:
    """A printer whose links, capacities and films are up to a third off the middling ones."""
    body = lumped(generator, _LINKS, _CAPACITIES, _FILMS)
    bed, motors = np.zeros(10), np.zeros(10)
    bed[BED] = 1.0
    motors[[MOTOR_X, MOTOR_Z]] = 0.6, 0.4
    power, friction = round(generator.uniform(110, 160), 0), round(generator.uniform(14, 24), 1)

    def nodes(**weights: float) -> np.ndarray:
        row = np.zeros(10)
        for name, weight in weights.items():
            row[globals()[name]] = weight
        return row

    # The nozzle sinks as the frame grows, rises with beam and bed.
    left, right = generator.uniform(2.0, 3.5, 2)
    gap = nodes(
        LEFT=left, RIGHT=right, BEAM=-generator.uniform(0.6, 1.4), CARRIAGE=-0.5, GLASS=-0.25
    )
    coarse = Noise(0.02, 0.01, _STEP)
    return Plant(
        name="printer",
        body=body,
        drives=(
            Drive(
                "Q_bed_W",
                power,
                bed,
                lambda u: power * u,
                Thermostat(BED, 6.0, generator.uniform(35.0, 50.0)),
                jobs,
                jobs,
            ),
            Drive("Q_motors_W", friction, motors, lambda u: friction * u, None, jobs, jobs),
        ),
        sensors={"T_frame_degC": nodes(LEFT=0.8, MOTOR_Z=0.2), "T_gantry_degC": nodes(BEAM=1.0)},
        deflections={"d_z_um": gap},
        noise={
            "T_frame_degC": coarse,
            "T_gantry_degC": coarse,
            "T_room_degC": coarse,
            "d_z_um": Noise(generator.uniform(0.5, 1.0), 0.3, 0.1),
        },
        dt=60.0,
        steps=1500,
        pump="Q_hotend_1",
        source=NOZZLE,
        room=generator.uniform(1.5, 3.0),
    )
