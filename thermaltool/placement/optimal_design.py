"""Sensors from candidates by what they leave uncertain: optimal design of experiments.

A machine has states θ of unit variance (modes times their amplitudes over a duty cycle); candidate
i reads φ_i θ + v_i with noise σ_i, the deflections are C θ. Sensors S have the information
M = I + Σ_S φ_i φ_iᵀ/σ_i². Criteria, all concave in weights of the candidates (Pukelsheim 2006):

- D: ½ ln det M, what the readings tell of all states;
- A: −½ ln tr Φ M⁻¹ Φᵀ, the variance of the temperatures at all candidates;
- I: −½ ln tr C M⁻¹ Cᵀ, the variance of the deflections to be predicted.

Where all sets are few enough they are compared. Else greedy forward selection with exchange
(Fedorov 1972) finds a set, and a relaxation to weights between 0 and 1 bounds what any set reaches:
f(w*) ≤ f(w) + max_v ∇f(w)ᵀ(v − w).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError, counted
from thermaltool.fitting.data import Array
from thermaltool.placement.candidates import Candidates, deflection_errors, output_errors
from thermaltool.placement.exhaustive import best_set, set_sizes
from thermaltool.placement.sensor_sets import SensorSet

Criterion = Literal["I", "A", "D"]
CRITERIA = get_args(Criterion)
# An exchange has to gain more than this, so that rounding does not go round in circles.
MIN_GAIN = 1e-9
# Rounds of exchanges, and of the relaxation (Frank and Wolfe 1956).
MAX_EXCHANGES, RELAXATION_STEPS = 50, 60
# Of many candidates fewer steps: so many rows are taken in all.
MAX_RELAXED_ROWS = 50_000
# Step sizes that the relaxation tries.
STEPS = 2.0 ** -np.arange(0.0, 9.0)
# Up to so many candidates each of them is tried as the first sensor.
MANY_CANDIDATES = 64
# Pairs are exchanged where so many gains are found at most; one of a pair is among so many of the
# candidates that gain most.
MAX_PAIR_GAINS, PAIR_TRIALS = 500_000, 32


@dataclass(frozen=True)
class Placement:
    """Chosen sensors.

    Attributes
    ----------
    sensors : tuple of int
        In the order in which they were taken.
    value : float
        Of the criterion, mean over the duty cycles.
    bound : float
        That no set of this cost exceeds.
    efficiency : float
        Least ratio of the smallest standard deviation that may be reached to the one that is; by D
        that of one sensor, in the geometric mean.
    errors : ndarray, shape (cycles,) [unit of the deflections]
        Root mean square of what stays unknown of the deflections.
    """

    sensors: tuple[int, ...]
    value: float
    bound: float
    efficiency: float
    errors: Array


class _Information:
    """Covariances M⁻¹ of all duty cycles for a set of sensors, and what one more is worth."""

    def __init__(self, candidates: Candidates, criterion: Criterion) -> None:
        self.candidates, self.criterion = candidates, criterion
        self.rows = [candidates.scaled(cycle) for cycle in candidates.cycles]
        self.targets = [
            cycle.deflections
            if criterion == "I"
            # tr Φ M⁻¹ Φᵀ takes of Φ = QR no more than R.
            else np.asarray(np.linalg.qr(cycle.readings, mode="r"), np.float64)
            for cycle in candidates.cycles
        ]
        self.covariances: list[Array] = [np.eye(rows.shape[1]) for rows in self.rows]

    def at(self, weights: Array) -> _Information:
        """For weights of the candidates, shape (N,); those of a set are 0 and 1."""
        held = np.flatnonzero(weights)
        for k, rows in enumerate(self.rows):
            own = rows[held]
            matrix = np.eye(rows.shape[1]) + (own * weights[held, None]).T @ own
            self.covariances[k] = np.asarray(np.linalg.inv(matrix), np.float64)
        return self

    def value(self) -> float:
        """Criterion, mean over the duty cycles."""
        found = []
        for covariance, target in zip(self.covariances, self.targets, strict=True):
            if self.criterion == "D":
                found.append(-0.5 * float(np.linalg.slogdet(covariance)[1]))
            else:
                found.append(-0.5 * float(np.log(np.sum((target @ covariance) * target))))
        return float(np.mean(found))

    def gains(self, places: NDArray[np.intp] | slice = slice(None)) -> Array:
        """By how much each candidate raises the criterion, shape (places,)."""
        whole = 0.0
        for rows, covariance, target in zip(self.rows, self.covariances, self.targets, strict=True):
            reached = rows[places] @ covariance
            own = np.einsum("ir,ir->i", reached, rows[places])
            if self.criterion == "D":
                gain = 0.5 * np.log1p(own)
            else:
                seen = np.sum((reached @ target.T) ** 2, axis=1)
                left = np.sum((target @ covariance) * target)
                gain = -0.5 * np.log(np.maximum(1 - seen / (1 + own) / left, 1e-300))
            whole = whole + gain
        return np.asarray(whole / len(self.rows))

    def slopes(self) -> Array:
        """Derivatives of the criterion by the weights of all candidates, shape (N,)."""
        whole = np.zeros(len(self.candidates.noise))
        for rows, covariance, target in zip(self.rows, self.covariances, self.targets, strict=True):
            reached = rows @ covariance
            if self.criterion == "D":
                whole += 0.5 * np.einsum("ir,ir->i", reached, rows)
            else:
                left = np.sum((target @ covariance) * target)
                whole += 0.5 * np.sum((reached @ target.T) ** 2, axis=1) / left
        return whole / len(self.rows)

    def add(self, place: int, weight: float = 1.0) -> None:
        """Take a sensor in, or out with a weight of −1 (Sherman and Morrison 1950)."""
        for k, rows in enumerate(self.rows):
            reached = self.covariances[k] @ rows[place]
            scale = weight / (1 + weight * float(rows[place] @ reached))
            self.covariances[k] = self.covariances[k] - scale * np.outer(reached, reached)


def place_sensors(
    candidates: Candidates, budget: float, criterion: Criterion = "I", bounded: bool = True
) -> Placement:
    """Sensors within a budget: the best of all sets where these are few, else by search.

    Parameters
    ----------
    candidates : Candidates
    budget : float
        Their costs together at most: their number, where each costs 1.
    criterion : {"I", "A", "D"}
    bounded : bool
        Whether the bound is found; else it is infinite.

    Raises
    ------
    FitError
        A budget for no sensor, or for more than there are candidates.
    """
    costs, allowed = candidates.costs, candidates.allowed
    if budget < costs[allowed].min():
        raise FitError(f"no sensor costs so little: the budget is {budget:g}")
    if budget > costs[allowed].sum() + MIN_GAIN:
        raise FitError(
            f"sensors for {budget:g} of {int(allowed.sum())} candidates, which cost "
            f"{costs[allowed].sum():g} in all: ask for fewer"
        )
    exact = _best_of_all(candidates, budget, criterion)
    value, chosen = exact or _best_found(candidates, budget, criterion)
    bound = value if exact else np.inf
    if bounded and not exact:
        bound, relaxed = _relaxed(candidates, budget, criterion, _weights(candidates, chosen))
        # The sensors of the largest weights are another start.
        ranked = [int(k) for k in np.argsort(-relaxed, kind="stable") if relaxed[k] > 0.5]
        start = _within(ranked, costs, budget)
        value, chosen = max((value, chosen), _searched(candidates, criterion, start, budget))
        bound = max(bound, value)
    efficiency = float(np.exp((value - bound) / (len(chosen) if criterion == "D" else 1)))
    errors = deflection_errors(candidates, chosen)
    return Placement(tuple(chosen), value, bound, efficiency, errors)


def placed_sets(
    candidates: Candidates, names: Sequence[str], most: int, criterion: Criterion
) -> tuple[SensorSet, ...]:
    """Sensors for a budget of 1, 2, 3 …, each set once.

    Parameters
    ----------
    candidates : Candidates
    names : sequence of str
        Of all candidates.
    most : int
    criterion : {"I", "A", "D"}

    Raises
    ------
    FitError
        More than there are candidates, or none that costs so little.
    """
    price = candidates.costs[candidates.allowed]
    if most > len(price):
        raise FitError(
            f"{counted(most, 'sensor')} of {counted(len(price), 'candidate')}: ask for fewer"
        )
    found: list[SensorSet] = []
    for count in range(1, most + 1):
        # More than all of them cost buys no more.
        budget = min(float(count), float(price.sum()))
        if budget < price.min():
            continue
        each = place_sensors(candidates, budget, criterion)
        errors = output_errors(candidates, each.sensors)
        named = tuple(names[k] for k in sorted(each.sensors))
        if not found or named != found[-1].sensors:
            found.append(SensorSet(named, tuple(errors.tolist()), (), each.efficiency))
    if not found:
        raise FitError(f"no sensor costs {most:g} or less")
    return tuple(found)


def _weights(candidates: Candidates, sensors: Sequence[int]) -> Array:
    found = np.zeros(len(candidates.costs))
    found[list(sensors)] = 1.0
    return found


def criterion_value(candidates: Candidates, sensors: Sequence[int], criterion: Criterion) -> float:
    """The criterion of a set, mean over the duty cycles.

    Parameters
    ----------
    candidates : Candidates
    sensors : sequence of int
    criterion : {"I", "A", "D"}
    """
    return _Information(candidates, criterion).at(_weights(candidates, sensors)).value()


def _best_of_all(
    candidates: Candidates, budget: float, criterion: Criterion
) -> tuple[float, list[int]] | None:
    """Value and sensors of the best of all sets within a budget; None where these are too many."""
    places, most = np.flatnonzero(candidates.allowed).tolist(), budget + MIN_GAIN
    state = _Information(candidates, criterion)
    targets = None if criterion == "D" else state.targets
    found = [
        best_set(state.rows, targets, places, size, candidates.costs, most)
        for size in set_sizes(candidates.costs[places], most)
    ]
    return max(((criterion_value(candidates, s, criterion), s) for s in found if s), default=None)


def _best_found(
    candidates: Candidates, budget: float, criterion: Criterion
) -> tuple[float, list[int]]:
    """Value and sensors of the best that starts lead to: none, of few candidates each of them."""
    starts: list[list[int]] = [[]]
    if len(candidates.costs) <= MANY_CANDIDATES:
        starts += [[int(k)] for k in _free(candidates, [], budget)]
    return max(_searched(candidates, criterion, start, budget) for start in starts)


def _searched(
    candidates: Candidates, criterion: Criterion, start: Sequence[int], budget: float
) -> tuple[float, list[int]]:
    """Value and sensors of what a start leads to."""
    first = _greedy(candidates, criterion, start, budget)
    chosen = _exchanged(candidates, criterion, first, budget)
    return criterion_value(candidates, chosen, criterion), chosen


def _within(ranked: Sequence[int], costs: Array, budget: float) -> list[int]:
    """Those that a budget pays for, in their order."""
    kept: list[int] = []
    for place in ranked:
        if costs[[*kept, place]].sum() <= budget + MIN_GAIN:
            kept.append(place)
    return kept


def _greedy(
    candidates: Candidates, criterion: Criterion, start: Sequence[int], budget: float
) -> list[int]:
    """Sensors beside those of the start, each the one that gains most for its cost."""
    state, costs, chosen = _Information(candidates, criterion), candidates.costs, list(start)
    for place in chosen:
        state.add(place)
    while True:
        places = _free(candidates, chosen, budget)
        if not len(places):
            return chosen
        best = int(places[np.argmax(state.gains(places) / costs[places])])
        state.add(best)
        chosen.append(best)


def _exchanged(
    candidates: Candidates, criterion: Criterion, chosen: Sequence[int], budget: float
) -> list[int]:
    """Each sensor, then each pair, for better ones, until none is, within the budget."""
    state, found = _Information(candidates, criterion), list(chosen)
    for place in found:
        state.add(place)
    pairs = len(found) * (len(found) - 1) // 2
    trials = min(PAIR_TRIALS, len(candidates.costs))
    paired = pairs * trials * len(candidates.costs) <= MAX_PAIR_GAINS
    for _ in range(MAX_EXCHANGES):
        before = state.value()
        for k in range(len(found)):
            _exchange_one(state, found, k, budget)
        if state.value() > before + MIN_GAIN:
            continue
        moved = paired and any(
            _exchange_pair(state, found, pair, budget)
            for pair in combinations(range(len(found)), 2)
        )
        if not moved:
            break
    return found


def _free(candidates: Candidates, taken: Sequence[int], budget: float) -> NDArray[np.intp]:
    """Candidates that may be taken beside others."""
    spare = budget - candidates.costs[list(taken)].sum() + MIN_GAIN
    free = candidates.allowed & (candidates.costs <= spare)
    free[list(taken)] = False
    return np.flatnonzero(free)


def _exchange_one(state: _Information, found: list[int], k: int, budget: float) -> None:
    """The best candidate in the place of sensor k; itself where none is better."""
    own = found[k]
    state.add(own, -1.0)
    places = _free(state.candidates, [*found[:k], *found[k + 1 :]], budget)
    gains = state.gains(places)
    best = int(places[np.argmax(gains)])
    found[k] = best if gains.max() > gains[np.searchsorted(places, own)] + MIN_GAIN else own
    state.add(found[k])


def _exchange_pair(
    state: _Information, found: list[int], pair: tuple[int, int], budget: float
) -> bool:
    """Two better candidates in the place of two sensors, if there are; says so."""
    a, b = (found[k] for k in pair)
    before = state.value()
    state.add(a, -1.0)
    state.add(b, -1.0)
    kept = [place for k, place in enumerate(found) if k not in pair]
    places = _free(state.candidates, kept, budget)
    base, gains = state.value(), state.gains(places)
    best, level = (a, b), before + MIN_GAIN
    for first in places[np.argsort(-gains, kind="stable")[:PAIR_TRIALS]].tolist():
        gain = gains[np.searchsorted(places, first)]
        state.add(first)
        others = _free(state.candidates, [*kept, first], budget)
        if len(others):
            more = state.gains(others)
            if base + gain + more.max() > level:
                best, level = (first, int(others[np.argmax(more)])), base + gain + more.max()
        state.add(first, -1.0)
    for k, place in zip(pair, best, strict=True):
        state.add(place)
        found[k] = place
    return best != (a, b)


def _relaxed(
    candidates: Candidates, budget: float, criterion: Criterion, weights: Array
) -> tuple[float, Array]:
    """What no set within the budget exceeds, by the concavity of the criterion; and weights."""
    state, w = _Information(candidates, criterion), weights.copy()
    bound = np.inf
    for _ in range(min(RELAXATION_STEPS, 1 + MAX_RELAXED_ROWS // len(w))):
        value, slopes = state.at(w).value(), state.slopes()
        toward = _vertex(candidates, budget, slopes)
        bound = min(bound, value + float(slopes @ (toward - w)))
        trials = [state.at(w + step * (toward - w)).value() for step in STEPS]
        best = int(np.argmax(trials))
        if trials[best] <= value + MIN_GAIN or bound - value < MIN_GAIN:
            break
        w = w + STEPS[best] * (toward - w)
    return float(bound), w


def _vertex(candidates: Candidates, budget: float, slopes: Array) -> Array:
    """Weights in [0, 1] of the largest slope within the budget: the knapsack with parts."""
    worth = np.where(candidates.allowed, slopes / candidates.costs, -1.0)
    order = np.argsort(-worth, kind="stable")
    spent = np.concatenate([[0.0], np.cumsum(candidates.costs[order])[:-1]])
    found = np.zeros(len(slopes))
    part = np.clip((budget - spent) / candidates.costs[order], 0.0, 1.0)
    found[order] = np.where(worth[order] > 0, part, 0.0)
    return found
