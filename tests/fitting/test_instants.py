"""Instants of commands between rows as a part of the noise of a fit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from reference.training import fitted, training
from scipy.signal import lfilter

from thermaltool.fitting.error_regression import input_response
from thermaltool.fitting.instants import Instants, pulses
from thermaltool.fitting.projection import CalibrationProblem
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.model import Drive
from thermaltool.record import Record


@pytest.fixture(scope="module")
def columns_and_noise():
    rng = np.random.default_rng(20261125)
    columns = rng.standard_normal((400, 30)) * np.geomspace(0.3, 3.0, 30)
    return rng, columns, 0.2 * rng.standard_normal(400)


def test_noise_beside_the_instants_is_found(columns_and_noise):
    rng, columns, noise = columns_and_noise
    found = Instants.of(columns, columns @ rng.standard_normal(30) + noise)
    assert found.noise == pytest.approx(0.2, rel=0.15)
    assert found.evidence > 100
    left = found.left(columns @ rng.standard_normal(30) + noise, np.ones(400))
    assert np.std(left) == pytest.approx(0.2, rel=0.15)


def test_no_instants_where_there_is_noise_alone(columns_and_noise):
    _, columns, noise = columns_and_noise
    assert Instants.of(columns, noise).evidence < 0


def test_whitened_rows_have_the_likelihood_of_the_covariance(columns_and_noise):
    rng, columns, _ = columns_and_noise
    rows = rng.standard_normal((400, 3))
    found = Instants(columns, 0.2, 0.0)
    covariance = 0.2**2 * np.eye(400) + columns @ columns.T
    expected = rows.T @ np.linalg.solve(covariance, rows)
    white = found.whitened(rows)
    assert white.T @ white / 0.2**2 == pytest.approx(expected, rel=1e-8)


def test_compressed_rows_have_the_likelihood_of_the_covariance(columns_and_noise):
    rng, _, _ = columns_and_noise
    heat = np.repeat(rng.choice([0.0, 50.0, 100.0], 20), 20)
    log = Record(15.0 * np.arange(400), {"Q_main_W": heat, "dT_a_K": rng.standard_normal(400)})
    drive = Drive("Q_main_W", "first", 0.0, (0.0, 100.0))
    problem = CalibrationProblem.assemble([log], [drive], "dT_a_K", False)
    columns, sigma = rng.standard_normal((400, 20)), 0.3
    triangle = problem.compress(np.ones(400), (columns, sigma))
    covariance = sigma**2 * np.eye(400) + columns @ columns.T
    for coefficients in rng.standard_normal((2, problem.design.shape[1])):
        left = problem.measured - problem.design @ coefficients
        expected = sigma**2 * left @ np.linalg.solve(covariance, left)
        found = np.sum((triangle.z - triangle.R @ coefficients) ** 2)
        assert found == pytest.approx(expected, rel=1e-8)


def test_a_pulse_is_what_a_step_half_a_row_earlier_changes():
    """Two rows of time constant, and the mean over instants between the rows."""
    tau, t = 2.0, np.arange(8.0)
    step = 1 - np.exp(-t / tau)
    # Mean of the rows after a step that lies anywhere in the row before, and of an impulse.
    mean = np.diff(t + tau * np.exp(-t / tau))
    once = np.append(mean[0], np.diff(mean))
    levels = np.array([[0.0, 0, 0, 100, 100, 100, 100]])
    (late,) = pulses(levels, lambda i, x: np.append(0.0, once)[: len(x)], ["zero"], 1)
    assert late[:3] == pytest.approx(np.zeros(3))
    assert late[3:] == pytest.approx(100 / 12**0.5 * np.diff(step)[:4], rel=0.08)
    assert not list(pulses(levels, lambda i, x: once, ["first"], 1))
    assert not list(pulses(levels[:0], lambda i, x: once, [], 1))
    assert not list(pulses(levels[:, :1], lambda i, x: once, ["zero"], 1))


@pytest.mark.parametrize("name", ["oe", "subspace"])
def test_a_pulse_is_one_whatever_stood_before_the_record(name):
    """Models differ in what they take an input for before its first row."""
    rng = np.random.default_rng(20261126)
    pole, u = np.exp(-1 / 6.0), np.repeat(rng.choice([0.0, 1.0], 30), 10)
    u[:10] = 0.0
    data = training((u, 3 * lfilter([0, 1 - pole], [1, -pole], u), 0, True))
    if name == "oe":
        model = fitted(data, "oe", (1,), 1, (1,))
    else:
        model = identify_subspace(data, 1).outputs[0]
    of_input = partial(input_response, model, data.records[0])
    late = next(iter(pulses(np.atleast_2d(u), of_input, ["zero"], 1)))
    j = int(np.flatnonzero(np.diff(u))[0])
    # Half a row earlier: what a row of the input changes, over one standard deviation of a row.
    assert late[j + 3] == pytest.approx(
        np.diff(u)[j] * 3 * (1 - pole) * pole**1.5 / 12**0.5, rel=0.02
    )
