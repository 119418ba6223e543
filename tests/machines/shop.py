"""A head on a base in a shop: two lumps by explicit Euler steps, a room that goes its own way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HEAT, ROOM, HEAD, BASE = "P_motor_W", "T_room_degC", "T_head_degC", "T_base_degC"
STEP, ROWS, SUBSTEPS = 60.0, 720, 20


def shop_columns(
    seed: int, room: float, floor: float = 0.0, warmer: float = 0.0, noise: float = 0.02
) -> dict[str, Array]:
    """One log.

    Parameters
    ----------
    seed : int
        Of the heat's levels and of the noise.
    room : float [K]
        By how much the room is warmer at the end.
    floor : float [W/K]
        From the base to a floor that stays at 20 °C.
    warmer : float [K]
        How much warmer than the room the machine is at first.
    noise : float [K]
        Of a reading.
    """
    rng = np.random.default_rng(seed)
    heat = np.repeat(rng.choice([0.0, 40.0, 80.0, 120.0], ROWS // 30), 30)
    heat[:10] = 0.0
    time = STEP * np.arange(ROWS)
    air = 20.0 + room * (time / time[-1] + 0.3 * np.sin(time / 5000.0))
    head = base = 20.0 + warmer
    measured = np.empty((2, ROWS))
    for k in range(ROWS):
        measured[:, k] = head, base
        for _ in range(SUBSTEPS):
            across = 5.0 * (head - base)
            lost = 5.0 * (base - air[k]) + floor * (base - 20.0)
            head += STEP / SUBSTEPS * (heat[k] - across - 1.5 * (head - air[k])) / 2500.0
            base += STEP / SUBSTEPS * (across - lost) / 15000.0
    measured += noise * rng.standard_normal(measured.shape)
    return {"time_s": time, HEAT: heat, ROOM: air, HEAD: measured[0], BASE: measured[1]}
