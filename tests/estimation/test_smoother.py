"""Smoothers against the joint normal distribution of all states, written out for a short record."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from machines.wall import Wall
from scipy.stats import multivariate_normal

from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.estimation import smoother
from thermaltool.estimation.bands import model_errors
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.fixed_lag import FixedLag, error_variance, fixed_lag
from thermaltool.estimation.likelihood import fit_sizes
from thermaltool.estimation.lookahead import _filtered_sigma
from thermaltool.estimation.smoother import smooth, smoothed_estimates
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import CLOCK_STEP

LEVEL = (2.0, 1.5)


def lag(time_constant, gain=1.0):
    rate = 1 / np.atleast_1d(time_constant)
    return Modes(-rate.astype(complex), (gain * rate / len(rate)).astype(complex))


def estimator(drives=2, walk=0.3):
    names = ("Q_a_W", "Q_b_W")[:drives]
    sensed = [(0, 0, lag([20.0, 90.0], 3.0)), (1, 0, lag(60.0))]
    if drives == 2:
        sensed += [(0, 1, lag(70.0, 0.5)), (1, 1, lag(15.0, 2.0))]
    return KalmanEstimator(
        ("dT_a_K", "dT_b_K"),
        names,
        ("d_x_um",),
        tuple(sensed),
        ((0, 0, lag(200.0, 10.0)),),
        (walk,) * drives,
        (SensorNoise(0.05, 0.1, 300.0), SensorNoise(0.08)),
    )


def clock(rows, even):
    steps = np.full(rows, 4.0)
    if not even:
        steps[5:9], steps[14] = 1.5, 60.0
    return np.cumsum(steps)


def dense(kalman, time, readings, initial):
    """Mean and variance of all estimates given all readings, and the readings' density."""
    n, dt = len(time), np.diff(time)
    level = LEVEL[: len(kalman.drives)]
    start = kalman.start_covariance(float(dt[0]), level, initial)
    states = len(start)
    joint = np.zeros((n * states, n * states))
    joint[:states, :states] = start
    spaces = [kalman.state_space(float(each)) for each in dt]
    for k, space in enumerate(spaces):
        now, then = k * states, (k + 1) * states
        joint[then : then + states, :then] = space.F @ joint[now:then, :then]
        joint[:then, then : then + states] = joint[then : then + states, :then].T
        corner = space.F @ joint[now:then, now:then] @ space.F.T + space.Q
        joint[then : then + states, then : then + states] = corner
    H = np.kron(np.eye(n), spaces[0].H)
    C = np.kron(np.eye(n), spaces[0].C)
    there = np.isfinite(readings).ravel()
    H, y = H[there], readings.ravel()[there]
    noise = np.kron(np.eye(n), spaces[0].R)[np.ix_(there, there)]
    S = H @ joint @ H.T + noise
    gain = np.linalg.solve(S, H @ joint).T
    mean, variance = C @ gain @ y, np.diag(C @ (joint - gain @ H @ joint) @ C.T)
    shape = n, len(kalman.estimates)
    return mean.reshape(shape), variance.reshape(shape), multivariate_normal(cov=S).logpdf(y)


@pytest.mark.parametrize("rows", [25, 700])
@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
def test_several_records_by_one_set_of_covariances(monkeypatch, rows, even):
    """Each is smoothed as alone: in short stretches, in long ones, and beside holes and steps."""
    kalman, time = estimator(), clock(rows, even)
    readings = np.cumsum(np.random.default_rng(22).normal(size=(3, rows, 2)), axis=1)
    readings[:, 8:12, 0] = np.nan
    readings[:, 17] = np.nan
    steps = np.zeros((rows, 2))
    steps[20, 1] = 4.0
    alone = [smooth(kalman, time, each, LEVEL, "settled", steps).estimates for each in readings]
    lengths = []
    plain = KalmanEstimator.state_space
    monkeypatch.setattr(KalmanEstimator, "state_space",
                        lambda self, dt: lengths.append(dt) or plain(self, dt))  # fmt: skip
    together = smoothed_estimates(kalman, time, readings, LEVEL, "settled", steps)
    assert together == pytest.approx(np.array(alone), rel=1e-9, abs=1e-9)
    # Matrices are made once for a length of sample, beside those of the start.
    assert len(lengths) <= len(set(lengths)) + 1


@pytest.mark.parametrize("initial", ["rest", "settled", "free"])
@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
def test_it_is_the_conditional_mean_with_its_variance(monkeypatch, initial, even):
    monkeypatch.setattr(smoother, "HELD_CHANGE", 0.0)
    generator = np.random.default_rng(20)
    time = clock(25, even)
    readings = np.cumsum(generator.normal(size=(25, 2)), axis=0)
    readings[8:12, 0] = np.nan
    readings[17] = np.nan
    mean, variance, density = dense(estimator(), time, readings, initial)
    found = smooth(estimator(), time, readings, LEVEL, initial)
    np.testing.assert_allclose(found.estimates, mean, atol=1e-8 * np.max(np.abs(mean)))
    np.testing.assert_allclose(found.sigma**2, variance, atol=1e-8 * np.max(variance))
    assert found.log_likelihood == pytest.approx(density, rel=1e-9)


def simulated(kalman, rows, generator, dt=4.0):
    """Readings and estimates of the very state space that the estimator has."""
    space = kalman.state_space(dt)
    process = np.sqrt(np.diag(space.Q))
    x, readings, truth = np.zeros(len(process)), [], []
    white = np.sqrt(np.diag(space.R))
    for _ in range(rows):
        readings.append(space.H @ x + white * generator.normal(size=len(white)))
        truth.append(space.C @ x)
        x = space.F @ x + process * generator.normal(size=len(x))
    return dt * np.arange(rows), np.array(readings), np.array(truth)


def warm_machine(generator, rows, before, dt=4.0):
    """Readings, heat and deflection of a machine that has worked before the first row: plain lags
    under heats that wander about zero, each held over a sample."""
    lags = [(0, 0, 20.0, 1.5), (0, 0, 90.0, 1.5), (0, 1, 70.0, 0.5),
            (1, 0, 60.0, 1.0), (1, 1, 15.0, 2.0), (2, 0, 200.0, 10.0)]  # fmt: skip
    keep = np.exp(-dt * 0.3**2 / (2 * np.square(LEVEL)))
    heat, parts = LEVEL * generator.normal(size=2), np.zeros(len(lags))
    heats, outputs = [], []
    for _ in range(before + rows):
        output = np.zeros(3)
        for part, (to, *_) in zip(parts, lags, strict=True):
            output[to] += part
        heats.append(heat)
        outputs.append(output)
        for k, (_, drive, time_constant, gain) in enumerate(lags):
            kept = np.exp(-dt / time_constant)
            parts[k] = kept * parts[k] + (1 - kept) * gain * heat[drive]
        heat = keep * heat + LEVEL * np.sqrt(1 - keep**2) * generator.normal(size=2)
    drift = 0.1 * generator.normal()
    readings = np.array(outputs)[before:, :2]
    for row in readings:
        row += [drift, 0.0] + generator.normal(size=2) * (0.05, 0.08)
        kept = np.exp(-dt / 300.0)
        drift = kept * drift + 0.1 * np.sqrt(1 - kept**2) * generator.normal()
    truth = np.column_stack([np.array(heats)[before:], np.array(outputs)[before:, 2]])
    return dt * np.arange(rows), readings, truth


@pytest.mark.slow
def test_bands_of_a_free_start_hold_where_the_machine_is_warm():
    generator = np.random.default_rng(31)
    inside = {"rest": [], "free": []}
    for _ in range(150):
        time, readings, truth = warm_machine(generator, 60, 500)
        for initial, each in inside.items():
            found = smooth(estimator(), time, readings, LEVEL, initial)
            each.append(np.abs(found.estimates - truth) < 1.96 * found.sigma)
    free = np.mean(inside["free"], axis=0)
    # The first rows, and those after the start has decayed; 150 draws are sure to 2 % at each.
    assert np.all(np.abs(np.mean(free[:5], axis=0) - 0.95) < 0.05)
    assert np.all(np.abs(np.mean(free, axis=0) - 0.95) < 0.03)
    assert np.mean(np.mean(inside["rest"], axis=0)[:5, 2]) < 0.2


def test_no_free_start_of_a_response_that_does_not_decay():
    still = replace(estimator(), followed=((0, 0, Modes(np.array([0j]), np.array([1 + 0j]))),))
    with pytest.raises(FitError, match="does not decay"):
        still.start_covariance(4.0, LEVEL, "free")


@pytest.mark.slow
def test_a_gain_that_is_held_costs_nothing_that_counts(monkeypatch):
    generator = np.random.default_rng(21)
    time, readings, _ = simulated(estimator(), 3000, generator)
    quick = smooth(estimator(), time, readings, LEVEL)
    monkeypatch.setattr(smoother, "HELD_CHANGE", 0.0)
    exact = smooth(estimator(), time, readings, LEVEL)
    error = np.abs(quick.estimates - exact.estimates)
    assert np.max(error[1:] / exact.sigma[1:]) < 0.01
    np.testing.assert_allclose(quick.sigma[1:], exact.sigma[1:], rtol=0.03)


@pytest.mark.slow
def test_its_bands_hold_and_its_innovations_are_white():
    generator = np.random.default_rng(22)
    inside, squares = [], []
    for _ in range(12):
        time, readings, truth = simulated(estimator(), 500, generator)
        found = smooth(estimator(), time, readings, (0.0, 0.0))
        inside.append(np.abs(found.estimates - truth)[1:] < 1.96 * found.sigma[1:])
        squares.append(np.mean(found.innovations**2))
    assert np.all(np.abs(np.mean(inside, axis=(0, 1)) - 0.95) < 0.02)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
def test_a_fixed_lag_in_batch_is_that_of_the_stream_over_a_restart(even):
    generator = np.random.default_rng(23)
    time = clock(60, even)
    readings = np.cumsum(generator.normal(size=(60, 2)), axis=0)
    batch = fixed_lag(estimator(), time, readings, 30.0)
    stream = FixedLag(estimator(), 30.0, 4.0)
    stream.start(readings[0])
    ticks = np.round(np.diff(time) / CLOCK_STEP).astype(int)
    for k, length in enumerate(ticks.tolist(), start=1):
        stream.step(length, readings[k])
        late = np.flatnonzero(time <= time[k] - 30.0 + 1e-9)
        latest = stream.latest_due()
        if latest is not None:
            np.testing.assert_array_equal(latest, batch[late[-1]])
        if k == 33:
            kept = json.loads(json.dumps(stream.state()))
            stream = FixedLag(estimator(), 30.0, 4.0)
            stream.resume(kept)


@pytest.mark.slow
def test_a_long_lag_is_the_whole_record():
    generator = np.random.default_rng(24)
    time, readings, _ = simulated(estimator(), 1500, generator)
    whole = smooth(estimator(), time, readings, LEVEL)
    long = fixed_lag(estimator(), time, readings, 2000.0)
    middle = slice(700, 900)
    assert np.max(np.abs(long - whole.estimates)[middle] / whole.sigma[middle]) < 0.01


def test_bands_of_late_estimates_hold_where_a_machine_leaves_rest():
    """Its deflection is known at the first row; the noise of later readings moves the estimate."""
    generator, kalman = np.random.default_rng(24), estimator()
    inside = []
    for _ in range(25):
        time, readings, truth = simulated(kalman, 30, generator)
        sigma = _filtered_sigma(kalman, kalman, time, LEVEL, "rest", 40.0)
        late = fixed_lag(kalman, time, readings, 40.0, False)
        inside.append(np.abs(late - truth)[:4] < 1.96 * sigma[:4])
    assert np.all(np.mean(inside, axis=(0, 1)) > 0.9)


def test_the_likelihood_finds_the_sizes_that_made_the_record():
    generator = np.random.default_rng(25)
    true = estimator(walk=0.3)
    time, readings, _ = simulated(true, 4000, generator)
    found = fit_sizes(estimator(walk=0.01), time, readings).estimator
    np.testing.assert_allclose(found.walk, true.walk, rtol=0.2)
    assert found.noise[0].white == pytest.approx(0.05, rel=0.1)
    pinned = fit_sizes(estimator(walk=0.3), time, readings, pinned=True).estimator
    assert pinned.walk == true.walk
    assert pinned.noise[0].white == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
def test_pauses_do_not_pass_for_noise():
    generator = np.random.default_rng(26)
    true = estimator(walk=0.3)
    time, readings, _ = simulated(true, 4000, generator)
    there = np.ones(4000, bool)
    for first in range(400, 4000, 450):
        there[first : first + 30] = False
    whole = fit_sizes(estimator(walk=0.01), time, readings).estimator
    parted = fit_sizes(estimator(walk=0.01), time[there], readings[there]).estimator
    np.testing.assert_allclose(parted.walk, whole.walk, rtol=0.15)
    for k in range(2):
        assert parted.noise[k].white == pytest.approx(whole.noise[k].white, rel=0.1)


def test_what_cannot_be_smoothed_says_so():
    with pytest.raises(LogError, match="too few to tell how fast"):
        fit_sizes(estimator(), np.arange(5.0), np.full((5, 2), np.nan))
    for seconds in (0.0, -1.0, 0.2, 1e9, np.nan):
        with pytest.raises(ModelError, match="a lag of"):
            FixedLag(estimator(), seconds, 1.0)


def test_a_fit_that_keeps_no_number_is_told():
    fit = {"rmse": [0.01, 0.01], "noise": 0.01}
    sensor = SimpleNamespace(channel="dT_a_K", fit=fit, range=(0.0, 8.0))
    model, kalman = SimpleNamespace(outputs=[sensor]), SimpleNamespace(sensors=["dT_a_K"])
    with pytest.raises(ModelError, match=r"fit of dT_a_K: rmse, noise: not a finite number"):
        model_errors(model, kalman)
    sensor.fit = {"rmse": 0.05, "noise": 0.03}
    assert model_errors(model, kalman) == [pytest.approx(0.04)]


@pytest.mark.parametrize("late", [0, 4])
def test_the_error_of_gains_that_are_for_other_sizes(late):
    """Weights of the readings in an estimate, on the joint distribution of what is true."""
    kalman, rows, at, dt = estimator(drives=1), 60, 50, 30.0
    noise = tuple(
        replace(each, white=2 * each.white, drift=3 * each.drift) for each in kalman.noise
    )
    true = replace(kalman, walk=(0.1,), noise=noise)
    time, weights = dt * np.arange(rows), np.empty((rows, 2, 2))
    for k in range(rows):
        for sensor in range(2):
            read = np.zeros((rows, 2))
            read[k, sensor] = 1.0
            one = fixed_lag(kalman, time, read, dt * late) if late else kalman.run(time, read)
            weights[k, sensor] = one[at]
    space, states = true.state_space(dt), []
    P = true.start_covariance(dt, LEVEL[:1], "rest")
    for _ in range(rows):
        states.append(P)
        P = space.F @ P @ space.F.T + space.Q
    errors = np.zeros((2, rows, len(P)))
    for k in range(rows):
        errors[:, k] = -weights[k].T @ space.H
    errors[:, at] += space.C
    variance = np.einsum("isj,jk,isk->i", -weights.transpose(2, 0, 1), space.R,
                         -weights.transpose(2, 0, 1))  # fmt: skip
    # The state of each row is that of the row before it, carried on, and what came new.
    behind = np.zeros((2, len(P)))
    for k in range(rows - 1, -1, -1):
        behind = behind @ space.F + errors[:, k]
        new = states[0] if k == 0 else space.Q
        variance += np.einsum("ij,jk,ik->i", behind, new, behind)
    found = error_variance(kalman, true, dt, late)[late]
    np.testing.assert_allclose(found, variance, rtol=0.01)
    assert np.all(np.abs(found / error_variance(kalman, kalman, dt, late)[late] - 1) > 0.2)


@pytest.mark.parametrize("late", [0, 4])
def test_bands_of_a_causal_estimate_hold_whatever_walk_the_design_has(late):
    """A heat that wanders faster, and slower, than the design took it to."""
    kalman, rows, dt = estimator(drives=1), 600, 4.0
    generator, space = np.random.default_rng(31), kalman.state_space(4.0)
    time = dt * np.arange(rows)
    for factor in (0.2, 5.0):
        true = replace(kalman, walk=(factor * kalman.walk[0],))
        space, x = true.state_space(dt), np.zeros(len(space.F))
        y, heat = np.empty((rows, 2)), np.empty(rows)
        for k in range(rows):
            y[k] = space.H @ x + np.sqrt(np.diag(space.R)) * generator.normal(size=2)
            heat[k] = space.C[0] @ x
            x = space.F @ x + np.sqrt(np.diag(space.Q)) * generator.normal(size=len(x))
        told = fit_sizes(kalman, time, y).estimator
        found = fixed_lag(kalman, time, y, dt * late) if late else kalman.run(time, y)
        error = np.sqrt(np.mean((found[50:, 0] - heat[50:]) ** 2))
        own, design = (np.sqrt(error_variance(kalman, each, dt, late)[late, 0])
                       for each in (told, kalman))  # fmt: skip
        assert own == pytest.approx(error, rel=0.2)
        assert abs(np.log(own / error)) < abs(np.log(design / error))
        assert factor < 1 or design < 0.7 * error


@pytest.mark.parametrize("pause", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_what_a_warm_machine_does_is_no_noise(pause):
    """A wall of finite volumes that was heated before the first row; its back alone is read."""
    wall, generator, dt, rows = Wall(cells=8), np.random.default_rng(33), 2.0, 300
    flux = 2e4 * np.repeat(generator.uniform(0, 1, 12), 50)
    y = wall.back_face(flux, dt)[-rows:, None]
    y = y + 0.05 * generator.standard_normal(y.shape)
    A, b, _ = wall.matrices()
    rates, vectors = np.linalg.eigh(A)
    back = Modes(rates.astype(complex), (vectors * (vectors.T @ b))[-1].astype(complex))
    noise = (SensorNoise(0.05, 0.02, 600.0),)
    kalman = KalmanEstimator(("T_degC",), ("Q_W",), (), ((0, 0, back),), (), (300.0,), noise)
    there = np.r_[0:200, 230:rows] if pause else np.arange(rows)
    time, y = dt * there, y[there]
    free = fit_sizes(kalman, time, y, initial="free", level=(2e4,)).estimator.noise[0]
    rest = fit_sizes(kalman, time, y).estimator.noise[0]
    assert free.white == pytest.approx(0.05, rel=0.15)
    assert free.drift < 0.1
    assert rest.white > 3 * free.white
