"""A search that is ended keeps the best of what it has tried."""

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.fitting import selection
from thermaltool.fitting.search_budget import SearchBudget

STRUCTURES = ["oe", "network", "subspace"]


def machine():
    rng = np.random.default_rng(5)
    power = np.repeat(rng.uniform(0, 1, 20), 20)
    x, y = np.zeros(2), []
    for p in power:
        y.append(x.sum())
        for _ in range(50):
            x = x + (np.array([30.0, 10.0]) * p - x) / np.array([150.0, 40.0]) / 10
    noisy = np.array(y) + rng.normal(0, 0.1, len(y))
    time = 5.0 * np.arange(len(y))
    return pd.DataFrame({"time_s": time, "Q_main_W": power, "d_x_um": noisy, "d_y_um": 2 * noisy})


@pytest.mark.slow
@pytest.mark.parametrize("structure", STRUCTURES)
def test_without_time_the_first_candidate_is_fitted(structure):
    said = []
    found = tt.identify(machine(), ["Q_main_W"], ["d_x_um", "d_y_um"], structure=structure,
                        budget=1e-9, warn=said.append)  # fmt: skip
    assert all(len(fit.candidates) == 1 for fit in found.fits)
    assert said[-1].startswith("the choice was ended: the best of")


@pytest.mark.slow
@pytest.mark.parametrize("structure", STRUCTURES)
def test_an_interrupt_ends_the_choice(structure, monkeypatch):
    class Interrupted(SearchBudget):
        def count(self):
            super().count()
            if self.tried == 2:
                self.interrupt()

    monkeypatch.setattr("thermaltool.fitting.search_budget.SearchBudget", Interrupted)
    said = []
    found = tt.identify(machine(), ["Q_main_W"], ["d_x_um"], structure=structure, warn=said.append)
    assert len(found.fits[0].candidates) == 2
    assert "the best of 2 candidates" in said[-1]


def test_a_keyboard_interrupt_keeps_what_was_found():
    tried = []

    def fit(order, data):
        tried.append(order)
        if order == 3:
            raise KeyboardInterrupt
        return Level(float(order))

    class Level:
        parameters = 1

        def __init__(self, value):
            self.value = value

        def carried_on(self, split):
            return np.full(split.held.rows, self.value)

    from thermaltool.fitting.data import training_data
    from thermaltool.logs import read_log

    data = training_data([read_log(machine())], ["Q_main_W"], ["d_x_um"])
    budget = SearchBudget()
    ranked = selection.rank(range(1, 9), fit, data.split(0.6), "none", budget)
    assert tried == [1, 2, 3]
    assert len(ranked) == 2
    assert budget.ended
    with pytest.raises(KeyboardInterrupt):
        selection.rank([3, 4], fit, data.split(0.6), "none", SearchBudget())


def test_every_output_gets_its_share():
    now = [0.0]
    budget = SearchBudget(60.0, now=lambda: now[0])
    budget.begin(3)
    now[0] = 19.0
    assert not budget.is_over
    now[0] = 21.0
    assert budget.is_over
    budget.begin(2)
    now[0] = 40.0
    assert not budget.is_over
    now[0] = 61.0
    assert budget.is_over
