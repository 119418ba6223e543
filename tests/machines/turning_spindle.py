"""A spindle that turns: motor and bearings heat it, and turning or a fan cools a part of it.

Motor, bearing, housing and column are lumps in a chain; each loses heat to the room by itself. The
speed makes the motor's loss and the bearing's friction, and what the bearing loses to the air rises
with the speed (as of a disc that turns); or the motor has a fan that stops with the spindle; or a
pump heats the housing whether the spindle turns or not. Every seed draws another machine.
Integrated by Euler steps far below its time constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLACES = ("motor", "bearing", "housing", "column")
FASTEST = 6000.0  # of the speed [1/min]
PERIOD, STEPS = 60.0, 30  # of a row [s], of integration in a row
PUMP = 60.0  # [W]
NOISE = {"T": 0.03, "d": 0.15}  # of a reading [K], [um]


@dataclass(frozen=True)
class TurningSpindle:
    """One machine.

    Attributes
    ----------
    capacity : (4,) ndarray [J/K]
    conductance : (3,) ndarray [W/K]
        From each lump to the next.
    film : (4,) ndarray [W/K]
        From each lump to the room, at rest.
    expansion : (4,) ndarray [um/K]
    motor, friction : float [W]
        Heat of motor and bearing at the highest speed.
    blown : float
        By how much of itself the film of a place rises at the highest speed, or under a fan.
    """

    capacity: Array
    conductance: Array
    film: Array
    expansion: Array
    motor: float
    friction: float
    blown: float

    @staticmethod
    def drawn(seed: int) -> TurningSpindle:
        """The machine of a seed.

        Parameters
        ----------
        seed : int
        """
        rng = np.random.default_rng(seed)
        return TurningSpindle(
            np.array([4000.0, 1500.0, 9000.0, 30000.0]) * rng.uniform(0.7, 1.5, 4),
            np.array([5.0, 4.0, 8.0]) * rng.uniform(0.6, 1.6, 3),
            np.array([2.5, 2.0, 3.0, 9.0]) * rng.uniform(0.7, 1.4, 4),
            np.array([0.5, 0.8, 1.6, -0.6]) * rng.uniform(0.6, 1.4, 4),
            250.0 * rng.uniform(0.7, 1.3),
            120.0 * rng.uniform(0.7, 1.3),
            rng.uniform(1.5, 3.0),
        )

    def log(
        self,
        seed: int,
        speeds: Array,
        cooled: str | None = None,
        pump: Array | None = None,
        swing: float = 0.05,
    ) -> dict[str, Array]:
        """Columns of a log of a row a minute that begins at rest.

        Parameters
        ----------
        seed : int
            Of the noise, and of the room.
        speeds : (n,) ndarray [1/min]
        cooled : {"speed", "fan"}, optional
            The bearing's film rises with the speed; or the motor's while the spindle turns. None:
            every film is constant.
        pump : (n,) ndarray, optional
            Whether a pump heats the housing by `PUMP`.
        swing : float [K]
            Of the room.
        """
        rng = np.random.default_rng(seed)
        share = speeds / FASTEST
        time: Array = PERIOD * np.arange(len(speeds), dtype=float)
        room = 21 + swing * np.sin(2 * np.pi * (time / 20000 + rng.uniform()))
        T, readings = np.full(4, room[0]), np.empty((len(time), 4))
        for k in range(len(time)):
            readings[k] = T
            film = self.film.copy()
            if cooled == "speed":
                film[1] *= 1 + self.blown * share[k]
            elif cooled == "fan":
                film[0] *= 1 + self.blown * (share[k] > 0)
            for _ in range(STEPS):
                flow = self.conductance * (T[1:] - T[:-1])
                gained = np.append(flow, 0.0) - np.append(0.0, flow) - film * (T - room[k])
                gained[0] += self.motor * share[k]
                gained[1] += self.friction * share[k]
                gained[2] += 0.0 if pump is None else PUMP * pump[k]
                T = T + PERIOD / STEPS * gained / self.capacity
        columns: dict[str, Array] = {"time_s": time, "n_spindle_rpm": speeds}
        columns["T_room_degC"] = room + NOISE["T"] * rng.normal(size=len(time))
        if pump is not None:
            columns["x_pump_1"] = pump
        for name, values in zip(PLACES, readings.T, strict=True):
            columns[f"T_{name}_degC"] = values + NOISE["T"] * rng.normal(size=len(time))
        noise = NOISE["d"] * rng.normal(size=len(time))
        columns["d_z_um"] = np.asarray((readings - 21.0) @ self.expansion + noise)
        return columns


def warm_up(hours: float) -> Array:
    """Speeds [1/min]: ten minutes at rest, then one speed."""
    speeds = np.full(int(hours * 3600 / PERIOD), 0.7 * FASTEST)
    speeds[:10] = 0.0
    return speeds


def warm_and_cool(rng: np.random.Generator, hours: float) -> Array:
    """Speeds [1/min]: two spells of the speed of `warm_up`, and what is left at rest."""
    speeds = np.zeros(int(hours * 3600 / PERIOD))
    stop = 10 + int(rng.integers(90, 180))
    again = stop + int(rng.integers(60, 130))
    speeds[10:stop] = speeds[again : again + int(rng.integers(60, 120))] = 0.7 * FASTEST
    return speeds


def spells(rng: np.random.Generator, rows: int) -> Array:
    """A pump that is on and off in turn, 30 to 90 minutes each."""
    state, on = np.zeros(rows), 0
    row = 0
    while row < rows:
        length = int(rng.integers(30, 90))
        state[row : row + length] = on
        row, on = row + length, 1 - on
    return state
