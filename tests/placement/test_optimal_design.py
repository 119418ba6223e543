"""Sensors from candidates: greedy against exhaustive search, bounds, costs, bad inputs."""

import itertools

import numpy as np
import pytest

from thermaltool.errors import FitError
from thermaltool.placement import exhaustive
from thermaltool.placement.candidates import Candidates, DutyCycle, deflection_errors
from thermaltool.placement.optimal_design import CRITERIA, criterion_value, place_sensors


def random_candidates(rng, count=12, states=6, cycles=2):
    own = [
        DutyCycle(
            rng.normal(size=(count, states)) * np.geomspace(1, 0.1, states),
            rng.normal(size=(2, states)),
        )
        for _ in range(cycles)
    ]
    return Candidates.of(own, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("criterion", CRITERIA)
def test_greedy_with_exchange_reaches_what_exhaustive_search_finds(criterion, monkeypatch):
    monkeypatch.setattr(exhaustive, "MAX_SETS", 0)
    for seed in range(3):
        candidates = random_candidates(np.random.default_rng(seed))
        found = place_sensors(candidates, 4, criterion)
        best = best_of_all(candidates, 4, criterion)
        assert np.exp(found.value - best) > 0.98
        assert best - 1e-9 <= found.bound
        assert 0 < found.efficiency <= 1


def best_of_all(candidates, count, criterion):
    sets = itertools.combinations(np.flatnonzero(candidates.allowed), count)
    return max(criterion_value(candidates, each, criterion) for each in sets)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_of_few_candidates_the_best_of_all_sets_is_taken(criterion):
    for seed in range(12):
        plain = random_candidates(np.random.default_rng(seed))
        candidates = Candidates.of(plain.cycles, 0.05, 2.0, forbidden=[3])
        found = place_sensors(candidates, 9.0, criterion)
        assert found.value == pytest.approx(best_of_all(candidates, 4, criterion), abs=1e-9)
        assert found.efficiency == 1


def test_of_few_candidates_of_different_costs_the_best_of_all_sets_within_the_budget_is_taken():
    costs = np.array([1.0, 1.5, 3.0, 0.5] * 3)
    for seed in range(6):
        cycles = random_candidates(np.random.default_rng(seed), states=8).cycles
        candidates = Candidates.of(cycles, 0.05, costs)
        found = place_sensors(candidates, 4.0)
        sets = [s for k in range(1, 7) for s in itertools.combinations(range(12), k)
                if costs[list(s)].sum() <= 4]  # fmt: skip
        best = max(criterion_value(candidates, s, "I") for s in sets)
        assert found.value == pytest.approx(best, abs=1e-9)
        assert costs[list(found.sensors)].sum() <= 4
        assert found.efficiency == 1


def test_a_sensor_more_leaves_less_and_the_errors_are_those_of_the_normal_equations():
    candidates = random_candidates(np.random.default_rng(7))
    found = [place_sensors(candidates, k, "I", bounded=False) for k in (2, 3, 4)]
    assert found[0].errors.mean() > found[1].errors.mean() > found[2].errors.mean()
    # Monte Carlo: states drawn, read with noise, estimated by least squares with their prior.
    cycle, rng = candidates.cycles[0], np.random.default_rng(8)
    own = cycle.readings[list(found[2].sensors)]
    states = rng.normal(size=(6, 20000))
    read = own @ states + 0.05 * rng.normal(size=(4, 20000))
    gain = own.T @ np.linalg.inv(own @ own.T + 0.05**2 * np.eye(4))
    left = cycle.deflections @ (states - gain @ read)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(found[2].errors[0], rel=0.02)


def test_costs_and_forbidden_places_are_kept():
    cycles = random_candidates(np.random.default_rng(3)).cycles
    free = place_sensors(Candidates.of(cycles, 0.05), 3)
    without = place_sensors(Candidates.of(cycles, 0.05, forbidden=[free.sensors[0]]), 3)
    assert free.sensors[0] not in without.sensors
    costs = np.ones(12)
    costs[list(free.sensors)] = 2.0
    dear = place_sensors(Candidates.of(cycles, 0.05, costs), 3)
    assert costs[list(dear.sensors)].sum() <= 3 + 1e-9
    assert deflection_errors(Candidates.of(cycles, 0.05), dear.sensors).shape == (2,)


def test_ten_thousand_candidates():
    rng = np.random.default_rng(4)
    readings = rng.normal(size=(10_000, 8)) * np.geomspace(1, 0.05, 8)
    found = place_sensors(
        Candidates.of([DutyCycle(readings, rng.normal(size=(1, 8)))], 0.05), 5, bounded=False
    )
    assert len(set(found.sensors)) == 5


def test_bad_inputs_are_named():
    cycles = random_candidates(np.random.default_rng(0)).cycles
    with pytest.raises(FitError, match="13 of 12 candidates"):
        place_sensors(Candidates.of(cycles, 0.05), 13)
    with pytest.raises(FitError, match="all are forbidden"):
        Candidates.of(cycles, 0.05, forbidden=range(12))
    with pytest.raises(FitError, match="above zero"):
        Candidates.of(cycles, 0.0)
    with pytest.raises(FitError, match=r"the budget is 0\.5"):
        place_sensors(Candidates.of(cycles, 0.05), 0.5)
