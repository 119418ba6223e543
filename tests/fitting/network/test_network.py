"""Shared modes against a plant by scipy's state-space simulation, which has no code of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import StateSpace, lfilter, lsim

from thermaltool.errors import FitError, LogError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.network.choose import choose_delays, choose_modes
from thermaltool.fitting.network.identify import identify_network
from thermaltool.fitting.network.plan import NetworkPlan
from thermaltool.fitting.residuals import residual_tests
from thermaltool.fitting.selection import first_that_fits
from thermaltool.record import Record

DT, ROWS = 5.0, 1600
LAGS = np.array([1200.0, 200.0, 30.0])
WEIGHTS = np.array([[10.0, 4.0, -2.0], [1.0, 2.0, 1.0]])
OFFSETS = np.array([3.0, 20.0])
NONE = ((0.0,), (0.0,))
TARGETS = ("d_z_um", "T_a_degC")


def power(rng, rows=ROWS, held=60):
    u = np.repeat(rng.uniform(0, 2, rows // held + 1), held)[:rows]
    u[:10] = 0.0
    return u


def plant(u, hold="zero", weights=WEIGHTS, state=None):
    """Outputs (2, n) of the state-space form, one state for each mode and input; u is (m, n)."""
    inputs = np.atleast_2d(u)
    weights = weights if weights.ndim == 3 else weights[:, None, :]
    p, m, n = weights.shape
    A = np.kron(np.eye(m), -np.diag(1 / LAGS))
    B = np.kron(np.eye(m), 1 / LAGS[:, None])
    system = StateSpace(A, B, weights.reshape(p, m * n), np.zeros((p, m)))
    time = DT * np.arange(inputs.shape[1])
    start = np.zeros(m * n) if state is None else state
    return lsim(system, inputs.T, time, X0=start, interp=hold == "first")[1].T


def noisy(rng, y, share=0.01, colour=([1.0], [1.0])):
    e = lfilter(*colour, rng.standard_normal(y.shape), axis=1)
    return y + OFFSETS[:, None] + share * y.std(axis=1)[:, None] * e


def records(u, y, at_rest=True, hold="zero", time=None):
    time = DT * np.arange(y.shape[1]) if time is None else time
    inputs = np.atleast_2d(u)
    names = tuple(f"Q_{k}_W" for k in range(len(inputs)))
    columns = dict(zip((*names, *TARGETS), (*inputs, *y), strict=True))
    record = Record(time, columns, at_rest=at_rest)
    return TrainingData((record,), names, TARGETS, DT, (hold,) * len(inputs))


def estimates(network):
    """All values with their intervals, and what the plant has."""
    found = [e for _, e in network.outputs[0].named()][:3]
    found += [e for share in network.outputs for e in (*share.weight_estimates(0), share.gain(0))]
    truth = [*LAGS, *WEIGHTS[0], WEIGHTS[0].sum(), *WEIGHTS[1], WEIGHTS[1].sum()]
    return found, np.array(truth)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [([1.0], [1.0]), ([0.6], [1.0, -0.8])], ids=["white", "AR(1)"])
def test_intervals_hold_the_truth(colour):
    """60 repetitions: each interval at least 50 times, all together 90 to 99 %."""
    u = power(np.random.default_rng(1))
    clean, inside = plant(u), []
    for repeat in range(60):
        y = noisy(np.random.default_rng([2, repeat]), clean, colour=colour)
        found, truth = estimates(identify_network(records(u, y), 3, NONE))
        inside.append([e.low < t < e.high for e, t in zip(found, truth, strict=True)])
    shares = np.mean(inside, axis=0)
    assert np.min(shares) >= 50 / 60
    assert 0.90 < np.mean(shares) < 0.99


def test_shared_poles_are_surer_than_those_of_each_output():
    u = power(np.random.default_rng(3))
    data = records(u, noisy(np.random.default_rng(4), plant(u), 0.02))

    def widths(network):
        return np.array(
            [np.log(e.high / e.low) for e in network.outputs[0].time_constant_estimates()]
        )

    together = widths(identify_network(data, 3, NONE))
    for k in (0, 1):
        alone = widths(identify_network(data.only(k), 3, NONE[:1]))
        assert np.all(together < alone)


def test_a_correlated_second_output_teaches_less_than_an_independent_one():
    """The same noise in both outputs: the intervals must not shrink as if there were two."""
    u = power(np.random.default_rng(5))
    weights = np.array([[10.0, 4.0, -2.0], [10.0, 4.0, -2.0]])
    clean, rng = plant(u, weights=weights), np.random.default_rng(6)
    e = 0.05 * clean[0].std() * rng.standard_normal(clean.shape)
    same = identify_network(records(u, clean + e[:1]), 3, NONE)
    apart = identify_network(records(u, clean + e), 3, NONE)
    alone = identify_network(records(u, clean + e[:1]).only(0), 3, NONE[:1])
    width = [
        np.log(n.outputs[0].time_constant_estimates()[0].high / n.time_constants[0])
        for n in (same, apart, alone)
    ]
    assert width[0] == pytest.approx(width[2], rel=0.02)
    assert width[1] == pytest.approx(width[2] / np.sqrt(2), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_the_state_at_the_start_is_found_where_it_is_not_rest(hold):
    rng = np.random.default_rng(7)
    u = power(rng) + 0.5
    y = noisy(rng, plant(u, hold, state=np.array([1.5, -0.5, 0.2])))
    data = records(u, y, at_rest=False, hold=hold)
    assert not NetworkPlan().start(data).records[0].at_rest
    network = identify_network(data, 3, NONE)
    np.testing.assert_allclose(network.time_constants, LAGS, rtol=0.1)
    assert min(a.fit_percent for a in network.fit(data)) > 98.5
    np.testing.assert_allclose([s.offsets[0] for s in network.outputs], OFFSETS, atol=0.5)


def test_an_idle_start_is_rest():
    rng = np.random.default_rng(8)
    u = power(rng)
    assert NetworkPlan().start(records(u, noisy(rng, plant(u)), at_rest=False)).records[0].at_rest


def test_any_clock_and_missing_readings():
    """Rows taken out at random, not where the power moves; readings of one output lost."""
    rng = np.random.default_rng(9)
    u = power(rng)
    y = noisy(rng, plant(u))
    moved = np.flatnonzero(np.diff(u)) + 1
    kept = np.unique(np.r_[0:10, moved, rng.choice(ROWS, 900, replace=False)])
    y[1, rng.choice(ROWS, 300, replace=False)] = np.nan
    y[1, 500:620] = np.nan
    data = records(u[kept], y[:, kept], time=DT * kept.astype(float))
    network = identify_network(data, 3, NONE)
    found, truth = estimates(network)
    error = [(e.value - t) / (e.high - e.low) * 2 * 1.96 for e, t in zip(found, truth, strict=True)]
    assert np.max(np.abs(error)) < 4
    np.testing.assert_allclose(network.time_constants, LAGS, rtol=0.05)
    assert network.outputs[1].rows < network.outputs[0].rows == len(kept)


def test_pauses_part_a_log_and_each_log_has_its_offset():
    rng = np.random.default_rng(10)
    pieces = []
    for origin in (0, 1):
        u = power(rng)
        y = noisy(rng, plant(u)) + 7.0 * origin
        parts = [slice(0, 700), slice(760, ROWS)] if origin else [slice(0, ROWS)]
        log = records(u, y).records[0]
        log = replace(log, segments=tuple(parts), origin=origin)
        pieces += log.pieces(["Q_0_W"])
    data = TrainingData(tuple(pieces), ("Q_0_W",), TARGETS, DT).from_rest()
    assert [r.at_rest for r in data.records] == [True, True, False]
    network = identify_network(data, 3, NONE)
    np.testing.assert_allclose(network.time_constants, LAGS, rtol=0.03)
    for share, offset in zip(network.outputs, OFFSETS, strict=True):
        np.testing.assert_allclose(share.offsets, [offset, offset + 7], atol=0.05)


@pytest.mark.slow
def test_two_inputs_with_delays_of_their_own_are_found():
    rng = np.random.default_rng(11)
    weights = rng.uniform(1, 5, (2, 2, 3))
    u = np.array([power(rng, held=60), power(rng, held=47)])
    late = np.array([np.roll(u[0], 4), np.roll(u[1], 9)])
    late[0, :4], late[1, :9] = 0.0, 0.0
    data = records(u, noisy(rng, plant(late, weights=weights)))
    delays = choose_delays(data)
    np.testing.assert_allclose(delays, [[20.0, 45.0]] * 2, atol=DT)
    network = identify_network(data, 3, ((20.0, 45.0),) * 2)
    np.testing.assert_allclose(network.time_constants, LAGS, rtol=0.05)
    found = np.array([[share.weights[k] for k in range(2)] for share in network.outputs])
    np.testing.assert_allclose(found, weights, atol=0.35)


@pytest.mark.slow
def test_as_many_modes_as_there_are():
    rng = np.random.default_rng(12)
    u = power(rng)
    data = records(u, noisy(rng, plant(u)))
    candidates = choose_modes(data, NONE)
    network = first_that_fits(
        (c.model.modes for c in candidates), lambda n: identify_network(data, n, NONE)
    )
    assert len(network.time_constants) == 3
    for k, output in enumerate(network.outputs):
        tests = residual_tests(output, data.only(k))
        assert tests.white_p > 1e-3
        assert tests.independent_p["Q_0_W"] > 1e-3
    poor = identify_network(data, 1, NONE)
    for k, output in enumerate(poor.outputs):
        assert residual_tests(output, data.only(k)).independent_p["Q_0_W"] < 1e-6


def test_without_noise_the_plant_itself_comes_out():
    u = power(np.random.default_rng(13))
    network = identify_network(records(u, plant(u)), 3, NONE)
    np.testing.assert_allclose(network.time_constants, LAGS, rtol=1e-4)
    np.testing.assert_allclose([s.weights[0] for s in network.outputs], WEIGHTS, rtol=1e-3)


def test_the_response_and_its_covariance_are_those_of_the_network():
    rng = np.random.default_rng(14)
    u = power(rng)
    share = identify_network(records(u, noisy(rng, plant(u))), 3, NONE).outputs[0]
    response = share.response(0)
    covariance, names = share.response_covariance(0)
    assert response.dc_gain() == pytest.approx(share.gain(0).value)
    assert [getattr(response, name) for name in names[:3]] == share.time_constants.tolist()
    gains = covariance[3:, 3:].sum()
    assert 1.96 * np.sqrt(gains) == pytest.approx(
        share.gain(0).high - share.gain(0).value, rel=1e-4
    )


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_outputs_that_follow_the_same_row(hold):
    """Feedthrough comes back with its interval, and the response has it."""
    rng = np.random.default_rng(16)
    u = power(rng, rows=800)
    direct = np.array([[3.0], [0.5]])
    data = records(u, noisy(rng, plant(u, hold)[:, :800] + direct * u), hold=hold)
    network = identify_network(data, 3, NONE, True)
    for k, (output, truth) in enumerate(zip(network.outputs, direct[:, 0], strict=True)):
        e = output.direct_estimate(0)
        assert abs(e.value - truth) < 4 * (e.high - e.value) / 1.96
        assert output.gain(0).value == pytest.approx(WEIGHTS[k].sum() + truth, rel=0.02)
        response, (covariance, names) = output.response(0), output.response_covariance(0)
        assert response.direct == e.value
        assert covariance.shape == (len(names), len(names))
        assert set(names) == {*response.searched, *response.gains}
        record = data.records[0]
        moved = response.modes(DT).run(record.time, record.column("Q_0_W"), hold)
        np.testing.assert_allclose(moved + output.offsets[0], output.simulate(record), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("direct", [0.0, 2.0])
def test_feedthrough_is_chosen_where_it_is(direct):
    rng = np.random.default_rng(17)
    u = power(rng, rows=800)
    y = noisy(rng, plant(u)[:, :800] + direct * u, colour=([0.6], [1, -0.8]))
    candidates = choose_modes(records(u, y), NONE)
    assert candidates[0].model.has_direct == bool(direct)
    assert bool(direct) == any(c.model.has_direct for c in candidates)


def test_feedthrough_and_a_dead_time_exclude_each_other():
    u, y, _, _ = bad()
    with pytest.raises(FitError, match="exclude each other"):
        identify_network(records(u, y), 1, ((5.0,), (0.0,)), True)


def bad(**changes):
    rng = np.random.default_rng(15)
    u = power(rng)
    y = noisy(rng, plant(u))
    made = {"u": u, "y": y, "modes": 3, "delays": NONE, **changes}
    return made["u"], made["y"], made["modes"], made["delays"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"modes": 5}, "fall together .* the data carry fewer"),
        ({"modes": 7}, "it takes 1 to 6"),
        ({"u": np.ones(ROWS)}, "Q_0_W does not excite"),
        ({"y": np.ones((2, ROWS))}, "d_z_um is constant"),
        ({"y": np.full((2, ROWS), np.nan)}, "d_z_um has no reading"),
        ({"delays": ((0.0,), (1e5,))}, "a delay of 100000 s is longer than the record"),
    ],
)
def test_bad_input_is_named(changes, message):
    u, y, modes, delays = bad(**changes)
    with pytest.raises(FitError, match=message):
        identify_network(records(u, y), modes, delays)


def test_collinear_inputs_and_short_records_are_named():
    u, y, _, _ = bad()
    both = np.array([u, 2 * u])
    with pytest.raises(FitError, match="collinear inputs: Q_0_W, Q_1_W"):
        identify_network(records(both, y), 2, ((0.0, 0.0),) * 2)
    short = records(power(np.random.default_rng(1), 18, 5), y[:, :18])
    with pytest.raises(FitError, match="18 rows do not carry 6 modes"):
        identify_network(short, 6, NONE)


def test_lengths_that_differ_are_named():
    with pytest.raises(LogError, match="Q_0_W has shape"):
        records(np.ones((1, 4)), np.ones((2, 5)))
