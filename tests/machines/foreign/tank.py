"""A stirred tank on load cells: its heater is set by a voltage, its logger's clock jitters."""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import duty, staircase
from machines.foreign.solver import lumped

ELEMENT, FLUID, SHELL, INSULATION, FRAME = range(5)
_LINKS = {
    (ELEMENT, FLUID): 40.0,
    (FLUID, SHELL): 60.0,
    (SHELL, INSULATION): 9.0,
    (SHELL, FRAME): 2.5,
}
_CAPACITIES = (400.0, 60000.0, 9000.0, 2500.0, 14000.0)
_FILMS = (0.02, 0.6, 0.4, 12.0, 4.0)


def tank(generator: Generator) -> Plant:
    """A tank whose links, capacities and films are up to a third off the middling ones."""
    body = lumped(generator, _LINKS, _CAPACITIES, _FILMS)
    inlet = np.eye(5)[ELEMENT]
    heat = generator.uniform(18.0, 40.0) / body.steady(inlet)[FLUID]
    volts = float(generator.choice([48.0, 110.0, 230.0]))
    growth = 1e-3 * np.array([0.0, 0.0, 9.0, 0.5, 4.0]) * generator.uniform(0.7, 1.3, 5)
    return Plant(
        name="tank",
        body=body,
        drives=(
            Drive(
                "U_heater_V", volts, inlet, lambda u: heat * u * np.abs(u), None, staircase, duty
            ),
        ),
        sensors={"T_fluid_degC": np.eye(5)[FLUID], "T_shell_degC": np.eye(5)[SHELL]},
        deflections={"d_top_mm": growth},
        noise={
            "T_fluid_degC": Noise(0.03, 0.01, 0.01),
            "T_shell_degC": Noise(0.02, 0.01, 0.01),
            "d_top_mm": Noise(generator.uniform(0.5e-3, 1.5e-3), 0.2e-3, 0.1e-3),
        },
        dt=10.0,
        steps=5600,
        pump="x_agitator_1",
        source=SHELL,
        jitter=generator.uniform(0.1, 0.3),
        dropped=0.03,
        warm=0.3,
        # A command acts up to a row before it is logged.
        own=frozenset({"drive_nonlinearity", "transport_delay"}),
    )
