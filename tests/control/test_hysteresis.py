"""Prandtl and Ishlinskii's operator and its inverse."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermaltool.control.hysteresis import PrandtlIshlinskii

R, W = (0.0, 1.0, 2.5, 4.0), (1.2, 0.4, 0.3, 0.1)
moves = st.lists(st.floats(-20, 20), min_size=1, max_size=40)


@given(moves)
def test_the_inverse_undoes_it(wanted):
    plant = PrandtlIshlinskii(R, W)
    inverse = PrandtlIshlinskii(R, W).inverse()
    for y in wanted:
        assert plant.take(inverse.take(y)) == pytest.approx(y, abs=1e-9)


@given(moves)
def test_the_inverse_of_the_inverse_is_the_operator(inputs):
    plant, again = PrandtlIshlinskii(R, W), PrandtlIshlinskii(R, W).inverse().inverse()
    for x in inputs:
        assert again.take(x) == pytest.approx(plant.take(x), abs=1e-9)


@given(moves, st.floats(-20, 20))
def test_a_look_ahead_leaves_the_state(inputs, x):
    plant = PrandtlIshlinskii(R, W)
    for each in inputs:
        plant.take(each)
    assert plant.value(x) == plant.value(x)
    assert plant.value(x) == pytest.approx(plant.take(x), abs=1e-12)


def test_a_loop_has_the_width_that_the_weights_say():
    plant = PrandtlIshlinskii(R, W)
    wave = 10 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    loop = np.array([plant.take(x) for x in wave])[2000:]
    at_zero = loop[[0, 1000, 2000]]
    # each play lags by its threshold: ±Σ w r
    np.testing.assert_allclose(
        np.abs(at_zero), sum(w * r for w, r in zip(W, R, strict=True)), atol=0.02
    )
    assert at_zero[0] * at_zero[1] < 0


def test_one_play_of_no_width_is_a_gain():
    plant = PrandtlIshlinskii([0.0], [2.0])
    assert [plant.take(x) for x in (1.0, -3.0)] == [2.0, -6.0]
    assert plant.inverse().take(-6.0) == -3.0


@pytest.mark.parametrize(
    ("thresholds", "weights", "message"),
    [
        ([], [], "0 thresholds"),
        ([0.0, 1.0], [1.0], "2 thresholds and 1 weights"),
        ([1.0], [1.0], "ascend from 0"),
        ([0.0, 1.0, 1.0], [1.0, 1.0, 1.0], "ascend from 0"),
        ([0.0, 1.0], [1.0, -1.0], "partial sum"),
        ([0.0, 1.0], [1.0, float("nan")], "partial sum"),
    ],
)
def test_what_has_no_inverse(thresholds, weights, message):
    with pytest.raises(ValueError, match=message):
        PrandtlIshlinskii(thresholds, weights)


def test_negative_weights_have_an_inverse_where_their_sums_are_positive():
    plant = PrandtlIshlinskii([0, 1], [1.0, -0.5])
    inverse = PrandtlIshlinskii([0, 1], [1.0, -0.5]).inverse()
    for y in itertools.chain([3.0, -2.0], np.linspace(-2, 5, 20), [0.0]):
        assert plant.take(inverse.take(float(y))) == pytest.approx(y, abs=1e-12)
