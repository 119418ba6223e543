"""A servo motor with a water jacket: its copper warms with the current's square, the more the
warmer it is. Its drive's trace has a clock that jitters, and often begins on a warm motor.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import binary, staircase
from machines.foreign.solver import lumped

WINDING, STATOR, ROTOR, HOUSING, JACKET, FLANGE, MOUNT = range(7)
_LINKS = {
    (WINDING, STATOR): 9.0,
    (STATOR, HOUSING): 18.0,
    (STATOR, ROTOR): 1.5,
    (ROTOR, FLANGE): 1.2,
    (HOUSING, JACKET): 30.0,
    (HOUSING, FLANGE): 9.0,
    (FLANGE, MOUNT): 5.0,
}
_CAPACITIES = (900.0, 5000.0, 2800.0, 4500.0, 1500.0, 2200.0, 12000.0)
_FILMS = (0.05, 0.1, 0.2, 1.2, 28.0, 0.6, 5.0)  # of the jacket: to water as warm as the room
_COPPER = 0.0039  # [1/K]


def motor(generator: Generator) -> Plant:
    """A motor whose links, capacities and films are up to a third off the middling ones."""
    body = lumped(generator, _LINKS, _CAPACITIES, _FILMS)
    # Copper above all, some iron.
    inlet, iron = np.zeros(7), generator.uniform(0.05, 0.15)
    inlet[[WINDING, STATOR, ROTOR]] = 1.0 - 1.5 * iron, iron, 0.5 * iron
    loss = generator.uniform(35.0, 60.0) / body.steady(inlet)[WINDING]
    amperes = round(float(np.exp(generator.uniform(np.log(6.0), np.log(80.0)))), 1)
    growth = np.array([0.0, 0.1, 0.5, 0.5, 0.2, 1.6, -0.9]) * generator.uniform(0.6, 1.4, 7)
    return Plant(
        name="motor",
        body=body,
        drives=(
            Drive(
                "I_motor_A",
                amperes,
                inlet,
                lambda u: loss * u * np.abs(u),
                None,
                staircase,
                binary,
                (WINDING, _COPPER),
            ),
        ),
        sensors={"T_winding_degC": np.eye(7)[WINDING], "T_flange_degC": np.eye(7)[FLANGE]},
        deflections={"d_flange_um": growth},
        noise={
            "T_winding_degC": Noise(generator.uniform(0.05, 0.15), 0.05, 0.1),
            "T_flange_degC": Noise(generator.uniform(0.01, 0.03), 0.01, 0.02),
            "d_flange_um": Noise(generator.uniform(0.05, 0.15), 0.05, 0.02),
        },
        dt=float(np.clip(round(6 * body.slowest / 6000, 1), 1.0, 5.0)),
        steps=6000,
        pump="x_brake_1",
        source=FLANGE,
        jitter=generator.uniform(0.05, 0.25),
        dropped=generator.uniform(0.0, 0.05),
        warm=0.4,
        # A command acts up to a row before it is logged.
        own=frozenset({"drive_nonlinearity", "transport_delay"}),
    )
