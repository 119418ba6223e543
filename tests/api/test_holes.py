"""Readings that are missing from an output, here and there or for long, leave a record whole."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.fitting.error_model import ar_error_model

pytestmark = pytest.mark.filterwarnings("ignore::thermaltool.errors.ThermalToolWarning")
GAIN, ROWS = 6.0, 1200


def log_of(rng, missing, noise=0.05):
    """Two lags in a row by Euler's rule, noise as a share, and the output without it."""
    power = np.repeat(rng.uniform(0, 1, ROWS // 20), 20)
    power[:20] = 0.0
    state, clean = np.zeros(2), np.empty(ROWS)
    for k, p in enumerate(power):
        clean[k] = state[1]
        for _ in range(20):
            rate = np.array([(GAIN * p - state[0]) / 30.0, (state[0] - state[1]) / 6.0])
            state = state + rate / 20
    y = clean + noise * clean.std() * rng.standard_normal(ROWS)
    y[missing] = np.nan
    return pd.DataFrame({"time_s": np.arange(ROWS), "Q_main_W": power, "dT_y_K": y}), clean


def scattered(rng, share=0.3):
    return rng.uniform(size=ROWS) < share


def sparse(rng):
    return scattered(rng, 0.1)


def outage(rng):
    return slice(400, 700)


# Where three readings in ten are missing, few rows have all the lags that armax begins with.
@pytest.mark.parametrize(
    ("structure", "holes"),
    [
        ("oe", scattered),
        ("oe", outage),
        ("bj", outage),
        pytest.param("bj", scattered, marks=pytest.mark.slow),
        *product(("arx", "armax"), (sparse, outage)),
    ],
)
def test_the_gain_is_found_over_holes(structure, holes):
    rng = np.random.default_rng(20261124)
    # Errors of the output are none of the equation, and bias what is found by it.
    log, clean = log_of(rng, holes(rng), 0.05 if structure in ("oe", "bj") else 1e-5)
    found = tt.identify(log, ["Q_main_W"], ["dT_y_K"], structure=structure, orders=[(2, 2, 1)],
                        nan_policy="omit")  # fmt: skip
    run = tt.simulate(found.model, log.assign(dT_y_K=clean))
    assert found.model.terms[0].response.dc_gain() == pytest.approx(GAIN, rel=0.1)
    assert run.agreements["dT_y_K"].fit_percent > 97


@pytest.mark.slow
def test_orders_are_chosen_over_holes():
    rng = np.random.default_rng(20261124)
    log, clean = log_of(rng, scattered(rng))
    found = tt.identify(log, ["Q_main_W"], ["dT_y_K"], structure="oe", nan_policy="omit")
    run = tt.simulate(found.model, log.assign(dT_y_K=clean))
    assert run.agreements["dT_y_K"].fit_percent > 97


def test_one_reading_in_ten_is_enough():
    rng = np.random.default_rng(20261124)
    log, _ = log_of(rng, np.arange(ROWS) % 10 > 0)
    found = tt.identify(log, ["Q_main_W"], ["dT_y_K"], structure="oe", orders=[(1, 1, 1)],
                        nan_policy="omit")  # fmt: skip
    assert found.fits[0].model.rows == pytest.approx(ROWS / 10, abs=2)
    assert found.model.terms[0].response.dc_gain() == pytest.approx(GAIN, rel=0.15)


def test_the_colour_of_errors_is_seen_through_holes():
    rng = np.random.default_rng(20261124)
    errors = lfilter([1.0], [1.0, -0.8], rng.standard_normal(4000))
    errors[rng.uniform(size=4000) < 0.4] = np.nan
    ar, variance = ar_error_model([errors])
    # By the power and the correlation of neighbours: the order is the fit's own choice.
    impulse = lfilter([1.0], ar, np.eye(1, 400)[0])
    power = impulse @ impulse
    assert impulse[1:] @ impulse[:-1] / power == pytest.approx(0.8, abs=0.15)
    assert variance * power == pytest.approx(1 / (1 - 0.8**2), rel=0.3)


@pytest.mark.parametrize(("structure", "said"), [("oe", False), ("arx", True), ("subspace", False)])
def test_what_holes_cost_is_said_where_they_do(structure, said):
    rng = np.random.default_rng(20261124)
    log, _ = log_of(rng, outage(rng))
    form = {"modes": 2} if structure == "subspace" else {"orders": [(2, 2, 1)]}
    messages: list[str] = []
    tt.identify(log, ["Q_main_W"], ["dT_y_K"], structure=structure, nan_policy="omit",
                warn=messages.append, **form)  # fmt: skip
    assert any("300 readings missing" in each for each in messages) == said
