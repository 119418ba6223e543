"""A heated chain of three lumps, one of which has a fan: logged, or switched by a thermostat.

Motor, housing and bed lose heat to the room each by themselves; the fan multiplies what one of them
loses. Every seed draws another machine. Integrated by Euler steps far below its time constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLACES = ("motor", "housing", "bed")
STEPS = 10  # of integration in a row
NOISE = {"T": 0.02, "d": 0.1}  # of a reading [K], [um]


@dataclass(frozen=True)
class CooledChain:
    """One machine.

    Attributes
    ----------
    capacity : (3,) ndarray [J/K]
    conductance : (2,) ndarray [W/K]
        From each lump to the next.
    film : (3,) ndarray [W/K]
        From each lump to the room.
    expansion : (3,) ndarray [um/K]
    power : float [W]
        Largest heat of the motor.
    """

    capacity: Array
    conductance: Array
    film: Array
    expansion: Array
    power: float

    @staticmethod
    def drawn(seed: int) -> CooledChain:
        """The machine of a seed.

        Parameters
        ----------
        seed : int
        """
        rng = np.random.default_rng(seed)
        return CooledChain(
            np.array([1500.0, 5000.0, 15000.0]) * rng.uniform(0.7, 1.6, 3),
            np.array([6.0, 9.0]) * rng.uniform(0.5, 2.0, 2),
            np.array([1.5, 3.0, 6.0]) * rng.uniform(0.6, 1.6, 3),
            np.array([0.4, 0.9, -0.5]) * rng.uniform(0.5, 1.5, 3),
            200.0 * rng.uniform(0.6, 1.3),
        )

    def log(
        self,
        seed: int,
        rows: int = 1440,
        period: float = 10.0,
        place: int = 0,
        factor: float = 1.0,
        thermostat: tuple[float, float] | None = None,
        jitter: float = 0.0,
        heated_bed: bool = False,
    ) -> dict[str, Array]:
        """Columns of a log: steps of the heat, a room that swings, readings with noise.

        Parameters
        ----------
        seed : int
        rows, period : int, float [s]
        place : int
            Lump of the fan.
        factor : float
            What its film is multiplied by while the fan is on.
        thermostat : (float, float), optional [degC]
            On above the first, off below the second; without one the fan has spells of its own.
        jitter : float [s]
            By which rows come earlier or later, at most; without it the clock is even.
        heated_bed : bool
            A heater in the bed is switched, too, and logged; so is how the bed itself bends.
        """
        rng = np.random.default_rng(seed)
        heat = self.power * _spells(rng, rows, 40, 240, (0.0, 0.3, 0.6, 1.0))
        heat[:30] = 0.0
        spells = _spells(rng, rows, 120, 360, (0.0, 1.0))
        time: Array = period * np.arange(rows, dtype=float)
        warmth = np.zeros(rows)
        if jitter or heated_bed:
            own = np.random.default_rng([seed, 1])
            time[1:] += own.uniform(-jitter, jitter, rows - 1)
            warmth += heated_bed * self.power * _spells(own, rows, 60, 300, (0.0, 0.5, 1.0))
        steps = np.append(np.diff(time), period) / STEPS
        room = 20 + 0.8 * np.sin(2 * np.pi * (time / 9000 + rng.uniform()))
        T, on, readings, fan = np.full(3, room[0]), 0.0, np.empty((rows, 3)), np.zeros(rows)
        for k in range(rows):
            readings[k] = T
            dt = steps[k] if jitter else period / STEPS
            for _ in range(STEPS):
                if thermostat is None:
                    on = spells[k] if factor != 1.0 else 0.0
                elif T[place] > thermostat[0]:
                    on = 1.0
                elif T[place] < thermostat[1]:
                    on = 0.0
                film = self.film.copy()
                film[place] *= 1 + (factor - 1) * on
                flow = self.conductance * (T[1:] - T[:-1])
                gained = np.append(flow, 0.0) - np.append(0.0, flow) - film * (T - room[k])
                gained[0] += heat[k]
                gained[2] += warmth[k]
                T = T + dt * gained / self.capacity
            fan[k] = on
        columns: dict[str, Array] = {"time_s": time, "P_motor_W": heat}
        columns["T_room_degC"] = room + NOISE["T"] * rng.normal(size=rows)
        if thermostat is None:
            columns["x_fan_1"] = fan
        for name, values in zip(PLACES, readings.T, strict=True):
            columns[f"T_{name}_degC"] = values + NOISE["T"] * rng.normal(size=rows)
        noise = NOISE["d"] * rng.normal(size=rows)
        columns["d_tool_um"] = np.asarray((readings - 20.0) @ self.expansion + noise)
        if heated_bed:
            columns["P_bed_W"] = warmth
            bent = 2.0 * (readings[:, 2] - readings[:, 1])
            columns["d_bed_um"] = bent + NOISE["d"] * rng.normal(size=rows)
        return columns


def _spells(
    rng: np.random.Generator, rows: int, shortest: int, longest: int, levels: tuple[float, ...]
) -> Array:
    """Levels held for random numbers of rows, each another than the one before."""
    values, row, level = np.empty(rows), 0, levels[0]
    while row < rows:
        level = rng.choice([each for each in levels if each != level])
        length = int(rng.integers(shortest, longest))
        values[row : row + length] = level
        row += length
    return values
