"""The source's ε = 3.74 T1 + 7.36 T5 (Zhu, Ni, Shih 2008, 16) by other readings of its rod.

    python benchmarks/rod_readings.py [--seed N]

A rod by linear finite elements (numpy alone, implicit midpoint rule), heated at one end, of which
what the print leaves open is read in other ways: mass, elements, where the heat enters, films,
section, length, where sensors are. For each the weights of two sensors by least squares over random
heats (1, 2 and 4 h, held for 2 to 20 min), with an offset and without, and what the printed formula
misses on the same rows.
"""

from __future__ import annotations

import argparse
import itertools
import secrets
from dataclasses import dataclass

import numpy as np

PRINTED = np.array([3.74, 7.36])
SECTION, CONDUCTIVITY, CAPACITY, EXPANSION = 0.0314, 60.5, 434 * 7.8e3, 10.8
ROUND = 2 * np.sqrt(np.pi * SECTION)
DT = 10.0


@dataclass(frozen=True)
class Reading:
    """What the print leaves open.

    Attributes
    ----------
    places : (float, float) [m]
        Of the two sensors, from the heated end.
    length, perimeter : float [m]
    elements : int
    lumped : bool
        Heat capacity at the nodes.
    film : float [W/(m² K)]
    ends : bool
        Whether the ends have the film, too.
    heated : float [m]
        Length over which the heat enters, from the end.
    """

    places: tuple[float, float] = (0.1, 0.5)
    length: float = 1.0
    perimeter: float = ROUND
    elements: int = 22
    lumped: bool = False
    film: float = 20.0
    ends: bool = False
    heated: float = 0.0

    def rises(self, heat):
        """Places of the nodes [m] and their rises [K], shape (rows, nodes), for a heat [W]."""
        n, cell = self.elements, self.length / self.elements
        shape = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
        stored, lost = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
        inlet = np.zeros(n + 1)
        warm = max(round(self.heated / cell), 1)
        for k in range(n):
            own = slice(k, k + 2)
            stored[own, own] += (
                CAPACITY * SECTION * cell * (np.eye(2) / 2 if self.lumped else shape)
            )
            lost[own, own] += self.film * self.perimeter * cell * shape
            lost[own, own] += CONDUCTIVITY * SECTION / cell * np.array([[1, -1], [-1, 1]])
            inlet[own] += (k < warm) / (2 * warm)
        if not self.heated:
            inlet[:] = np.arange(n + 1) == 0
        if self.ends:
            lost[[0, n], [0, n]] += self.film * SECTION
        inverse = np.linalg.inv(stored / DT + lost / 2)
        turn, feed = inverse @ (stored / DT - lost / 2), inverse @ inlet
        rises = np.zeros((len(heat), n + 1))
        for k in range(1, len(heat)):
            rises[k] = turn @ rises[k - 1] + feed * heat[k - 1]
        return np.arange(n + 1) * cell, rises


READINGS = {
    "as printed: 22 elements, heat into the end": Reading(),
    "heat capacity at the nodes": Reading(lumped=True),
    "200 elements": Reading(elements=200),
    "sensors at the nodes below, 0.091 and 0.5 m": Reading((2 / 22, 0.5)),
    "sensors at the nodes above, 0.136 and 0.545 m": Reading((3 / 22, 12 / 22)),
    "heat over the first 0.1 m": Reading(heated=0.1),
    "heat over the first 0.2 m": Reading(heated=0.2),
    "no film": Reading(film=0.0),
    "film 40 W/(m² K)": Reading(film=40.0),
    "film at the ends, too": Reading(ends=True),
    "square section": Reading(perimeter=4 * np.sqrt(SECTION)),
    "22 elements of 0.05 m": Reading(length=1.1),
    "the same, sensors from the second node on": Reading((0.15, 0.55), length=1.1),
    "nine places between the ends, 0 and 0.5 m": Reading((0.0, 0.5)),
    "nine places from 1/9 on, 0.111 and 0.556 m": Reading((1 / 9, 5 / 9)),
    "places 2 and 6 for 1 and 5, 0.2 and 0.6 m": Reading((0.2, 0.6)),
    "places that suit the weights: 0.15 and 0.65 m": Reading((0.15, 0.65)),
    "the same, heat over the first 0.1 m": Reading((0.15, 0.65), heated=0.1),
}  # fmt: skip


def random_heats(rng):
    """Heats [W], drawn anew every 2 to 20 min, of 1 to 4 h."""
    for hours, minutes in itertools.product((1, 2, 4), (2, 5, 10, 20)):
        rows, held = int(hours * 3600 / DT), int(minutes * 60 / DT)
        yield np.repeat(rng.uniform(0, 1000, -(-rows // held)), held)[:rows]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, help="drawn if absent")
    given = parser.parse_args()
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    heats = list(random_heats(np.random.default_rng(seed)))
    print(f"seed {seed}; medians of {2 * len(heats)} fits, with an offset and without; least and "
          "largest weight in parentheses\n")  # fmt: skip
    print("| reading | T1 | T5 | both within 5 % | least squares leave, % of the range "
          "| the printed formula leaves, % |\n|---|---|---|---|---|---|")  # fmt: skip
    for name, reading in READINGS.items():
        found, left = [], []
        for heat in heats:
            x, rises = reading.rises(heat)
            pair = np.array([[np.interp(p, x, row) for p in reading.places] for row in rises])
            tip = EXPANSION * np.trapezoid(rises, x, axis=1)
            plain = tip - pair @ PRINTED
            for offset in (False, True):
                columns = np.column_stack([pair, np.ones(len(tip))]) if offset else pair
                weights = np.linalg.lstsq(columns, tip, rcond=None)[0]
                found.append(weights[:2])
                own = tip - columns @ weights
                left.append([100 * np.sqrt(np.mean(e**2)) / np.ptp(tip) for e in (own, plain)])
        weights, errors = np.array(found), np.median(left, axis=0)
        held = np.mean(np.all(np.abs(weights / PRINTED - 1) < 0.05, axis=1))
        cells = [f"{np.median(w):.2f} ({w.min():.2f} to {w.max():.2f})" for w in weights.T]
        print(f"| {name} | {cells[0]} | {cells[1]} | {100 * held:.0f} % | {errors[0]:.1f} "
              f"| {errors[1]:.1f} |")  # fmt: skip


if __name__ == "__main__":
    main()
