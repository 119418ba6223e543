"""The test of linearity: its size on linear plants, its power on others; numpy and scipy alone."""

from __future__ import annotations

import numpy as np
import pytest
from reference.training import fitted, training
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.fitting.linearity import LinearityTest, linearity_test
from thermaltool.record import Record


def steps(rng, rows, shortest=8, longest=40):
    u, at = np.zeros(rows), 5
    while at < rows:
        u[at:] = rng.uniform(-1, 1)
        at += int(rng.integers(shortest, longest))
    return u


def lag(u, tau):
    pole = np.exp(-1 / tau)
    return lfilter([0, 1 - pole], [1, -pole], u)


def noisy(rng, y, share=0.05, colour=0.0):
    e = lfilter([np.sqrt(1 - colour**2)], [1, -colour], rng.standard_normal(len(y) + 300))[300:]
    return y + share * y.std() * e


def titration(rng, rows):
    """A strong acid and base: the pH is steep where they balance."""
    u = 0.6 * steps(rng, rows)
    return u, 7 + np.arcsinh(30 * lag(u, 10)) / 2


def hammerstein(rng, rows):
    u = steps(rng, rows)
    return u, lag(u + 0.6 * u**2, 8)


def exchanger(rng, rows):
    """What flows through it cools it: the rate depends on the flow."""
    u, x, y = 1 + 0.5 * steps(rng, rows), 1.0, np.zeros(rows)
    for k in range(rows):
        y[k] = x
        for _ in range(10):
            x += 0.1 * (0.15 * u[k] * (0.2 - x) + 0.1 * (2 - x))
    return u, y


def tank(rng, rows):
    """A stirred tank with an exothermic reaction (Arrhenius), its coolant stepped."""
    u = np.clip(5 * steps(rng, rows, 20, 80) - 3, -8, 2)
    u[:5], c, T, y = 0.0, 0.877, 324.5, np.zeros(rows)
    for k in range(rows):
        y[k] = T
        for _ in range(20):
            rate = 7.2e10 * np.exp(-8750 / T) * c
            c += 0.005 * (1 - c - rate)
            T += 0.005 * (350 - T + 209.2 * rate + 2.092 * (300 + u[k] - T))
    return u, y


def judged(u, y, orders=(2, 2, 1)):
    nb, nf, nk = orders
    data = training((u, y))
    m = len(np.atleast_2d(u))
    return linearity_test(fitted(data, "oe", (nb,) * m, nf, (nk,) * m), data)


@pytest.mark.parametrize("plant", [titration, hammerstein, exchanger, tank])
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_nonlinear_plants_are_named(plant, colour):
    rng = np.random.default_rng([1, int(10 * colour)])
    u, y = plant(rng, 1000)
    test = judged(u, noisy(rng, y, colour=colour))
    assert test.nonlinear
    assert test.nonlinear_fit_percent > test.linear_fit_percent + 1.5


def linear(seed):
    """A plant of one, two or four lags and coloured noise, all drawn."""
    rng = np.random.default_rng([2, seed])
    rows = int(rng.choice([400, 1000, 2000]))
    u = (steps(rng, rows), np.repeat(rng.choice([0.0, 1.0], rows), 12)[:rows],
         rng.standard_normal(rows), 40 + 9 * lag(rng.standard_normal(rows), 20))  # fmt: skip
    u = u[seed % 4]
    taus = np.exp(rng.uniform(np.log(2), np.log(rows / 20), rng.choice([1, 2, 4])))
    y = sum(rng.uniform(0.3, 1) * lag(u - u[0], tau) for tau in taus)
    return u, noisy(rng, y, float(rng.choice([0.02, 0.1, 0.4])), float(rng.choice([0, 0.8, 0.95])))


@pytest.mark.slow
def test_linear_plants_in_coloured_noise_are_not():
    """300 records, some of more lags than are fitted: of 5 % and 1 % not above the 99 % limit."""
    found = [judged(*linear(seed)) for seed in range(300)]
    assert np.mean([test.p_value < 0.05 for test in found]) < 0.082
    assert np.mean([test.p_value <= 0.01 for test in found]) < 0.027
    assert np.mean([test.nonlinear for test in found]) < 0.027


def between_rows(seed):
    """One lag; what steps it switches anywhere between the rows, and the log has its level."""
    rng = np.random.default_rng([7, seed])
    u = steps(rng, 30_000, 400, 2000)
    y = lag(u, 50 * rng.uniform(2, 20))
    return u[::50], noisy(
        rng, y[::50], float(rng.choice([0.003, 0.01])), float(rng.choice([0, 0.8]))
    )


@pytest.mark.slow
def test_switches_between_the_rows_are_no_nonlinearity(monkeypatch):
    """60 records; without their instants every second is called nonlinear."""
    logs = [between_rows(seed) for seed in range(60)]
    assert np.mean([judged(*log, (2, 2, 0)).nonlinear for log in logs]) < 0.1
    monkeypatch.setattr("thermaltool.fitting.error_regression.DECISIVE", np.inf)
    assert np.mean([judged(*log, (2, 2, 0)).nonlinear for log in logs]) > 0.4


@pytest.mark.parametrize("seed", range(4))
def test_a_linear_plant_is_linear(seed):
    assert not judged(*linear(seed)).nonlinear


def test_two_levels_tell_nothing_of_a_curve_before_the_dynamics():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([0.0, 2.0], 100), 10)
    test = judged(u, noisy(rng, lag(u**3, 8)))
    assert not test.nonlinear


def test_a_product_of_two_inputs_is_named():
    rng = np.random.default_rng(4)
    u = np.array([steps(rng, 1500), steps(rng, 1500)])
    test = judged(u, noisy(rng, lag(u[0] + u[1] + 0.8 * u[0] * u[1], 8)))
    assert test.nonlinear
    assert set(test.term.split()) == {"u0", "u1"}


def test_few_rows_are_not_tested():
    u, y = hammerstein(np.random.default_rng(5), 90)
    assert judged(u, noisy(np.random.default_rng(6), y), (1, 1, 1)) is None


@pytest.mark.slow
@pytest.mark.parametrize(("structure", "options"), [("oe", {"orders": [(1, 1, 1)]}),
                                                    ("network", {"modes": 1}),
                                                    ("subspace", {"modes": 1})])  # fmt: skip
def test_the_report_says_what_linear_models_reach(structure, options):
    rng = np.random.default_rng(7)
    u, y = hammerstein(rng, 800)
    log = Record(np.arange(800.0), {"Q_a_W": u, "T_a_degC": noisy(rng, y)}, name="log")
    found = tt.identify(log, "Q_a_W", "T_a_degC", structure=structure, **options)
    (model,) = found.document()["models"]
    assert model["linearity"]["nonlinear"]
    assert model["linearity"]["term"] == "Q_a_W^2"
    size = model["linearity"]["rms"]
    reached = f"linear models reach {model['linearity']['linear_fit_percent']:.3g} %"
    (note,) = (each for each in found.notes if each.startswith("T_a_degC: nonlinear by "))
    assert f"by {size:.2g} °C RMS, " in note
    assert reached in note
    assert "linearity of T_a_degC: nonlinear (p 0.01), by " in found.table()
    # What the products and powers take off the error, in the unit of the output.
    left = [1 - model["linearity"][f"{kind}_fit_percent"] / 100 for kind in ("linear", "nonlinear")]
    assert size == pytest.approx(np.sqrt(left[0] ** 2 - left[1] ** 2) * np.std(y), rel=0.1)


@pytest.mark.parametrize(
    ("linear", "whole", "matters"),
    [
        (99.55, 99.9, False),  # above what is left, but 0.4 % of what the output moves
        (99.4, 99.9, True),  # far above what is left, and more than half a per cent
        (97.6, 97.8, False),  # a per cent, below what is left
        (90.0, 92.0, True),  # six per cent
    ],
)
def test_what_is_not_linear_is_headlined_where_it_matters(linear, whole, matters):
    test = LinearityTest(0.01, 0.5, linear, whole, "Q_a_W^2", 10.0)
    assert test.nonlinear
    assert test.matters == matters
