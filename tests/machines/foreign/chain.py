"""A Hammerstein chain: a bent characteristic of the drive, then three stages, each into the next.

Nothing goes back from a stage to the one before it, so it is no network of heat. Its log counts in
kilowatts, minutes, degrees Fahrenheit and mils, under names of its own.
"""

from __future__ import annotations

import numpy as np
from machines.foreign.plant import Drive, Generator, Noise, Plant
from machines.foreign.schedules import duty, staircase
from machines.foreign.solver import Body

_KILOWATT = 1000.0
# To °C and to micrometres: value * scale + offset.
FAHRENHEIT, MIL = (5 / 9, -160 / 9), 25.4


def chain(generator: Generator) -> Plant:
    """Three time constants of 150 to 3000 s, and a characteristic bent by 2 to 10 %."""
    taus = np.sort(np.exp(generator.uniform(np.log(150.0), np.log(3000.0), 3)))
    generator.shuffle(taus)
    # Each stage follows the one before; the first alone loses heat to the air.
    exchange = np.array([[0.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    body = Body(taus, exchange, np.array([1.0, 0.0, 0.0]), np.array([0.08, 0.0, 0.0]))
    rise, bent = generator.uniform(15.0, 35.0), generator.uniform(0.02, 0.10)
    sign = generator.choice([-1.0, 1.0])
    power = round(generator.uniform(1.0, 6.0), 1) * _KILOWATT

    def law(u: np.ndarray) -> np.ndarray:
        return rise * (u + sign * bent * u * (1.0 - u))

    mix = generator.uniform(0.2, 0.5)
    gain = generator.uniform(1.5, 4.0)
    dt = float(np.clip(round(6 * taus.sum() / 1600), 5, 30))
    fine = {name: Noise(generator.uniform(0.008, 0.03), 0.005) for name in ("a", "b")}
    return Plant(
        name="chain",
        body=body,
        drives=(Drive("Q_motor_W", power, np.array([1.0, 0.0, 0.0]), law, None, staircase, duty),),
        sensors={
            "T_housing_degC": np.array([mix, 1.0 - mix, 0.0]),
            "T_column_degC": np.array([0.0, 0.0, 1.0]),
        },
        deflections={"d_z_um": gain * np.array([-0.2, 0.4, 0.8])},
        noise={
            "T_housing_degC": fine["a"],
            "T_column_degC": fine["b"],
            "d_z_um": Noise(generator.uniform(0.3, 0.8), 0.2, 0.0254),
        },
        dt=dt,
        steps=1600,
        pump="x_pump_1",
        source=2,
        part=True,
        own=frozenset({"drive_nonlinearity", "actuator_saturation"}),
        foreign={
            "time_s": ("Minutes", 60.0, 0.0),
            "Q_motor_W": ("Motor power [kW]", _KILOWATT, 0.0),
            "T_housing_degC": ("Housing [F]", *FAHRENHEIT),
            "T_column_degC": ("Column [F]", *FAHRENHEIT),
            "T_room_degC": ("Shop [F]", *FAHRENHEIT),
            "T_part_degC": ("Work [F]", *FAHRENHEIT),
            "d_z_um": ("Growth [mil]", MIL, 0.0),
            "x_pump_1": ("Pump", 1.0, 0.0),
            "x_fan_1": ("Fan", 1.0, 0.0),
        },
    )
