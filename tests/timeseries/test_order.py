"""Orders of simulated processes, beside the full grid of exact fits; bad series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.timeseries.hannan import gram_matrix
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.order import select_order
from thermaltool.timeseries.runs import even_record, without
from thermaltool.timeseries.screening import (
    DICKEY_FULLER,
    find_outliers,
    unit_root_statistic,
)

# Orders of the issue: ARMA(2,1), ARMA(3,2), AR(3).
PROCESSES = {
    (2, 1): ([0.7575, -0.6874], [-0.2743]),
    (3, 2): ([0.3, -0.4, 0.7], [0.9, 0.8]),
    (3, 0): ([0.6, -0.3, 0.4], []),
}


def simulated(order, size, seed):
    ar, ma = PROCESSES[order]
    noise = np.random.default_rng([seed, *order]).standard_normal(size + 500)
    return lfilter(np.r_[1.0, ma], np.r_[1.0, -np.array(ar)], noise)[500:]


def full_grid(x, max_p, max_q):
    """Exact deviances of every order, each from its own regression."""
    likelihood = ArmaLikelihood(even_record(x), 0)
    gram = gram_matrix(likelihood.detrended, max_p, max_q)
    return {
        (p, q): climb(likelihood, start(likelihood, *gram.solve(p, q)[:2]), 100, 1e-2)[0].deviance
        for p in range(max_p + 1)
        for q in range(max_q + 1)
    }


@pytest.mark.slow
@pytest.mark.parametrize("order", list(PROCESSES))
def test_bic_finds_the_order_as_often_as_the_full_grid(order):
    found = judged = 0
    for seed in range(12):
        x = simulated(order, 400, seed)
        grid = full_grid(x, 4, 4)
        judge = min(grid, key=lambda pair: grid[pair] + np.log(400) * sum(pair))
        best = select_order(even_record(x), 4, 4, criteria=("bic",)).best("bic")
        least = grid[judge] + np.log(400) * (sum(judge) + 2)
        assert best.criteria.bic <= least + 0.1, (seed, judge, (best.p, best.q))
        found += (best.p, best.q) == order
        judged += judge == order
    # Where the two differ, a maximum of lower BIC was found that the grid's climbs missed.
    assert found >= judged - 1
    assert judged >= 6


@pytest.mark.parametrize("seed", range(3))
def test_aic_of_the_best_is_within_one_of_the_full_grid(seed):
    x = simulated((2, 1), 1000, seed)
    grid = full_grid(x, 6, 6)
    least = min(deviance + 2 * (sum(pair) + 2) for pair, deviance in grid.items())
    table = select_order(even_record(x), 6, 6, criteria=("aic",))
    assert table.best("aic").criteria.aic <= least + 1.0
    assert len(table.entries) == 49


def test_a_search_that_its_budget_ends_says_so():
    # Two sines in noise: large models that differ little.
    t, noise = np.arange(600), np.random.default_rng(11).standard_normal(600)
    x = even_record(3.0 * np.sin(0.3 * t) + np.sin(0.9 * t) + 0.3 * noise)
    short, long = select_order(x, budget=3), select_order(x, 2, 1, budget=2000)
    assert short.cut_short
    assert not long.cut_short
    assert select_order(x, budget=200).best("aic").criteria.aic <= short.best("aic").criteria.aic


def test_what_is_exact_is_said():
    table = select_order(even_record(simulated((2, 1), 400, 1)))
    assert all(table.best(name).exact for name in ("aic", "aicc", "bic"))
    assert {e.exact for e in table.entries} == {True, False}
    best = table.best("bic")
    n, k = 400, best.p + best.q + 2
    assert best.criteria.aic - best.deviance == pytest.approx(2 * k)
    assert best.criteria.bic - best.deviance == pytest.approx(k * np.log(n))
    assert best.criteria.aicc - best.criteria.aic == pytest.approx(2 * k * (k + 1) / (n - k - 1))
    r = best.p + best.q + 1
    assert best.gao == pytest.approx(n * np.log(best.sigma2 * n / (n - r)) + 2 * r)


def test_constant_and_short_series_are_refused():
    for values in (np.full(200, 3.7), np.full(50, 1e6)):
        with pytest.raises(FitError, match="constant"):
            select_order(even_record(values))
    with pytest.raises(FitError, match="straight line"):
        select_order(even_record(3.0 + 0.1 * np.arange(300)), degree=1)
    with pytest.raises(FitError, match="too few"):
        select_order(even_record([1.0, 2.0, 1.5, 0.3]))


def test_a_short_series_keeps_to_orders_that_it_can_tell():
    table = select_order(even_record(simulated((3, 0), 40, 2)))
    assert max(e.p + e.q for e in table.entries) <= 40 // 3
    assert table.best("bic").exact


@pytest.mark.slow
def test_gaps_leave_the_order():
    x = simulated((2, 1), 1000, 4)
    whole = select_order(even_record(x), 4, 4).best("bic")
    x[np.random.default_rng(0).choice(1000, 20, replace=False)] = np.nan
    x[500:560] = np.nan
    holed = select_order(even_record(x), 4, 4, criteria=("bic",)).best("bic")
    assert (whole.p, whole.q) == (holed.p, holed.q) == (2, 1)
    assert holed.size == np.isfinite(x).sum()


def test_one_enormous_outlier_is_found_and_leaves_the_order():
    x = simulated((2, 1), 600, 7)
    before = select_order(even_record(x), 5, 5, criteria=("bic",)).best("bic")
    x[300] += 1e6
    record = even_record(x)
    rows = find_outliers(record)
    assert rows.tolist() == [300]
    after = select_order(without(record, rows), 5, 5, criteria=("bic",)).best("bic")
    assert (before.p, before.q) == (after.p, after.q)
    spoiled = select_order(record, 5, 5, criteria=("bic",)).best("bic")
    assert (spoiled.p, spoiled.q) != (before.p, before.q)


@pytest.mark.parametrize("row", [0, 1, 599])
def test_an_outlier_at_the_ends_is_found(row):
    x = simulated((2, 1), 600, 7)
    x[row] -= 1e5
    assert find_outliers(even_record(x)).tolist() == [row]


def test_one_sample_off_a_constant_is_an_outlier():
    x = np.full(300, 2.0)
    x[40] = 1e9
    record = even_record(x)
    with pytest.raises(FitError, match="constant"):
        select_order(without(record, find_outliers(record)))


def test_a_large_mean_changes_nothing():
    x = simulated((2, 1), 800, 3)
    near, far = (select_order(even_record(x + mean), 4, 4).best("bic") for mean in (0.0, 1e9))
    assert (near.p, near.q) == (far.p, far.q)
    assert near.deviance == pytest.approx(far.deviance, abs=1e-3)


@pytest.mark.slow
def test_smooth_and_exact_signals_do_not_break_the_search():
    t = np.arange(500)
    for x in (np.sin(0.3 * t), np.exp(0.01 * t), 1e12 + np.cumsum(np.cumsum(np.cos(t * t)))):
        assert np.isfinite(select_order(even_record(x)).best("bic").criteria.bic)


def test_clean_series_have_no_outliers():
    alarms = sum(
        find_outliers(even_record(simulated((2, 1), 500, seed))).size for seed in range(40)
    )
    assert alarms <= 2


def test_random_walks_are_told():
    limit = DICKEY_FULLER[0]
    walks = [np.cumsum(np.random.default_rng(s).standard_normal(500)) for s in range(20)]
    assert sum(unit_root_statistic(even_record(x)) > limit for x in walks) >= 17
    steady = [simulated((2, 1), 500, seed) for seed in range(20)]
    assert sum(unit_root_statistic(even_record(x)) < limit for x in steady) == 20
