"""Estimators of responses with tens of close modes, beside a plate of finite volumes."""

from __future__ import annotations

import numpy as np
import pytest
from machines.ring_plate import RingPlate

from thermaltool.estimation.balanced import balanced
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.design import DesignPlan, design_estimator
from thermaltool.estimation.design_model import MAX_LEFT_OUT, DesignModel
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.fixed_lag import error_variance
from thermaltool.estimation.kernel import Regularization
from thermaltool.estimation.smoother import smooth
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.modes import Modes
from thermaltool.responses.slab import Slab

PLATE = {"K": 3.372, "a": 3.2, "alpha": 0.000212}
DT, ROWS = 2.0, 600


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize(
    "response",
    [Conduction(**PLATE, r=0.19), Conduction(**PLATE, r=0.5), Slab(2.0, 300.0, 0.1, 0.3, 0.98)],
    ids=["near", "far", "slab"],
)
def test_what_is_left_out_is_less_than_its_bound(response, tolerance):
    modes = lagged_modes(response.modes(DT), 7.0)
    gain = modes.dc_gain()
    kept, bound = balanced(modes, tolerance * gain)
    assert kept.states < 0.75 * modes.states
    assert 0 < bound <= tolerance * gain
    assert np.all(kept.poles.real < 0)
    rounding = 1e-11 * gain
    s = 1j * np.geomspace(1e-6, 10.0, 300)
    assert np.max(np.abs(kept.transfer(s) - modes.transfer(s))) <= bound + rounding


def test_rates_that_meet_are_one():
    rates = np.concatenate([np.geomspace(1e-3, 1.0, 20), np.geomspace(1e-3, 1.0, 20)[[4, 9]]])
    modes = Modes(-rates + 0j, rates + 0j)
    kept, bound = balanced(modes, 1e-6 * modes.dc_gain())
    assert kept.dc_gain() == pytest.approx(modes.dc_gain(), abs=1.001 * bound)
    assert kept.states < 20


def test_other_modes_are_left_as_they_are():
    few = Modes(np.array([-1.0, -0.1]) + 0j, np.ones(2) + 0j)
    rates = np.geomspace(1e-3, 1.0, 20)
    swings = Modes(np.append(-rates + 0j, -1 + 1j), np.ones(21) + 0j)
    twice = Modes(-rates + 0j, np.ones(20) + 0j, np.ones(20))
    direct = Modes(-rates + 0j, np.ones(20) + 0j, direct=1.0)
    integral = Modes(np.append(-rates, 0.0) + 0j, np.ones(21) + 0j)
    for modes in (few, swings, twice, direct, integral):
        assert balanced(modes, 1.0) == (modes, 0.0)


def problem(white, response):
    bend = Deflection(A=10.5, a=5.9e-4, B=67.0, b=9.1e-4, D=-0.04, d=0.0044)
    model = Model(
        (Drive("Q_a_W", "zero", 0.0, (0.0, 100.0)),),
        (Output("dT_K", "sensor", 0.0, (0.0, 9.0)), Output("d_x_um", "deflection", 0.0, (0, 80.0))),
        (Term("Q_a_W", "dT_K", response), Term("Q_a_W", "d_x_um", bend)),
        DT,
    )
    return model, DesignModel.of(model, {"dT_K": SensorNoise(white)}, DT)


def variances(kalman, readings):
    """Of the heat, by the smoother for any clock, by that for an even one, and by a long lag."""
    time = DT * np.arange(ROWS)
    found = smooth(kalman, time, readings, (1.0,))
    space = kalman.state_space(DT)
    even = EvenSmoother(space, kalman.start_covariance(DT, (1.0,), "rest"), ROWS)
    lagged = error_variance(kalman, kalman, DT, ROWS // 2)[-1, 0]
    middle = found.sigma[ROWS // 2, 0] ** 2, even.variance[0], lagged
    return found, even.run(readings)[0], np.array(middle)


def test_bands_beside_a_plate_of_finite_volumes():
    white, walk = 5e-4, 2.0
    _, machine = problem(white, Conduction(**PLATE, r=0.19))
    kalman = machine.kalman((walk,))
    assert machine.sensed[0][2].states > 35
    assert kalman.sensed[0][2].states < 30
    generator = np.random.default_rng(40)
    impulse = np.diff(RingPlate(**PLATE).step(0.19, DT * np.arange(ROWS)), prepend=0.0)
    inside, squares = [], []
    for _ in range(8):
        heat = walk * np.sqrt(DT) * np.cumsum(generator.normal(size=ROWS))
        clean = np.convolve(impulse, heat)[:ROWS, None]
        readings = clean + white * generator.normal(size=(ROWS, 1))
        found, even, variance = variances(kalman, readings)
        np.testing.assert_allclose(variance, variance[0], rtol=2e-3)
        away = (np.column_stack([found.estimates[:, 0], even[:, 0]]) - heat[:, None])[20:-20]
        inside.append(np.abs(away[:, 0]) < 1.96 * found.sigma[20:-20, 0])
        squares.append(np.mean(away**2, axis=0) / variance[0])
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    np.testing.assert_allclose(np.mean(squares, axis=0), 1.0, rtol=0.08)


def test_all_modes_at_once_are_rounding():
    _, machine = problem(5e-4, Conduction(**PLATE, r=0.19))
    kept = machine.kalman((2.0,))
    every = KalmanEstimator(
        kept.sensors, kept.drives, kept.outputs, machine.sensed, machine.followed,
        kept.walk, kept.noise,
    )  # fmt: skip
    readings = np.zeros((ROWS, 1))
    exact = variances(kept, readings)[2]
    assert np.max(np.abs(variances(every, readings)[2] / exact - 1)) > 0.5


def test_a_design_says_what_it_has_left_out():
    model, machine = problem(0.02, Conduction(**PLATE, r=0.19))
    design = design_estimator(model, machine, DesignPlan("kalman", walk=0.02))
    assert 0 < design.model.design["left_out"] <= MAX_LEFT_OUT
    # Two sensors of one drive at other noise keep other states; a kernel inverts them all.
    fine = problem(1e-4, Conduction(**PLATE, r=0.19))[1].kalman((1.0,))
    assert fine.sensed[0][2].states > machine.kalman((1.0,)).sensed[0][2].states
    kernel = machine.kernel(Regularization(0.2, 0.02, 0.1), 0.1, 0.0)
    assert kernel.inverse.states > 35
