"""Processes with several inputs and outputs, in numpy alone: what is simulated, not a fitted form.

Each takes a generator and gives a `Run`. Nothing here is shared with the models that judge it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rates = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Run:
    """A record of a process.

    Attributes
    ----------
    period : float [s]
    u : ndarray, shape (m, n)
        Held over each sample.
    clean, y : ndarray, shape (p, n)
        Outputs without and with noise.
    direct : bool
        Whether an output follows an input at once.
    heat : bool
        Whether the channels are heats and temperatures; else voltages and displacements.
    """

    period: float
    u: Array
    clean: Array
    y: Array
    direct: bool = False
    heat: bool = True


def _steps(rng: np.random.Generator, inputs: int, rows: int, shortest: int, longest: int) -> Array:
    """Levels that last for random times; the first one is zero."""
    found = np.zeros((inputs, rows))
    for row in found:
        at = shortest
        while at < rows:
            row[at:] = rng.uniform(-1, 1)
            at += int(rng.integers(shortest, longest))
    return found


def _integrated(rates: Rates, state: Array, u: Array, period: float, substeps: int) -> Array:
    """States at every row (n, states) by Runge and Kutta's rule of fourth order."""
    h, found = period / substeps, np.empty((u.shape[1], len(state)))
    for k in range(u.shape[1]):
        found[k] = state
        for _ in range(substeps):
            a = rates(state, u[:, k])
            b = rates(state + h / 2 * a, u[:, k])
            c = rates(state + h / 2 * b, u[:, k])
            d = rates(state + h * c, u[:, k])
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return found


def _linear(A: Array, B: Array, u: Array, period: float) -> Array:
    """States at every row (n, states) of x' = A x + B u from rest, u held."""
    values, vectors = np.linalg.eig(A)
    inverse = np.linalg.inv(vectors)
    grown = np.exp(values * period)
    F = (vectors * grown) @ inverse
    G = (vectors * ((grown - 1) / values)) @ inverse @ B
    x, found = np.zeros(len(A)), np.empty((u.shape[1], len(A)))
    for k in range(u.shape[1]):
        found[k] = x
        x = F.real @ x + G.real @ u[:, k]
    return found


def _noisy(rng: np.random.Generator, clean: Array, share: float, colour: float = 0.0) -> Array:
    """AR(1) noise of this share of each output's deviation."""
    white = rng.standard_normal((len(clean), clean.shape[1] + 200)) * np.sqrt(1 - colour**2)
    e = np.zeros_like(white)
    for k in range(1, white.shape[1]):
        e[:, k] = colour * e[:, k - 1] + white[:, k]
    return np.asarray(clean + share * clean.std(axis=1, keepdims=True) * e[:, 200:])


def evaporator(rng: np.random.Generator) -> Run:
    """Three effects in a row: volume and dry matter of each; feed, steam and cooling drive them.

    A volume leaves by the square root of its level, steam boils water off, vapour of one effect
    heats the next; small deviations about the working point, so nearly linear. Sampled each 10 s.
    """
    u = 0.3 * _steps(rng, 3, 6000, 20, 200)

    def rates(x: Array, acting: Array) -> Array:
        volume, matter, heat = x[:3], x[3:6], x[6:]
        feed, steam, cooling = 1 + 0.1 * acting[0], 1 + 0.1 * acting[1], 1 + 0.1 * acting[2]
        inflow, dry, vapour, found = feed, 0.1 * feed, steam, np.empty(9)
        for k in range(3):
            boiled = 0.2 * heat[k]
            out = (1 - 0.2 * (k + 1)) * np.sqrt(max(volume[k], 1e-3))
            strength = matter[k] / max(volume[k], 1e-3)
            found[k] = (inflow - boiled - out) / (120.0 * (k + 1))
            found[3 + k] = (dry - out * strength) / (120.0 * (k + 1))
            lost = 0.0 if k < 2 else 0.3 * (cooling - 1)
            found[6 + k] = (vapour - heat[k] - lost) / (30.0 + 20 * k)
            inflow, dry, vapour = out, out * strength, heat[k]
        return found

    start = np.array([1.0, 1, 1, 0.125, 1 / 6, 0.25, 1, 1, 1])
    settled = _integrated(rates, start, np.zeros((3, 600)), 10.0, 4)[-1]
    x = _integrated(rates, settled, u, 10.0, 4)
    clean = np.array([x[:, 5] / x[:, 2], x[:, 2], x[:, 8]])
    clean = clean - clean[:, :1] + np.array([[25.0], [60.0], [80.0]])
    return Run(10.0, u, clean, _noisy(rng, clean, 0.1, 0.5))


def furnace(rng: np.random.Generator, heaters: int = 3) -> Run:
    """A wall of 24 nodes in a row with a load, heated in three places, read in six; each 5 s."""
    nodes, u = 24, 1 + _steps(rng, heaters, 5000, 60, 500)
    u[:, :60] = 0.0
    mass = rng.uniform(0.7, 1.3, nodes) * 40.0
    mass[8:14] *= 6.0
    A = np.zeros((nodes, nodes))
    for k in range(nodes - 1):
        conducts = rng.uniform(0.8, 1.2)
        A[k, k] -= conducts
        A[k + 1, k + 1] -= conducts
        A[k, k + 1] = A[k + 1, k] = conducts
    A[range(nodes), range(nodes)] -= 0.01 + 0.05 * (np.arange(nodes) % 5 == 0)
    B = np.zeros((nodes, heaters))
    B[[2, 11, 20][:heaters], range(heaters)] = 1.0
    x = _linear(A / mass[:, None], B / mass[:, None], u, 5.0)
    clean = x[:, [0, 4, 9, 13, 17, 23]].T
    return Run(5.0, u, clean, _noisy(rng, clean, 0.02, 0.8))


def plate(rng: np.random.Generator) -> Run:
    """Four bending modes, lightly damped, two forces; two displacements and an acceleration."""
    frequencies, damping = 2 * np.pi * np.array([3.0, 7.2, 11.5, 17.0]), 0.01 + 0.01 * rng.random(4)
    force, place = rng.standard_normal((4, 2)), rng.standard_normal((3, 4))
    A = np.zeros((8, 8))
    A[range(4), range(4, 8)] = 1.0
    A[range(4, 8), range(4)] = -(frequencies**2)
    A[range(4, 8), range(4, 8)] = -2 * damping * frequencies
    B = np.vstack([np.zeros((4, 2)), force])
    u, period = rng.standard_normal((2, 6000)), 0.01
    u = np.repeat(u[:, ::3], 3, axis=1)[:, :6000]
    u[:, :20] = 0.0
    x = _linear(A, B, u, period)
    moved = place[:2] @ x[:, :4].T
    accelerated = place[2] @ (x @ A[4:].T + u.T @ force.T).T
    clean = np.vstack([moved, accelerated])
    return Run(period, u, clean, _noisy(rng, clean, 0.1), direct=True)


def wall(rng: np.random.Generator) -> Run:
    """A wall of 40 layers with days behind it: air outside and a heater drive two temperatures."""
    layers, rows, period = 40, 6000, 600.0
    A = np.diag(-2.0 * np.ones(layers)) + np.diag(np.ones(layers - 1), 1)
    A = (A + np.diag(np.ones(layers - 1), -1)) * 1e-3
    A[-1, -1] = -1.15e-3
    B = np.zeros((layers, 2))
    B[0, 0], B[-1, 1] = 1e-3, 4e-4
    u = np.vstack([np.zeros(rows), _steps(rng, 1, rows, 50, 400)[0]])
    hours = np.arange(rows) * period / 3600
    weather = np.cumsum(rng.standard_normal(rows)) * 0.05
    u[0] = 6 * np.sin(2 * np.pi * hours / 24) + weather - weather[0]
    u[1] += 1
    u[:, :5] = 0.0
    x = _linear(A, B, u, period)
    clean = x[:, [12, 39]].T
    return Run(period, u, clean, _noisy(rng, clean, 0.03, 0.5))


def sixteen(rng: np.random.Generator, outputs: int = 2) -> Run:
    """Sixteen sources on a body with five time constants, two readings; 10⁴ rows."""
    rates = 1 / np.geomspace(3, 400, 5)
    B = rng.standard_normal((5, 16)) * rates[:, None]
    u = _steps(rng, 16, 10_000, 10, 80)
    x = _linear(-np.diag(rates), B, u, 1.0)
    clean = rng.standard_normal((outputs, 5)) @ x.T
    return Run(1.0, u, clean, _noisy(rng, clean, 0.1))


def exchanger(rng: np.random.Generator) -> Run:
    """A tube of 30 cells behind a wall: the flow of either side carries heat, and moves it faster.

    Both heat transfer coefficients rise with their flow to the power of 0.8; the flows change by a
    half about the working point, so far from linear. Outlet temperature of the cold side, each 1 s.
    """
    cells, rows = 30, 4000
    u = 0.5 * _steps(rng, 2, rows, 20, 150)

    def rates(x: Array, acting: Array) -> Array:
        cold, wall, hot = x[:cells], x[cells : 2 * cells], x[2 * cells :]
        flow, heating = 1 + acting
        into_cold, into_wall = 0.25 * flow**0.8, 0.25 * heating**0.8
        found = np.empty(3 * cells)
        entering = np.concatenate([[20.0], cold[:-1]])
        found[:cells] = 0.8 * flow * (entering - cold) + into_cold * (wall - cold)
        found[cells : 2 * cells] = 0.1 * (into_cold * (cold - wall) + into_wall * (hot - wall))
        entering = np.concatenate([hot[1:], [90.0]])
        found[2 * cells :] = 0.8 * heating * (entering - hot) + into_wall * (wall - hot)
        return found

    start = np.full(3 * cells, 50.0)
    settled = _integrated(rates, start, np.zeros((2, 600)), 1.0, 4)[-1]
    clean = _integrated(rates, settled, u, 1.0, 4)[:, [cells - 1]].T
    return Run(1.0, u, clean, _noisy(rng, clean, 0.05, 0.5))


def boiler(rng: np.random.Generator) -> Run:
    """A drum: fuel, feed water and steam valve drive pressure, steam flow and the water's level.

    The level swells with the steam below it before it falls; the flow goes by valve and pressure.
    A slow controller of the feed water, whose action is logged, holds the level. Each 2 s.
    """
    rows, period = 5000, 2.0
    asked = np.array([0.15, 0.1, 0.12])[:, None] * _steps(rng, 3, rows, 30, 250)
    u, x = asked.copy(), np.array([1.0, 1.0, 0.0, 0.0])
    clean = np.empty((3, rows))
    for k in range(rows):
        clean[:, k] = x[0], (1 + asked[2, k]) * np.sqrt(x[0]), x[3] + 0.6 * x[2]
        u[1, k] = asked[1, k] - 0.3 * (x[3] + 0.6 * x[2])
        for _ in range(10):
            steam = (1 + asked[2, k]) * np.sqrt(max(x[0], 1e-3))
            rate = np.array([
                (x[1] - steam - 0.1 * u[1, k]) / 80.0,
                (1 + asked[0, k] - x[1]) / 15.0,
                (steam - x[0] - x[2]) / 10.0,
                (1 + u[1, k] - steam) / 100.0,
            ])  # fmt: skip
            x = x + period / 10 * rate
    return Run(period, u, clean, _noisy(rng, clean, 0.05, 0.5))


def static(rng: np.random.Generator) -> Run:
    """Two outputs that follow three inputs at once, without any state."""
    u = _steps(rng, 3, 3000, 5, 60)
    clean = rng.standard_normal((2, 3)) @ u
    return Run(1.0, u, clean, _noisy(rng, clean, 0.1), direct=True)


def crane(rng: np.random.Generator) -> Run:
    """A load on a rope behind a slow drive: one pair of two per cent damping and one lag."""
    u = _steps(rng, 1, 3000, 40, 200)
    omega = rng.uniform(0.3, 0.6)
    A = np.array([[-0.02, 0, 0], [0, 0, 1], [omega**2, -(omega**2), -0.04 * omega]])
    x = _linear(A, np.array([[0.02], [0], [0]]), u, 1.0)
    clean = x[:, [1]].T
    return Run(1.0, u, clean, _noisy(rng, clean, 0.1), heat=False)


PLANTS: dict[str, Callable[[np.random.Generator], Run]] = {
    "evaporator, 3 inputs, 3 outputs": evaporator,
    "furnace, 3 inputs, 6 outputs": furnace,
    "furnace, 2 inputs, 6 outputs": lambda rng: furnace(rng, 2),
    "plate, 2 inputs, 3 outputs": plate,
    "wall, 2 inputs, 2 outputs": wall,
    "16 inputs, 2 outputs": sixteen,
    "exchanger (nonlinear), 2 inputs, 1 output": exchanger,
    "boiler (nonlinear), 3 inputs, 3 outputs": boiler,
    "static, 3 inputs, 2 outputs": static,
    "crane, 1 input, 1 output": crane,
}
