"""Hysteresis after Prandtl and Ishlinskii, and its exact inverse; constant work per sample.

A sum of play operators, y = Σ w_i P_{r_i}[x]. The inverse is an operator of the same kind
(Kuhnen 2003, European Journal of Control 9, 407, for weights as `PrandtlIshlinskii` asks).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise


@dataclass
class PrandtlIshlinskii:
    """y = Σ w_i P_{r_i}[x], at rest at x = 0.

    Attributes
    ----------
    thresholds : sequence of float [unit of x]
        r_0 = 0, ascending.
    weights : sequence of float [unit of y per unit of x]
        w_0 > 0, and every partial sum above 0.

    Raises
    ------
    ValueError
        Where they are not so: then there is no inverse.
    """

    thresholds: Sequence[float]
    weights: Sequence[float]
    _plays: list[float] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        r, w = self.thresholds, self.weights
        if not r or len(r) != len(w):
            raise ValueError(f"{len(r)} thresholds and {len(w)} weights of a hysteresis")
        if r[0] != 0 or any(b <= a for a, b in pairwise(r)):
            raise ValueError("thresholds of a hysteresis do not ascend from 0")
        if not all(map(math.isfinite, [*r, *w])) or min(accumulate(w)) <= 0:
            raise ValueError("weights of a hysteresis have a partial sum that is not above 0")
        self._plays = [0.0] * len(r)

    def value(self, x: float) -> float:
        """y if x came next; the state stays.

        Parameters
        ----------
        x : float
        """
        y = 0.0
        for r, w, play in zip(self.thresholds, self.weights, self._plays, strict=True):
            y += w * (x - r if play < x - r else x + r if play > x + r else play)
        return y

    def take(self, x: float) -> float:
        """y after x.

        Parameters
        ----------
        x : float
        """
        plays = self._plays
        for k, r in enumerate(self.thresholds):
            play = plays[k]
            plays[k] = x - r if play < x - r else x + r if play > x + r else play
        return sum(w * play for w, play in zip(self.weights, plays, strict=True))

    def inverse(self) -> PrandtlIshlinskii:
        """The operator that gives x from y, from rest."""
        r, w, sums = self.thresholds, self.weights, list(accumulate(self.weights))
        weights = [1 / w[0]]
        weights += [-w[i] / (sums[i] * sums[i - 1]) for i in range(1, len(w))]
        thresholds = [sum(w[j] * (r[i] - r[j]) for j in range(i + 1)) for i in range(len(r))]
        return PrandtlIshlinskii(thresholds, weights)
