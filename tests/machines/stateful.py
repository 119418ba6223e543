"""Machines whose losses and gains go by a state, in numpy alone; nothing of them is a fitted form.

Each takes a generator and a number of rows and gives its period [s], the columns of a log, and the
output without noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Plant = tuple[float, dict[str, Array], Array]


def levels(generator: np.random.Generator, rows: int, low: float, high: float, short: int,
           long: int) -> Array:  # fmt: skip
    """Levels that last for random times."""
    u, at = np.empty(rows), 0
    while at < rows:
        u[at:] = generator.uniform(low, high)
        at += int(generator.integers(short, long))
    return u


def integrated(rates: Callable[[Array, Array], Array], x: Array, u: Array, period: float,
               substeps: int) -> Array:  # fmt: skip
    """States at every row (rows, states) of x' = rates(x, u), u held, by Runge and Kutta."""
    found, h = np.empty((u.shape[1], len(x))), period / substeps
    for k in range(u.shape[1]):
        found[k] = x
        for _ in range(substeps):
            a = rates(x, u[:, k])
            b = rates(x + h / 2 * a, u[:, k])
            c = rates(x + h / 2 * b, u[:, k])
            d = rates(x + h * c, u[:, k])
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
    return found


def noisy(generator: np.random.Generator, clean: Array, share: float, colour: float) -> Array:
    """With AR(1) noise of this share of the deviation."""
    e, last = np.empty(len(clean)), 0.0
    white = generator.standard_normal(len(clean)) * np.sqrt(1 - colour**2)
    for k, w in enumerate(white):
        last = e[k] = colour * last + w
    return np.asarray(clean + share * clean.std() * e)


def cooled(generator: np.random.Generator, rows: int, still: float = 1 / 900,
           moved: float = 1 / 3000) -> Plant:  # fmt: skip
    """One body, heated; a fan of 0 to 10 carries heat away in proportion: it is bilinear."""
    heat, fan = levels(generator, rows, 0, 400, 15, 90), levels(generator, rows, 0, 10, 15, 90)
    heat[:15] = 0.0
    x = integrated(
        lambda x, u: np.array([u[0] / 4000 - (still + moved * u[1]) * x[0]]),
        np.zeros(1), np.vstack([heat, fan]), 20.0, 4,
    )[:, 0]  # fmt: skip
    y = 20.0 + noisy(generator, x, 0.02, 0.5)
    return 20.0, {"Q_a_W": heat, "u_fan_V": fan, "T_a_degC": y}, 20.0 + x


def turning(generator: np.random.Generator, rows: int, power: float = 1.5) -> Plant:
    """Friction that goes by a power of the speed warms two bodies, one quick and one slow."""
    speed = levels(generator, rows, 0, 6000, 15, 100)
    speed[:15] = 0.0
    heat = (speed / 6000) ** power
    x = integrated(
        lambda x, u: np.array([(30 * u[0] - x[0]) / 60, (10 * u[0] - x[1]) / 600]),
        np.zeros(2), heat[None], 5.0, 2,
    ).sum(axis=1)  # fmt: skip
    y = 20.0 + noisy(generator, x, 0.04, 0.5)
    return 5.0, {"n_main_rpm": speed, "T_a_degC": y}, 20.0 + x


def steam_heated(generator: np.random.Generator, rows: int) -> Plant:
    """A tube of 12 cells in steam, which the flow crosses faster or slower."""
    cells, flow = 12, levels(generator, rows, 0.15, 0.8, 5, 50)

    def rates(x: Array, u: Array) -> Array:
        tube, wall = x[:cells], x[cells:]
        film = u[0] ** 0.8
        entering = np.concatenate([[20.0], tube[:-1]])
        into = 0.4 * film * (wall - tube)
        into_wall = 0.15 * (0.4 * (110 - wall) + 0.6 * film * (tube - wall))
        return np.concatenate([u[0] * (entering - tube) + into, into_wall])

    still = integrated(rates, np.full(2 * cells, 60.0), np.full((1, 300), flow[0]), 1.0, 3)[-1]
    x = integrated(rates, still, flow[None], 1.0, 3)[:, cells - 1]
    return 1.0, {"x_flow_1": flow, "T_out_degC": noisy(generator, x, 0.05, 0.5)}, x
