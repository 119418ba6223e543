"""Lags that all drives of an output share: those of the modes of one body."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.output_fit import fit_output
from thermaltool.fitting.parametrization import Parametrization
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_table
from thermaltool.responses import response_class
from thermaltool.responses.relaxation import RelaxationGrid

SPINDLE, FEED, ROOM = "Q_spindle_W", "Q_feed_W", "T_room_degC"
OUTPUT = "dT_nut_K"


def body(seed):
    """Four lumps in a ring with films: rates A and inlets B of spindle, feed and surroundings."""
    generator = np.random.default_rng(seed)
    capacity = np.array([900.0, 6000.0, 25000.0, 2500.0]) * generator.uniform(0.7, 1.4, 4)
    film = np.array([0.5, 2.0, 8.0, 1.0]) * generator.uniform(0.7, 1.4, 4)
    links = np.zeros((4, 4))
    for (a, b), link in {(0, 1): 6.0, (1, 2): 5.0, (2, 3): 4.0, (3, 0): 1.0}.items():
        links[a, b] = links[b, a] = link * generator.uniform(0.7, 1.4)
    A = (links - np.diag(links.sum(axis=1) + film)) / capacity[:, None]
    heat = np.array([[0.9, 0.1, 0, 0], [0, 0, 0.3, 0.7], film]).T
    return A, heat / capacity[:, None], generator


def log(seed, rows=1500, dt=30.0, dead=0):
    A, B, generator = body(seed)
    spindle = np.repeat(generator.choice([0.0, 60.0, 120.0], rows // 60 + 1), 60)[:rows]
    feed = np.repeat(generator.choice([0.0, 40.0], rows // 25 + 1), 25)[:rows]
    day = 2 * np.pi * np.arange(rows) * dt / 86400
    room = 20 + 1.5 * np.sin(day) + np.cumsum(generator.normal(0, 0.01, rows))
    room -= room[0] - 20
    late = np.append(np.zeros(dead), spindle[: rows - dead])
    u = np.column_stack([late, feed, room - 20])
    kept, x = expm(A * dt), np.zeros((rows, 4))
    into = np.linalg.solve(A, kept - np.eye(4)) @ B
    for k in range(1, rows):
        x[k] = kept @ x[k - 1] + into @ u[k - 1]
    steady = np.linalg.solve(-A, B)[3]
    read = x[:, 3] + generator.normal(0, 0.02, rows)
    columns = {SPINDLE: spindle, FEED: feed, ROOM: room, OUTPUT: read}
    return Record(dt * np.arange(rows), columns), steady


def drives_of(*channels):
    plan = CalibrationPlan(channels, (OUTPUT,))
    return [plan.drive(channel) for channel in channels]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_drives_of_one_body_share_its_time_constants_and_their_gains_are_right(seed):
    record, steady = log(seed)
    drives = (SPINDLE, FEED, ROOM)
    model = calibrate([record], CalibrationPlan(drives, (OUTPUT,), choose=True))
    found = {term.drive: term.response for term in model.terms}
    moved = np.array([120.0, 40.0, np.ptp(record.column(ROOM))])
    gains = np.array([found[drive].dc_gain() for drive in drives])
    # Within one and a half readings' noise of 0.02 K.
    assert np.max(np.abs(gains - steady) * moved) < 0.03
    lags = [[getattr(each, name) for name in each.searched] for each in found.values()]
    assert lags[0] == lags[1] == lags[2]
    assert ", common" in calibration_table(model)


@pytest.mark.slow
def test_one_of_the_drives_of_a_body_has_a_dead_time():
    record, steady = log(5, dead=5)
    drives = (SPINDLE, FEED, ROOM)
    model = calibrate([record], CalibrationPlan(drives, (OUTPUT,), choose=True))
    found = {term.drive: term.response for term in model.terms}
    # To half a row: what starts slowly is told from a short lag by little.
    assert found[SPINDLE].delay == pytest.approx(150.0, abs=15.0)
    assert found[FEED].delay == found[ROOM].delay == 0
    moved = np.array([120.0, 40.0, np.ptp(record.column(ROOM))])
    gains = np.array([found[drive].dc_gain() for drive in drives])
    assert np.max(np.abs(gains - steady) * moved) < 0.03
    assert model.outputs[0].fit["rmse"] < 1.05 * 0.02


@pytest.mark.slow
def test_a_dead_time_that_a_fast_lag_could_stand_in_for():
    generator, rows, dt, dead = np.random.default_rng(3), 1500, 10.0, 2
    spindle = np.repeat(generator.choice([0.0, 40.0, 80.0, 120.0], rows // 50), 50)
    feed = np.repeat(generator.choice([0.0, 6.0, 12.0, 20.0], rows // 30), 30)
    late = np.append(np.zeros(dead), spindle[: rows - dead])
    read = generator.normal(0, 0.15, rows)
    for tau, *gains in ((3800.0, 0.20, 0.4), (1300.0, 0.12, 0.3), (330.0, 0.12, -0.2)):
        kept = np.exp(-dt / tau)
        for u, gain in zip((late, feed), gains, strict=True):
            held = np.append(0.0, u[:-1])
            read = read + gain * lfilter([1 - kept], [1, -kept], held)
    record = Record(dt * np.arange(rows), {SPINDLE: spindle, FEED: feed, OUTPUT: read})
    model = calibrate([record], CalibrationPlan((SPINDLE, FEED), (OUTPUT,), choose=True))
    found = {term.drive: term.response for term in model.terms}
    assert found[SPINDLE].delay == pytest.approx(dt * dead, abs=2.0)
    assert found[FEED].delay == 0
    assert found[SPINDLE].dc_gain() == pytest.approx(0.44, rel=0.03)


def test_a_shared_rate_moves_the_weights_of_every_drive():
    cls, grid = response_class("rational2"), RelaxationGrid.between(1e-4, 1.0)
    own = Parametrization((cls, cls), ({"delay": 0.0},) * 2, common=True)
    assert own.names() == ["tau1", "tau2", "K1[0]", "K2[0]", "K1[1]", "K2[1]"]
    theta, step = np.log([30.0, 400.0]), 1e-3
    for k, slope in enumerate(own.unit_slopes(theta, grid)):
        ends = [own.unit_weights(theta + side * step * np.eye(2)[k], grid) for side in (-1, 1)]
        assert slope == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-4)
    shared = np.concatenate(own.parts(theta))
    assert own.apart.unit_weights(shared, grid) == pytest.approx(own.unit_weights(theta, grid))


def test_rates_that_are_shared_are_one_in_the_covariance():
    record, _ = log(1, rows=800)
    fit = fit_output([record], drives_of(SPINDLE, FEED), OUTPUT, ["rational2"] * 2, common=True)
    assert fit.names[:4] == ("tau1[0]", "tau2[0]", "tau1[1]", "tau2[1]")
    assert fit.covariance[:2, :2] == pytest.approx(fit.covariance[2:4, 2:4])
    assert fit.covariance[:2, :2] == pytest.approx(fit.covariance[:2, 2:4])
    first, second = (fit.response_covariance(k)[0] for k in (0, 1))
    assert first[:2, :2] == pytest.approx(second[:2, :2])
    assert len(fit.discrepancy.mean) == 8 + 2 * len(fit.time_constants)
