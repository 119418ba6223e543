"""A machine that loses more heat than its model, and a sensor that shows less: found, and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import thermaltool as tt
from thermaltool.estimation.changed_machine import likeliest_change
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.model_departure import model_departure
from thermaltool.estimation.smoother import smooth
from thermaltool.responses.modes import Modes

DT, ROWS, LEVEL, NOISE = 2.0, 900, 100.0, 0.02
# Four lumps in a row [J/K, W/K], of which the first is heated and the first, third and last read.
CAPACITY, COUPLING, LOSS = 60.0, 2.0, 0.3
READ = (0, 2, 3)
SENSORS = "dT_a_K", "dT_b_K", "dT_c_K"


def matrix(loss):
    A = np.diag([-(loss + COUPLING), *[-(loss + 2 * COUPLING)] * 2, -(loss + COUPLING)])
    return (A + COUPLING * (np.eye(4, k=1) + np.eye(4, k=-1))) / CAPACITY


def estimator():
    rates, vectors = np.linalg.eigh(matrix(LOSS))
    terms = tuple(
        (k, 0, Modes(rates + 0j, vectors[place] * vectors[0] / CAPACITY + 0j))
        for k, place in enumerate(READ)
    )
    noise = (SensorNoise(NOISE, 0.01, 900.0),) * 3
    return KalmanEstimator(SENSORS, ("Q_W",), (), terms, (), (5.0,), noise)


def record(generator, loss=LOSS, gains=(1.0, 1.0, 1.0)):
    """Readings of a duty that steps, and its heat."""
    heat = LEVEL * np.repeat(generator.uniform(size=ROWS // 100), 100)
    A = matrix(loss)
    F = expm(DT * A)
    g = np.linalg.solve(A, (F - np.eye(4))[:, 0] / CAPACITY)
    x, out = np.zeros(4), np.empty((ROWS, 3))
    for k, q in enumerate(heat):
        out[k] = np.array(gains) * x[list(READ)]
        x = F @ x + g * q
    return out + NOISE * generator.normal(size=out.shape), heat


def found(readings):
    time = DT * np.arange(ROWS)
    return likeliest_change(
        estimator(), [0.02] * 3, [0.004] * 3, time, readings, "rest", [LEVEL]
    )  # fmt: skip


def test_a_loss_that_has_grown_is_found_and_the_heat_is_right_with_it():
    readings, heat = record(np.random.default_rng(81), loss=1.5 * LOSS)
    change = found(readings)
    assert change is not None
    assert (change.sensor, change.explains) == ("", True)
    assert change.size == pytest.approx(0.5 * LOSS / CAPACITY, rel=0.1)
    time = DT * np.arange(ROWS)
    errors = [
        np.sqrt(np.mean((smooth(each, time, readings, [LEVEL]).estimates[:, 0] - heat) ** 2))
        for each in (estimator(), change.estimator)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_a_sensor_that_shows_less_is_named():
    readings, _ = record(np.random.default_rng(82), gains=(1.0, 0.9, 1.0))
    change = found(readings)
    assert change is not None
    assert (change.sensor, change.explains) == ("dT_b_K", True)
    assert change.size == pytest.approx(0.9, abs=0.01)
    assert change.document()["of"] == "dT_b_K"


def test_a_machine_as_it_was_calibrated_has_not_changed():
    generator = np.random.default_rng(83)
    changes = [found(record(generator)[0]) for _ in range(3)]
    assert not any(each is not None and each.explains for each in changes)


@pytest.mark.parametrize("loss", [0.5, 0.15])
def test_a_loss_that_has_fallen_is_no_sensor(loss):
    """Beyond the smallest loss that is tried it may be another one: nothing is explained then."""
    readings, _ = record(np.random.default_rng(85), loss=loss * LOSS)
    change = found(readings)
    assert change is not None
    assert not change.sensor
    assert change.size == pytest.approx((loss - 1) * LOSS / CAPACITY, rel=0.1)
    assert change.explains


def test_a_sensor_beyond_all_that_is_tried_explains_nothing():
    readings, _ = record(np.random.default_rng(86), gains=(1.0, 0.1, 1.0))
    change = found(readings)
    assert change is not None
    assert not change.explains


def test_a_deflection_slower_than_the_sensors_stays_stable():
    """No loss is tried with which it would run away."""
    slow = Modes(np.array([-1 / 5000.0 + 0j]), np.array([1e-4 + 0j]))
    machine = replace(estimator(), outputs=("d_z_um",), followed=((0, 0, slow),))
    readings, _ = record(np.random.default_rng(87), loss=0.6 * LOSS)
    time = DT * np.arange(ROWS)
    change = likeliest_change(machine, [0.02] * 3, [0.004] * 3, time, readings, "rest", [LEVEL])
    assert change is not None
    for each in (change.estimator, change.edge):
        assert all(np.all(modes.poles.real < 0) for _, _, modes in each.followed)


@pytest.mark.slow
def test_estimates_are_those_of_the_changed_machine_and_say_so():
    generator = np.random.default_rng(84)

    def log(loss):
        readings, heat = record(generator, loss)
        columns = {"time_s": DT * np.arange(ROWS), "Q_W": heat}
        return pd.DataFrame(columns | {name: readings[:, k] for k, name in enumerate(SENSORS)})

    fit = tt.calibrate(log(LOSS), ["Q_W"], sensors=list(SENSORS), warn=str)
    idle = log(LOSS)
    idle[list(SENSORS)] = NOISE * generator.normal(size=(ROWS, 3))
    design = tt.regularize(fit, tt.noise(idle, warn=str), form="kalman", warn=str)
    lossy, said = log(1.5 * LOSS), []
    run = tt.estimate(design, lossy, smooth=True, bands=True, warn=said.append)
    told = next(each for each in said if "more heat than when it was calibrated" in each)
    assert 40 < float(told.partition("loses ")[2].partition(" %")[0]) < 60
    assert run.document()["change"]["taken"]
    error = run.columns["Q_W"] - lossy["Q_W"].to_numpy()
    assert np.sqrt(np.mean(error**2)) < 0.05 * LEVEL
    assert np.mean(np.abs(error) < 1.96 * run.columns["sigma_Q_W"]) > 0.9
    # What a filter of the model gives is wrong by the gain; its standard errors hold it.
    plain = tt.estimate(design, lossy, bands=True, warn=str)
    assert plain.document()["change"]["taken"] is False
    error = plain.columns["Q_W"] - lossy["Q_W"].to_numpy()
    assert np.mean(np.abs(error) < 1.96 * plain.columns["sigma_Q_W"]) > 0.9


def lags(heat, times):
    """Two sensors of a lag each, by their own recursion."""
    found = np.zeros((len(heat), len(times)))
    stays = np.exp(-DT / np.array(times))
    for k, q in enumerate(heat[:-1]):
        found[k + 1] = stays * found[k] + (1 - stays) * 0.1 * q
    return found


def two_lags(times):
    terms = tuple(
        (k, 0, Modes(np.array([-1 / each + 0j]), np.array([0.1 / each + 0j])))
        for k, each in enumerate(times)
    )
    return KalmanEstimator(SENSORS[:2], ("Q_W",), (), terms, (), (5.0,), (SensorNoise(0.01),) * 2)


def warm_log(generator, times):
    """Readings of a machine that has run warm for 1200 s before the first row."""
    before = np.full(600, 0.8 * LEVEL)
    heat = np.concatenate([before, LEVEL * np.repeat(generator.uniform(size=8), 75)])
    readings = lags(heat, times) + 0.01 * generator.normal(size=(len(heat), 2))
    return readings[600:], heat[600:]


TIMES = 600.0, 1500.0
ERRORS = [1e-4] * 2, [1e-3] * 2


@pytest.mark.parametrize("off", [0.99, 1.01])
def test_a_time_constant_that_is_off_is_no_loss(off):
    readings, _ = warm_log(np.random.default_rng(88), (TIMES[0], off * TIMES[1]))
    time = DT * np.arange(len(readings))
    change = likeliest_change(two_lags(TIMES), *ERRORS, time, readings, "free", [LEVEL])
    assert change is not None
    assert (change.kind, change.sensor) == ("pace", "dT_b_K")
    assert change.size == pytest.approx(off, abs=0.003)
    assert change.document()["more_percent"] == pytest.approx(100 * (off - 1), abs=0.3)


@pytest.mark.slow
def test_what_the_innovations_show_of_a_model_is_held_by_the_bands():
    """What a time constant that is 1 % off does to the heat, in all rows."""
    generator = np.random.default_rng(89)
    kalman = two_lags(TIMES)
    for off in (1.0, 1.01):
        readings, _ = warm_log(generator, (off * TIMES[0], TIMES[1]))
        time = DT * np.arange(len(readings))
        found = model_departure(kalman, *ERRORS, time, readings, "free", [LEVEL])
        assert (found is None) == (off == 1.0)
    assert found is not None
    assert 0.002 < found.sizes[1] < 0.05

    def heats(like):
        return smooth(like, time, readings, [LEVEL], "free").estimates[:, 0]

    error = np.abs(heats(kalman) - heats(two_lags((1.01 * TIMES[0], TIMES[1]))))
    held = 1.96 * np.sqrt(found.variance(kalman, heats))
    assert np.mean(error < held) > 0.9
    assert np.mean(held) < 4 * np.mean(error)
    # A sensor of which the calibration knows next to nothing ends no estimate.
    unknown = [1.0] * len(kalman.sensors)
    found = model_departure(kalman, ERRORS[0], unknown, time, readings, "free", [LEVEL])
    assert found is None or np.all(np.isfinite(found.sizes))
