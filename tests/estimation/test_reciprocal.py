"""Inverse transfer functions: times the response they are the filter, or they are refused."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.estimation.rational import inverted
from thermaltool.responses.rational import (
    Oscillation,
    Oscillation1,
    Rational1,
    Rational2,
    Rational3,
    Rational4,
    Rational10,
)

S = 1j * np.geomspace(1e-6, 1.0, 40)
RESPONSES = {
    "one lag": Rational1(2.0, 900.0),
    "two lags": Rational2(-2.0, 900.0, -1.0, 5000.0),
    "lags of opposite sign": Rational3(1.0, 300.0, 2.0, 2000.0, -0.5, 9000.0),
    "no zero, falling off twice": Rational2(2.0, 900.0, -2.0 * 5000.0 / 900.0, 5000.0),
    "a zero at the filter's pole": Rational2(1.0, 40.0, 1.0, 200.0),
    "four lags": Rational4(1.0, 9e3, 1.0, 2e3, 1.0, 300.0, 1.0, 40.0),
    "oscillation": Oscillation(1.0, 0.1, 0.002, 0.4),
    "complex zeros": Oscillation1(0.5, 0.1, 0.002, 0.4, 1.0, 900.0),
}


@pytest.mark.parametrize("name", RESPONSES)
def test_inverse_times_response_is_the_filter(name):
    response = RESPONSES[name]
    found = inverted(response, 120.0)
    lags = np.array(found.filter_lags)
    np.testing.assert_allclose(lags, 120.0 / 2.0 ** np.arange(len(lags)), rtol=0.011)
    wanted = np.prod([1 / (lag * S + 1) for lag in lags], axis=0)
    got = found.response.transfer(S) * response.transfer(S)
    np.testing.assert_allclose(got, wanted, rtol=1e-8)
    assert np.all(found.response.modes(1.0).poles.real < 0)
    for zero in found.zeros:
        assert abs(response.transfer(np.array([zero]))[0]) < 1e-6 * abs(response.dc_gain())


def test_a_zero_on_a_lag_of_the_filter_moves_the_lag():
    response = RESPONSES["a zero at the filter's pole"]
    (zero,) = (z.real for z in inverted(response, 5.0).zeros)
    assert inverted(response, -1 / zero).filter_lags[0] == pytest.approx(-0.99 / zero)


TEN_LAGS = Rational10(**{f"K{k}": 1.0 for k in range(1, 11)},
                      **{f"tau{k}": 2e4 / 2.0**k for k in range(1, 11)})  # fmt: skip


@pytest.mark.parametrize(
    ("response", "message"),
    [
        (Rational2(1.0, 300.0, -0.4, 20.0), r"zeros at 0\.006 1/s in the right half-plane"),
        (Oscillation(1.0, -0.5, 0.01, 0.5), r"zeros at 0\.02 1/s"),
        (Rational2(1.0, 300.0, -1.0, 20.0), "zeros at"),
        (Rational2(1.0, 300.0, 1.0, 20.0, 45.0), "delay has no causal inverse: 45 s"),
        (Rational1(0.0, 300.0), "a response of zero"),
        (TEN_LAGS, "11 lags and 0 oscillations"),
    ],
)
def test_what_has_no_stable_inverse_is_refused_with_the_reason(response, message):
    with pytest.raises(ModelError, match=message):
        inverted(response, 120.0)
