"""The best of all sets of sensors, where there are few enough to compare them all.

Of sensors S with the scaled readings Φ and G = Φ Φᵀ the information M of all states has
det M = det(I + G_SS), and tr C M⁻¹ Cᵀ = tr C Cᵀ − tr B_Sᵀ (I + G_SS)⁻¹ B_S with B = Φ Cᵀ (Woodbury
1950): matrices of as many rows as sensors, for many sets at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, islice
from math import comb

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array

# All sets are compared where there are no more of them, and no more work in their systems of
# equations (sets times the cube of their sensors): about a second for three duty cycles.
MAX_SETS, MAX_WORK = 200_000, 200_000_000
# Numbers in the matrices of the sets that are compared at once.
CHUNK = 1_000_000


def set_sizes(costs: Array, budget: float) -> range:
    """How many sensors the sets have that are to be compared; none where they are too many sets.

    Parameters
    ----------
    costs : ndarray, shape (n,)
        Of the candidates. Where all cost the same, sets of fewer sensors than can be had are worse.
    budget : float
    """
    most = int(np.searchsorted(np.cumsum(np.sort(costs)), budget, side="right"))
    sizes = range(1 if np.ptp(costs) else most, most + 1)
    sets = [comb(len(costs), size) for size in sizes]
    work = sum(each * size**3 for each, size in zip(sets, sizes, strict=True))
    return sizes if sum(sets) <= MAX_SETS and work <= MAX_WORK else range(0)


def best_set(
    readings: Sequence[Array],
    targets: Sequence[Array] | None,
    places: Sequence[int],
    count: int,
    costs: Array,
    budget: float,
) -> list[int]:
    """The set of the largest criterion of all sets of so many sensors; empty where none is paid.

    Parameters
    ----------
    readings : sequence of ndarray, shape (N, r) [noise of each candidate]
        Of each duty cycle.
    targets : sequence of ndarray, shape (p, r), or None
        C of the variances that are to be small; None: det M is to be large.
    places : sequence of int
        Candidates.
    count : int
    costs : ndarray, shape (N,)
    budget : float
        What the sensors of a set cost at most.
    """
    best: tuple[float, list[int]] = (-np.inf, [])
    grams = [rows @ rows.T for rows in readings]
    for chunk in _chunks(places, count):
        sets = chunk[costs[chunk].sum(axis=1) <= budget]
        if not len(sets):
            continue
        value = np.zeros(len(sets))
        for k, gram in enumerate(grams):
            own = np.eye(count) + gram[sets[:, :, None], sets[:, None, :]]
            if targets is None:
                value += np.linalg.slogdet(own)[1]
                continue
            pull = (readings[k] @ targets[k].T)[sets]
            seen = np.sum(pull * np.linalg.solve(own, pull), axis=(1, 2))
            power = float(np.sum(targets[k] ** 2))
            value -= np.log(np.maximum(power - seen, 1e-300))
        first = int(np.argmax(value))
        if value[first] > best[0]:
            best = float(value[first]), sets[first].tolist()
    return best[1]


def _chunks(places: Sequence[int], count: int) -> Iterator[NDArray[np.intp]]:
    sets = combinations(places, count)
    while part := list(islice(sets, max(CHUNK // count**2, 1))):
        yield np.array(part, np.intp)
