"""Deconvolution against dense matrices, and on a wall that shares no code with the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.wall import Wall
from scipy.linalg import toeplitz
from scipy.optimize import lsq_linear

from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.estimation import deconvolution
from thermaltool.estimation.constrained import Bounds, ConstrainedProblem, SplitState
from thermaltool.estimation.deconvolution import METHODS, DeconvolutionPlan, deconvolve
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.function_specification import FunctionSpecification
from thermaltool.estimation.penalties import HeatProblem
from thermaltool.estimation.tikhonov import tikhonov, tikhonov_path
from thermaltool.responses.modes import Modes

DT, LEVEL, WHITE = 4.0, 10.0, 0.05


def lag(time_constants, gain=3.0):
    rate = 1 / np.asarray(time_constants, float)
    return Modes(-rate.astype(complex), (gain * rate / len(rate)).astype(complex))


def machine(sensors=1, drift=0.0):
    slow = [20.0, 90.0, 400.0]
    return KalmanEstimator(
        tuple(f"dT_{k}_K" for k in range(sensors)),
        ("Q_motor_W",),
        ("d_x_um",),
        tuple((k, 0, lag(np.array(slow) * (1 + 0.3 * k))) for k in range(sensors)),
        ((0, 0, lag([200.0], 10.0)),),
        (1.0,),
        (SensorNoise(WHITE, drift, 300.0),) * sensors,
    )


def problem_of(sensors=1, drift=0.0):
    return HeatProblem(machine(sensors, drift), DT, LEVEL)


def matrices(problem, rows, order):
    """A, the differences L and the covariance of the noise, written out."""
    impulse = problem.simulated(np.eye(rows)[0])
    A = np.vstack([np.tril(toeplitz(column)) for column in impulse.T])
    L = np.eye(rows)
    for _ in range(order):
        L = L - np.eye(rows, k=-1) @ L
    noise = problem.estimator.noise[0]
    stays = np.exp(-DT * np.arange(rows) / noise.drift_time)
    one = noise.white**2 * np.eye(rows) + noise.drift**2 * toeplitz(stays)
    return A, L, np.kron(np.eye(impulse.shape[1]), one)


def readings_of(problem, rows, seed=1):
    generator = np.random.default_rng(seed)
    heat = np.zeros(rows)
    for start in range(10, rows, 40):
        heat[start : start + 25] = LEVEL * generator.uniform(0.2, 1.0)
    clean = problem.simulated(heat)
    return heat, clean + WHITE * generator.standard_normal(clean.shape)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(("sensors", "drift"), [(1, 0.0), (1, 0.1), (2, 0.1)])
def test_a_smoother_is_tikhonovs_solution(order, sensors, drift):
    problem, rows, weight = problem_of(sensors, drift), 120, 300.0
    _, readings = readings_of(problem, rows)
    A, L, noise = matrices(problem, rows, order)
    y = readings.T.ravel()
    whole = A.T @ np.linalg.solve(noise, A) + weight / LEVEL**2 * L.T @ L
    expected = np.linalg.solve(whole, A.T @ np.linalg.solve(noise, y))
    smoother = EvenSmoother(*problem.space(order, weight), rows)
    heat, squares = smoother.run(readings)
    assert heat[:, 0] == pytest.approx(expected, abs=1e-4 * LEVEL)
    reach = A @ np.linalg.inv(L)
    covariance = noise + LEVEL**2 / weight * reach @ reach.T
    assert squares == pytest.approx(y @ np.linalg.solve(covariance, y), rel=1e-5)
    assert smoother.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-3)
    assert problem.misfit(readings) == pytest.approx(y @ np.linalg.solve(noise, y), rel=1e-8)


@pytest.mark.parametrize("drift", [0.0, 0.1])
def test_misfit_penalty_and_freedom_come_from_two_curves(drift):
    problem, rows = problem_of(1, drift), 150
    _, readings = readings_of(problem, rows)
    path = tikhonov_path(problem, readings, 1).path
    A, L, noise = matrices(problem, rows, 1)
    for k in range(2, len(path.parameter) - 2):
        weight = path.parameter[k] / LEVEL**2
        hat = A @ np.linalg.solve(
            A.T @ np.linalg.solve(noise, A) + weight * L.T @ L, A.T @ np.linalg.inv(noise)
        )
        assert path.freedom[k] == pytest.approx(np.trace(hat), rel=0.03)
        heat = path.solutions[k]
        assert path.misfit[k] == pytest.approx(
            problem.misfit(readings - problem.simulated(heat)), rel=0.05
        )
        assert path.penalty[k] == pytest.approx(np.sum((L @ heat / LEVEL) ** 2), rel=0.05)


def test_bounds_are_those_of_a_dense_solver():
    problem, rows, weight = problem_of(), 150, 300.0
    _, readings = readings_of(problem, rows)
    A, L, _ = matrices(problem, rows, 1)
    whole = np.vstack([A / WHITE, np.sqrt(weight) / LEVEL * L])
    y = np.concatenate([readings[:, 0] / WHITE, np.zeros(rows)])
    expected = lsq_linear(whole, y, (0.0, 7.0), tol=1e-12).x
    free = tikhonov(problem, readings, 1, weight)
    assert free.min() < -0.1
    bounds = Bounds(0.0, 7.0)
    search = ConstrainedProblem(problem, readings, 1, weight, 0.3, bounds)
    heat, converged = search.solve(0.0, SplitState.of(free, LEVEL, bounds))
    assert converged
    assert heat == pytest.approx(expected, abs=0.02)


def test_total_variation_leaves_no_way_down():
    problem, rows, weight = problem_of(), 150, 60.0
    _, readings = readings_of(problem, rows)
    search = ConstrainedProblem(problem, readings, None, 300.0, 0.3, Bounds())
    heat, converged = search.solve(weight, SplitState.of(np.zeros(rows), LEVEL, Bounds()))
    assert converged
    # Optimal where the misfit's slope along each step of the heat is within the weight.
    A, L, _ = matrices(problem, rows, 1)
    residual = (readings - problem.simulated(heat))[:, 0] / WHITE**2
    slope = LEVEL * np.linalg.solve(L.T, A.T @ residual)
    assert np.max(np.abs(slope)) < 1.1 * weight


@pytest.mark.slow
def test_a_heat_that_steps_is_best_met_by_total_variation():
    wall, dt, rows, level, white = Wall(thickness=0.006), 1.0, 600, 40e3, 0.15
    A, b, c = wall.matrices()
    rates, vectors = np.linalg.eigh(A)
    slow = np.argsort(-rates)[:8]
    weights = ((c @ vectors) * (vectors.T @ b))[slow]
    modes = Modes(rates[slow].astype(complex), weights.astype(complex))
    kalman = KalmanEstimator(
        ("T_back_degC",), ("q_W",), (), ((0, 0, modes),), (), (1.0,), (SensorNoise(white),)
    )
    heat = np.zeros(rows)
    heat[50:200], heat[200:300], heat[400:500] = 30e3, 12e3, 20e3
    noise = white * np.random.default_rng(3).standard_normal(rows)
    readings = (wall.back_face(heat, dt) + noise)[:, None]
    error = {}
    for method in METHODS:
        found = deconvolve(kalman, np.arange(rows), readings, level, DeconvolutionPlan(method))
        error[method] = float(np.sqrt(np.mean((found.heat - heat) ** 2))) / level
        assert found.choices[0].rule == "likelihood"
        if found.choices[0].expected_error and method == "tikhonov1":
            assert found.choices[0].expected_error / level == pytest.approx(error[method], rel=0.5)
    assert error["tv"] < 0.6 * error["tikhonov1"]
    assert error["tikhonov1"] < 0.08
    assert error["beck"] < 0.12


def test_steps_that_are_known_are_no_error():
    problem, rows, weight = problem_of(2, 0.1), 300, 50.0
    heat, readings = readings_of(problem, rows)
    smoother = EvenSmoother(*problem.space(1, weight), rows, (problem.estimator.modal,))
    shocks = np.diff(heat + 2.0, prepend=0.0)[:, None]
    away, _ = smoother.run(readings - problem.simulated(heat + 2.0))
    known, _ = smoother.run(readings, shocks)
    np.testing.assert_allclose(known[:, 0], heat + 2.0 + away[:, 0], rtol=0, atol=1e-8 * LEVEL)


@pytest.mark.slow
@pytest.mark.parametrize("begins", [0, 700])
def test_total_variation_of_a_long_record_is_scouted_where_its_heat_is(begins, monkeypatch):
    problem, rows = problem_of(), 1000
    heat = np.concatenate([np.zeros(begins), readings_of(problem, rows - begins)[0]])
    clean = problem.simulated(heat)
    readings = clean + WHITE * np.random.default_rng(8).standard_normal(clean.shape)
    plan, time = DeconvolutionPlan("tv"), DT * np.arange(rows)

    tried, own = [], deconvolution.ConstrainedProblem

    def counted(held, seen, *others):
        tried.append(len(seen))
        return own(held, seen, *others)

    monkeypatch.setattr(deconvolution, "ConstrainedProblem", counted)

    def found(most):
        monkeypatch.setattr(deconvolution, "SCOUTED_ROWS", most)
        return deconvolve(problem.estimator, time, readings, LEVEL, plan)

    whole, scouted = found(rows), found(250)
    # Where the heat begins late its part of the changes takes most of the rows.
    least = min(tried)
    assert 250 <= least < (300 if begins == 0 else rows)
    errors = [np.sqrt(np.mean((each.heat - heat) ** 2)) for each in (whole, scouted)]
    assert errors[1] < 1.1 * errors[0]
    # Of a heat that is late all rows are scouted but a few: the rules say nearly the same.
    assert scouted.parameter == whole.parameter


@pytest.mark.slow
def test_bounds_of_every_method_hold():
    problem = problem_of()
    _, readings = readings_of(problem, 100)
    time = DT * np.arange(100)
    for method in METHODS:
        plan = DeconvolutionPlan(method, None, 1.0, 6.0)
        found = deconvolve(problem.estimator, time, readings, LEVEL, plan)
        assert (found.heat.min() >= 1.0, found.heat.max() <= 6.0) == (True, True)
        misfit = problem.misfit(readings - problem.simulated(found.heat))
        assert found.residual_over_noise == pytest.approx(np.sqrt(misfit / readings.size))
        told = f"the bounds leave residuals of {found.residual_over_noise:.3g} times the noise"
        assert (told in found.notes) == (found.residual_over_noise > 2)
        doubled = deconvolve(problem.estimator, time, readings, LEVEL, plan, lambda end: end / 2)
        assert doubled.heat.max() <= 3.0


@pytest.mark.parametrize("method", ["tv", "beck"])
def test_what_is_told_of_the_rule_is_the_result(method):
    problem = problem_of()
    _, readings = readings_of(problem, 100)
    plan = DeconvolutionPlan(method, "discrepancy")
    found = deconvolve(problem.estimator, DT * np.arange(100), readings, LEVEL, plan)
    taken = next(each for each in found.choices if each.rule == found.chosen)
    assert taken.parameter == pytest.approx(found.parameter)
    assert taken.residual_over_noise == pytest.approx(found.residual_over_noise)
    assert found.notes == ()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tikhonov1", "tv"])
def test_residuals_that_no_heat_explains_are_told(method):
    problem, rows = problem_of(2), 300
    _, readings = readings_of(problem, rows)
    time, stuck = DT * np.arange(rows), readings.copy()
    stuck[100:, 1] = stuck[100, 1]
    plan = DeconvolutionPlan(method)
    told = deconvolve(problem.estimator, time, stuck, LEVEL, plan).notes
    assert any("times the noise: model and machine have parted" in each for each in told)
    assert not deconvolve(problem.estimator, time, readings, LEVEL, plan).notes


def test_beck_fits_the_next_rows():
    problem = problem_of()
    heat, _ = readings_of(problem, 120)
    clean = problem.simulated(heat)
    exact = FunctionSpecification(problem, 1).run(clean)
    assert exact[:-1] == pytest.approx(heat[:-1], abs=1e-6)
    held = FunctionSpecification(problem, 5).run(clean, -100.0, 100.0)
    assert held == pytest.approx(FunctionSpecification(problem, 5).run(clean), abs=1e-9)


def test_future_rows_that_are_given():
    problem = problem_of()
    _, readings = readings_of(problem, 120)
    time = DT * np.arange(120)
    found = deconvolve(
        problem.estimator, time, readings, LEVEL, DeconvolutionPlan("beck", future=4)
    )
    assert (found.parameter, found.choices, found.chosen) == (4, (), None)
    with pytest.raises(LogError, match="61 future rows are more than half of the record's 120"):
        deconvolve(problem.estimator, time, readings, LEVEL, DeconvolutionPlan("beck", future=61))


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ({"method": "magic"}, "no method 'magic'; there are tikhonov0"),
        ({"method": "tv", "rule": "luck"}, "no rule 'luck'; there are likelihood"),
        ({"method": "tv", "low": 5.0, "high": 5.0}, "bounds from 5 to 5 leave no heat"),
        ({"method": "tv", "future": 3}, "future rows go with the method beck"),
        ({"method": "beck", "future": 0}, "0 future rows are none"),
        ({"method": "beck", "future": 3, "rule": "gcv"}, "nothing for a rule to choose"),
    ],
)
def test_plans_that_cannot_be(plan, message):
    with pytest.raises(ValueError, match=message):
        DeconvolutionPlan(**plan)


@pytest.mark.slow
def test_what_is_refused():
    problem, plan = problem_of(), DeconvolutionPlan("tikhonov1")
    _, readings = readings_of(problem, 120)
    time = DT * np.arange(120)

    def tried(kalman=problem.estimator, time=time, readings=readings, plan=plan):
        return deconvolve(kalman, time, readings, LEVEL, plan)

    late = np.where(time > 200, time + 3.0, time)
    with pytest.raises(LogError, match=r"uneven: a sample of 7 s at 200 s, where 4 s is usual"):
        tried(time=late)
    dead = readings.copy()
    dead[50:60] = np.nan
    with pytest.raises(LogError, match=r"dT_0_K has no reading in 10 rows, from 200 s on"):
        tried(readings=dead)
    with pytest.raises(LogError, match="12 rows: too few for --method"):
        tried(time=time[:12], readings=readings[:12])
    two = replace(problem.estimator, drives=("Q_a_W", "Q_b_W"), walk=(1.0, 1.0))
    with pytest.raises(ModelError, match=r"2 are estimated \(Q_a_W, Q_b_W\): --smooth"):
        tried(kalman=two)
    with pytest.raises(FitError, match="every reading is zero"):
        tried(readings=0 * readings)
    deaf = replace(problem.estimator, noise=(SensorNoise(1e9),))
    with pytest.raises(FitError, match="the readings tell nothing of the heat"):
        tried(kalman=deaf)
    for method in METHODS:
        with pytest.raises(FitError, match="--rule discrepancy: the residuals"):
            tried(readings=readings / 1e4, plan=DeconvolutionPlan(method, "discrepancy"))
