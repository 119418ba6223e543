"""The filter against one written down from the textbook, and against solutions by hand."""

from __future__ import annotations

import numpy as np
import pytest
from machines.lumped import Chain, declaration, inputs
from scipy.linalg import expm

from thermaltool.fitting.rc.data import filter_pieces
from thermaltool.fitting.rc.declaration import load_network
from thermaltool.fitting.rc.fit import fit_network
from thermaltool.fitting.rc.likelihood import RcLikelihood
from thermaltool.fitting.rc.parameters import SearchSpace
from thermaltool.fitting.rc.state_space import thermal_modes
from thermaltool.record import Record

CHAIN = Chain((800.0, 4000.0), (5.0, 8.0))
# In the order in which the network has its free parameters.
TRUTH = {"nodes.motor.capacity": 800.0, "nodes.motor.diffusion": 2.0, "nodes.motor.noise": 0.05,
         "nodes.frame.capacity": 4000.0, "links.motor-frame.conductance": 5.0,
         "links.frame-T_room_degC.conductance": 8.0}  # fmt: skip


def network(nodes, **start):
    return load_network(declaration(nodes, **start), "test", "<test>")


def record(chain, rows, seed, jitter=0.0, missing=0.0):
    rng = np.random.default_rng(seed)
    time, heat, room = inputs(rows, 10.0, rng)
    time = time + 10.0 * jitter * rng.uniform(-0.5, 0.5, rows)
    readings = chain.run(time, heat, room, rng)
    readings[rng.uniform(size=rows) < missing] = np.nan
    return Record(time, {"Q_motor_W": heat, "T_room_degC": room, "T_motor_degC": readings})


def textbook_deviance(log, mean, spread):
    """−2 log L of a Kalman filter row by row, with matrix exponentials of its own."""
    A, B = CHAIN.system()
    S = np.diag([(CHAIN.diffusion / 800.0) ** 2, 0.0])
    x, P, total = np.full(2, mean), spread**2 * np.eye(2), 0.0
    columns = [log.columns[name] for name in ("T_motor_degC", "Q_motor_W", "T_room_degC")]
    y, heat, room = columns
    for k in range(len(y)):
        if np.isfinite(y[k]):
            variance, error = P[0, 0] + CHAIN.noise**2, y[k] - x[0]
            total += np.log(2 * np.pi * variance) + error**2 / variance
            gain = P[:, 0] / variance
            x, P = x + gain * error, P - np.outer(gain, P[0])
        if k + 1 == len(y):
            break
        dt = log.time[k + 1] - log.time[k]
        whole = np.zeros((6, 6))
        whole[:2, :2], whole[:2, 2:4], whole[2:4, 4:] = A, B, np.eye(2)
        slope = [0.0, (room[k + 1] - room[k]) / dt]
        x = expm(whole * dt)[:2] @ np.concatenate([x, [heat[k], room[k]], slope])
        pair = expm(np.block([[-A, S], [np.zeros((2, 2)), A.T]]) * dt)
        P = pair[2:, 2:].T @ P @ pair[2:, 2:] + pair[2:, 2:].T @ pair[:2, 2:]
    return total


@pytest.mark.parametrize(("jitter", "missing"), [(0.0, 0.0), (0.6, 0.0), (0.6, 0.2), (0.0, 0.1)])
def test_likelihood_is_that_of_a_textbook_filter(jitter, missing):
    log, declared = record(CHAIN, 300, 5, jitter, missing), network(2)
    assert [p.name for p in declared.free] == list(TRUTH)
    vector = np.log(list(TRUTH.values()))
    space = SearchSpace.around(declared, vector)
    likelihood = RcLikelihood(declared, space, filter_pieces(declared, [log]))
    prior = likelihood.priors[0]
    expected = textbook_deviance(log, prior.mean, prior.spread)
    assert likelihood.deviances(vector[None])[0] == pytest.approx(expected, abs=1e-6)


def test_score_at_the_truth_has_the_information_as_its_covariance():
    """Squared scores in standard deviations, of 40 logs and six parameters: χ² of 240."""
    declared, vector = network(2), np.log(list(TRUTH.values()))
    squares = []
    for seed in range(40):
        pieces = filter_pieces(declared, [record(CHAIN, 300, 100 + seed)])
        space = SearchSpace.around(declared, vector)
        _, information, score = RcLikelihood(declared, space, pieces).evaluated(vector)
        squares.append(score**2 / np.diag(information))
    # Parameters are correlated: the sum spreads up to √6 times as far as that of 240 free ones.
    assert np.sum(squares) == pytest.approx(240, abs=4 * np.sqrt(2 * 240 * 6))


@pytest.mark.slow
def test_one_node_is_what_one_solves_by_hand():
    """T = T_room + Q/G (1 − e^(−t G/C)) for a step: no noise but the last digits."""
    time = 10.0 * np.arange(400)
    heat = np.where(time < 100, 0.0, 60.0)
    rise = 60.0 / 3.0 * -np.expm1(-np.maximum(time - 100, 0.0) * 3.0 / 900.0)
    columns = {"Q_motor_W": heat, "T_room_degC": np.full(400, 21.0),
               "T_motor_degC": np.round(21.0 + rise, 4)}  # fmt: skip
    document = declaration(1)
    document["nodes"]["motor"]["diffusion"] = 0
    fit = fit_network(load_network(document, "one", "<test>"), [Record(time, columns)])
    assert fit.estimates["nodes.motor.capacity"].value == pytest.approx(900.0, rel=1e-5)
    conductance = fit.estimates["links.motor-T_room_degC.conductance"]
    assert conductance.value == pytest.approx(3.0, rel=1e-5)
    assert fit.estimates["nodes.motor.noise"].value == pytest.approx(1e-4 / 12**0.5, rel=0.2)


def test_modes_are_those_of_the_matrix():
    declared = network(2)
    space = SearchSpace.around(declared, np.log(list(TRUTH.values())))
    modes = thermal_modes(declared, space.values(np.log([list(TRUTH.values())])))
    A, B = CHAIN.system()
    assert modes.rates[0] == pytest.approx(np.sort(-np.linalg.eigvals(A).real))
    s = 1j * np.geomspace(1e-5, 1.0, 9)
    for k, at in enumerate(s):
        expected = np.linalg.solve(at * np.eye(2) - A, B)[0]
        found = modes.outputs[0] @ (modes.gains[0] / (at + modes.rates[0])[:, None])
        assert found[0, :2] == pytest.approx(expected, rel=1e-9), k


@pytest.mark.slow
def test_process_noise_that_is_not_there_vanishes_and_the_rest_is_found():
    chain = Chain((800.0,), (3.0,), diffusion=0.0)
    fit = fit_network(network(1), [record(chain, 400, 3)])
    assert fit.estimates["links.motor-T_room_degC.conductance"].value == pytest.approx(3, rel=0.02)
    assert fit.estimates["nodes.motor.diffusion"].value < 0.5
    assert fit.estimates["nodes.motor.noise"].value == pytest.approx(0.05, rel=0.15)


@pytest.mark.slow
def test_intervals_of_one_node_hold_the_truth():
    """Four parameters in 60 logs: 240 intervals, 90 to 98 % of which hold the truth."""
    chain, held = Chain((800.0,), (3.0,)), []
    truth = {"nodes.motor.capacity": 800.0, "nodes.motor.diffusion": 2.0,
             "nodes.motor.noise": 0.05, "links.motor-T_room_degC.conductance": 3.0}  # fmt: skip
    declared = network(1, C1=500.0, G1=5.0, s=3.0, r=0.1)
    for seed in range(60):
        fit = fit_network(declared, [record(chain, 400, 1000 + seed)])
        held += [fit.estimates[name].low <= v <= fit.estimates[name].high
                 for name, v in truth.items()]  # fmt: skip
    assert 0.90 <= np.mean(held) <= 0.98


def test_what_is_not_excited_is_not_identified():
    log = record(CHAIN, 300, 9)
    cold = log.with_columns({"Q_motor_W": np.zeros(300)})
    fit = fit_network(network(1), [cold])
    assert "links.motor-T_room_degC.conductance" in fit.unidentified
    assert "nodes.motor.capacity" in fit.unidentified


@pytest.mark.slow
def test_logs_begin_each_in_their_own_state():
    """A second log from amid the heating, and a pause in the first one."""
    whole = record(CHAIN, 1000, 21)
    parts = [whole.rows(slice(0, 450)), whole.rows(slice(520, 1000))]
    fit = fit_network(network(2), parts)
    for name, value in TRUTH.items():
        e = fit.estimates[name]
        assert e.low - (e.value - e.low) <= value <= e.high + (e.high - e.value), name
