"""The level at which a signal begins: as good as noise allows, and not better than that."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.signals.start_level import MAX_ROWS, start_level

SIGMA = 0.3


def levels(make, repeats=200):
    return np.array(
        [start_level(make(np.random.default_rng(seed))).value for seed in range(repeats)]
    )


@pytest.mark.parametrize("rows", [30, 300, 1500])
def test_a_steady_signal_begins_with_the_level_of_many_rows(rows):
    found = levels(lambda rng: 20.0 + SIGMA * rng.standard_normal(rows))
    # A third of the rows, the median of which scatters 1.25 times as much as their mean.
    assert np.sqrt(np.mean((found - 20.0) ** 2)) < 3.0 * SIGMA / np.sqrt(rows)


def test_a_signal_that_moves_at_once_begins_nearer_than_one_reading():
    rows = np.arange(1000)
    found = levels(lambda rng: 20.0 + 0.02 * SIGMA * rows + SIGMA * rng.standard_normal(1000))
    assert np.sqrt(np.mean((found - 20.0) ** 2)) < 0.6 * SIGMA


@pytest.mark.parametrize(
    "values",
    [
        np.linspace(3.0, 90.0, 400),
        3.0 + 50.0 * -np.expm1(-np.arange(400) / 30.0),
        3.0 + 50.0 * -np.expm1(-np.arange(400) / 1.0),  # sampled once in a time constant
        np.append(np.full(20, 3.0), np.full(380, 90.0)),
        np.array([3.0]),
        np.array([3.0, 8.0]),
        np.full(50, 3.0),
    ],
)
def test_without_noise_it_is_the_first_value(values):
    assert start_level(values).value == pytest.approx(3.0, abs=1e-9)


@pytest.mark.parametrize("wrong", [-180.0, 85.0, 24.0])
def test_a_first_reading_that_stands_alone_does_not_count(wrong):
    def make(rng):
        values = 20.0 + SIGMA * rng.standard_normal(500)
        values[0] = wrong
        return values

    assert np.max(np.abs(levels(make) - 20.0)) < SIGMA


def test_an_outlier_behind_the_first_row_does_not_count():
    values = 20.0 + SIGMA * np.random.default_rng(3).standard_normal(500)
    values[[1, 7]] = 500.0
    assert abs(start_level(values).value - 20.0) < SIGMA


def test_readings_in_steps():
    """A rise of half a step in the stretch is seen, a level between two steps is none."""

    def make(rng):
        return 0.0625 * np.round((20.03 + 0.05 * rng.standard_normal(800)) / 0.0625)

    assert np.max(np.abs(levels(make, 50) - 20.03)) < 0.0625


def test_missing_rows():
    values = np.append(
        np.full(4, np.nan), 20.0 + SIGMA * np.random.default_rng(1).standard_normal(90)
    )
    values[10:20] = np.nan
    found = start_level(values)
    assert found.first == 4
    assert found.rows <= 80
    assert abs(found.value - 20.0) < SIGMA
    nothing = start_level(np.full(3, np.nan))
    assert np.isnan(nothing.value)
    assert nothing.rows == 0
    assert start_level(np.empty(0)).rows == 0


def test_it_costs_the_same_however_long_the_record():
    long = np.append(np.full(MAX_ROWS, 1.0), np.full(100_000, 7.0))
    assert start_level(long).value == 1.0
