"""A spindle of thirty bodies with sixteen sensors, whose displacements no sensor measures alone.

Bodies hang on each other in a random tree with a few more links, lose heat to a room that warms
and cools, and are heated by bearings (speed^1.5) and a motor (speed). Four hours at each of the
speeds of a standard test, with four hours at rest between them. Displacements take in every body,
sensors sit on sixteen of them. Exact from row to row. Every seed draws another machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

BODIES, SENSORS, OUTPUTS = 30, 16, 3
PERIOD, HOURS_EACH = 60.0, 4.0
SPEEDS = (1250.0, 0.0, 2500.0, 0.0, 3750.0, 0.0, 5000.0)  # [1/min]
NAMES = [f"T_t{k}_degC" for k in range(1, SENSORS + 1)]
# Of a reading [K]; of a displacement [um], whose standard deviation over the first 60 % is 10 um.
READING, PROBE, DEVIATION = 0.03, 0.3, 10.0
TRAINED = 0.6


@dataclass(frozen=True)
class Run:
    """One log.

    Attributes
    ----------
    time : (n,) ndarray [s]
    temperatures : (16, n) ndarray [degC]
    displacements : (3, n) ndarray [um]
    """

    time: Array
    temperatures: Array
    displacements: Array


def run_of(rng: np.random.Generator, slow: float = 0.0, correlation: float = 4 * 3600.0) -> Run:
    """The log of a machine that is drawn.

    Parameters
    ----------
    rng : Generator
    slow : float [um]
        Standard deviation of what moves the displacements and is not of heat, as of the room's air
        on a gauge: a first-order process.
    correlation : float [s]
        Its correlation time.
    """
    n = BODIES
    capacity, films = 10 ** rng.uniform(2.3, 4.3, n), 10 ** rng.uniform(-1.3, 0.5, n)
    links = np.zeros((n, n))
    for i in range(1, n):
        j = rng.integers(max(0, i - 4), i)
        links[i, j] = links[j, i] = 10 ** rng.uniform(-0.3, 1.3)
    for _ in range(12):
        i, j = rng.choice(n, 2, replace=False)
        links[i, j] = links[j, i] = links[i, j] + 10 ** rng.uniform(-1, 0.7)
    time = np.arange(0, len(SPEEDS) * HOURS_EACH * 3600, PERIOD)
    hours = time / 3600
    speed = np.array(SPEEDS)[(hours // HOURS_EACH).astype(int)] / max(SPEEDS)
    speed[:10] = 0.0
    room = 1.5 * np.sin(2 * np.pi * (hours - rng.uniform(0, 24)) / 24)
    room += 0.3 * np.sin(2 * np.pi * hours / rng.uniform(2, 6))
    heat = np.zeros((n, len(time)))
    for i in rng.choice(n, 3, replace=False):
        heat[i] += rng.uniform(30, 120) * speed**1.5
    for i in rng.choice(n, 2, replace=False):
        heat[i] += rng.uniform(20, 80) * speed
    driven = (heat + films[:, None] * (room - room[0])) / capacity[:, None]
    A = -(np.diag(links.sum(axis=1) + films) - links) / capacity[:, None]
    whole = expm(PERIOD * np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]))
    x, states = np.zeros(n), []
    for now in driven.T:
        states.append(x)
        x = whole[:n, :n] @ x + whole[:n, n:] @ now
    course = np.array(states).T
    places = rng.choice(n, SENSORS, replace=False)
    readings = READING * rng.standard_normal((SENSORS, len(time)))
    temperatures = course[places] + rng.normal(25, 2, (SENSORS, 1)) + readings
    expansion = rng.standard_normal((OUTPUTS, n)) * (rng.random((OUTPUTS, n)) < 0.6)
    moved = expansion @ course
    moved *= DEVIATION / moved[:, : int(TRAINED * len(time))].std(axis=1, keepdims=True)
    kept = np.exp(-PERIOD / correlation)
    drift = np.zeros((OUTPUTS, len(time)))
    for k in range(1, len(time)):
        drift[:, k] = kept * drift[:, k - 1] + rng.standard_normal(OUTPUTS)
    drift *= slow * np.sqrt(1 - kept**2)
    probe = PROBE * rng.standard_normal((OUTPUTS, len(time)))
    return Run(time, temperatures, moved + drift + probe)
