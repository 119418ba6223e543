"""Poles that all outputs share, by subspace identification: plants are those of scipy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import StateSpace, lsim

from thermaltool.errors import FitError
from thermaltool.fitting.cancelling_lags import are_cancelling
from thermaltool.fitting.data import TrainingData, even_training_data
from thermaltool.fitting.document import model_document
from thermaltool.fitting.identification import identify
from thermaltool.fitting.subspace.choose import choose_order
from thermaltool.fitting.subspace.identify import identify_subspace, subspace_covariances
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.fitting.subspace.problem import SubspaceProblem
from thermaltool.fitting.subspace.realization import realizations
from thermaltool.fitting.subspace.search import bounded
from thermaltool.fitting.subspace.sections import PoleSection, all_poles, moved, of_poles
from thermaltool.fitting.subspace.term import response_slopes, response_values
from thermaltool.record import Record
from thermaltool.responses.rational import Rational2
from thermaltool.signals.gauss_newton import solve

PERIOD = 2.0


def plant(poles, inputs, outputs, rng, direct=False):
    """A system with these poles [1/s], one of each pair; every mode of the size of one."""
    blocks = [
        [[p.real, p.imag], [-p.imag, p.real]] if p.imag else [[p.real]] for p in map(complex, poles)
    ]
    A = block_diag(*blocks)
    size = np.repeat([abs(p) for p in map(complex, poles)], [len(b) for b in blocks])
    B = rng.uniform(0.5, 1.5, (len(A), inputs)) * rng.choice([-1, 1], (len(A), inputs))
    C = rng.uniform(0.5, 1.5, (outputs, len(A))) * rng.choice([-1, 1], (outputs, len(A)))
    D = direct * rng.uniform(0.5, 1.5, (outputs, inputs))
    return StateSpace(A, B * size[:, None], C, D)


def steps(inputs, rows, rng, each=15):
    """Inputs that change now and then; the first rows stand still."""
    u = np.repeat(rng.standard_normal((inputs, rows // each + 1)), each, axis=1)[:, :rows]
    u[:, :each] = 0.0
    return u


def log(system, u, rng, noise=0.0, hold="zero", state=None, offset=0.0):
    """A log of a system, with white noise; modes are of the size of one."""
    time = PERIOD * np.arange(u.shape[1])
    *_, y, _ = (None, *lsim(system, u.T, time, X0=state, interp=hold == "first"))
    y = np.atleast_2d(y.T if y.ndim > 1 else y)
    y = y + noise * rng.standard_normal(y.shape) + offset
    ins = names(len(u), hold)
    outs = [f"dT_{k}_K" for k in range(len(y))]
    return Record(time, dict(zip([*ins, *outs], [*u, *y], strict=True)), name="log")


def names(count, hold="zero"):
    return [f"Q_{k}_W" if hold == "zero" else f"T_in{k}_degC" for k in range(count)]


def training(records, inputs, outputs, hold="zero"):
    return even_training_data(records, names(inputs, hold), [f"dT_{k}_K" for k in range(outputs)])


def near(estimate, truth):
    """Within four standard errors, of the logarithm: beside that once in 16 000."""
    error = np.log(estimate.high / estimate.low) / (2 * 1.96)
    return abs(np.log(estimate.value / truth)) < 4 * error


def poles_of(model):
    return np.sort_complex(all_poles(model.sections) / PERIOD)


def expected(poles):
    each = [complex(p) for p in poles]
    return np.sort_complex([*each, *(p.conjugate() for p in each if p.imag)])


MIXED = [-0.2, -0.01 + 0.12j, -0.004]


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize("state", [None, [1.0, -2.0, 0.5, 3.0]])
def test_poles_and_responses_without_noise(hold, direct, state):
    rng = np.random.default_rng(51)
    system = plant(MIXED, 2, 3, rng, direct)
    record = log(system, steps(2, 1500, rng), rng, hold=hold, state=state, offset=20.0)
    data = training([record], 2, 3, hold)
    if state is None:
        data = data.from_rest()
    model = identify_subspace(data, 4, direct)
    np.testing.assert_allclose(poles_of(model), expected(MIXED), rtol=1e-4)
    gains = system.D - system.C @ np.linalg.solve(system.A, system.B)
    for k, output in enumerate(model.outputs):
        found = [output.gain(i).value for i in range(2)]
        np.testing.assert_allclose(found, gains[k], rtol=1e-3)
        assert output.offsets[0] == pytest.approx(20.0, abs=1e-2)
        # The document's own response, at frequencies that the record has.
        w = 1j * np.array([0.002, 0.02, 0.12, 0.3])
        for i in range(2):
            own = [system.C[k] @ np.linalg.solve(s * np.eye(4) - system.A, system.B[:, i])
                   + system.D[k, i] for s in w]  # fmt: skip
            np.testing.assert_allclose(output.term(i).response.transfer(w), own, rtol=5e-3)


def test_subspace_poles_alone_are_near_and_rates_reach_what_is_slow():
    rng = np.random.default_rng(52)
    poles = [-0.1, -0.02 + 0.05j, -0.0005]
    data = training([log(plant(poles, 1, 2, rng), steps(1, 12000, rng, 60), rng, 0.05)], 1, 2)
    slowest = [np.max(r.poles(4).real) / PERIOD for r in realizations(data, 4)]
    spans = sorted({r.span for r in realizations(data, 4)})
    assert spans[:3] == [1.0, 5.0, 25.0]
    assert min(abs(s / -0.0005 - 1) for s in slowest) < 0.2


def test_pieces_logs_and_their_offsets():
    """Two logs, one in three pieces, each with a zero of its own."""
    rng = np.random.default_rng(53)
    system = plant([-0.05, -0.005], 1, 2, rng)
    first = log(system, steps(1, 900, rng), rng, 0.02, offset=5.0)
    other = log(system, steps(1, 700, rng), rng, 0.02, state=[4.0, -3.0], offset=-3.0)
    keep = np.ones(900, bool)
    keep[300:310] = keep[600:604] = False
    parted = first.where(keep)
    data = training([parted, other], 1, 2)
    assert len(data.records) == 4
    model = identify_subspace(data, 2)
    for e, tau in zip(model.outputs[0].time_constant_estimates(), (200.0, 20.0), strict=True):
        assert near(e, tau)
        assert e.high < 1.5 * e.low
    for output in model.outputs:
        assert output.offsets[0] - output.offsets[1] == pytest.approx(8.0, abs=0.3)


def test_slopes_are_those_of_the_criterion():
    rng = np.random.default_rng(54)
    system = plant([-0.2, -0.05 + 0.03j, -0.01], 2, 2, rng, True)
    logs = [log(system, steps(2, 400, rng), rng, 0.1) for _ in range(2)]
    data = training(logs, 2, 2)
    begun = tuple(replace(r, at_rest=k == 0) for k, r in enumerate(data.records))
    problem = SubspaceProblem(replace(data, records=begun), direct=True)
    sections = of_poles(np.array([-0.3 + 0j, -0.08 + 0.05j, -0.08 - 0.05j, -0.03, -0.012]))
    point = problem.project(sections)
    gradient = -sum(f.rows / f.loss * f.pull for f in problem.linearized(point))
    for k in range(5):
        step = 1e-5 * np.eye(5)[k]
        up, down = (problem.project(moved(sections, s)).criterion for s in (step, -step))
        assert gradient[k] == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("zeta", [1 - 1e-7, 1.0, 1 + 1e-7, 1 + 1e-3])
def test_a_double_pole_has_derivatives(zeta):
    section = PoleSection((np.log(0.1), np.log(zeta)))
    weights = np.array([1.0, 0.2])
    names = tuple(response_values([section], weights, None, 1.0))
    slopes = response_slopes([section], weights, None, 1.0, names)
    assert slopes.shape == (4, 4)
    assert np.all(np.isfinite(slopes))


def test_a_section_goes_from_a_pair_to_real_poles():
    """Start on the wrong side of critical damping."""
    rng = np.random.default_rng(55)
    for poles, start in (([-0.02, -0.06], [-0.03 + 0.05j]), ([-0.02 + 0.03j], [-0.01, -0.1])):
        data = training([log(plant(poles, 1, 1, rng), steps(1, 3000, rng), rng, 0.01)], 1, 1)
        given = of_poles(PERIOD * np.array([*start, *np.conj(start)]) if len(start) == 1
                         else PERIOD * np.array(start, complex))  # fmt: skip
        model = identify_subspace(data, 2, beside=[given], found=[])
        assert model.outputs[0].converged
        np.testing.assert_allclose(poles_of(model), expected(poles), rtol=0.1)


def test_bounds_hold_whatever_a_step_is():
    rng = np.random.default_rng(56)
    sections = of_poles(np.array([-0.01, -0.1 + 0.2j, -0.1 - 0.2j, -0.3, -0.5]))
    for _ in range(200):
        there = bounded(moved(sections, rng.uniform(-30, 30, 5)), 1000)
        p = all_poles(there)
        assert np.all(p.real < 0)
        assert np.all(-1 / p.real < 1.01e8)
        assert np.all(np.abs(p.imag) <= 3.0)


def test_lags_cancel_where_their_weights_are_far_above_the_step():
    assert not are_cancelling([Rational2(1.0, 300.0, -0.9, 100.0)])
    assert not are_cancelling([Rational2(60.0, 300.0, -59.0, 290.0)])
    cancelling = Rational2(600.0, 300.0, -599.0, 299.9)
    assert are_cancelling([cancelling])
    # Beside an input that moves the output more, how it does so counts for little.
    both = [cancelling, Rational2(1.0, 300.0, 1.0, 100.0)]
    assert are_cancelling(both, (1.0, 1.0))
    assert not are_cancelling(both, (1.0, 10.0))


@pytest.mark.slow
@pytest.mark.parametrize("refused", ["best", "all"])
def test_modes_that_cancel_are_taken_only_where_all_do(refused, monkeypatch):
    rng = np.random.default_rng(58)
    record = log(plant([-0.01, -0.05], 2, 2, rng), steps(2, 800, rng), rng, 0.02)
    plan = SubspacePlan(initial="rest", real=True)
    data = plan.start(plan.data_sets([record], names(2), ["dT_0_K", "dT_1_K"])[0])
    _, candidates = plan.fit(data)
    orders = [candidate.model.order for candidate in candidates]
    best, second = orders[0], next(order for order in orders if order != orders[0])

    def cancels(responses, moves):
        return refused == "all" or len(responses[0].modes(PERIOD).poles) == best

    monkeypatch.setattr("thermaltool.fitting.subspace.plan.are_cancelling", cancels)
    outputs, _ = plan.fit(data)
    assert outputs[0].order == (best if refused == "all" else second)


@pytest.mark.slow
@pytest.mark.parametrize("direct", [False, True])
def test_the_model_document_runs_as_the_fit_does(direct):
    rng = np.random.default_rng(57)
    record = log(plant(MIXED, 2, 2, rng, direct), steps(2, 1500, rng), rng, 0.02)
    plan = SubspacePlan(modes=4, initial="rest")
    fits = identify([record], names(2), ["dT_0_K", "dT_1_K"], plan)
    model = model_document(fits, None, {})
    assert fits[0].model.has_direct == direct
    run = model.simulate(record)
    for fit in fits:
        own = fit.model.simulate(fit.data.records[0])
        difference = run[fit.model.target] - own
        assert np.ptp(difference) < 1e-6 * np.ptp(own)
        # The covariance of the document's parameters gives the gain the same error.
        covariance, labels = fit.model.response_covariance(1)
        slope = np.array([label in ("K", "K0", "K1", "K2") for label in labels], float)
        wanted = fit.model.gain(1)
        error = np.sqrt(slope @ covariance @ slope)
        assert 1.96 * error == pytest.approx((wanted.high - wanted.low) / 2, rel=1e-3)
        # And the same intervals to the time constants of the lags, the slowest of all and the last.
        each, own_named = fit.model.time_constant_estimates(), dict(fit.model.named())
        for e, name in ((each[0], "tau1"), (each[-1], "tau2")):
            assert (e.low, e.high) == pytest.approx(
                (own_named[name].low, own_named[name].high), rel=1e-4
            )


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))]
)
def test_the_choice_finds_order_and_feedthrough(seed):
    rng = np.random.default_rng([58, seed])
    direct = bool(seed % 2)
    data = training([log(plant([-0.1, -0.01 + 0.06j], 2, 2, rng, direct),
                         steps(2, 2500, rng), rng, 0.1)], 2, 2)  # fmt: skip
    best = choose_order(data)[0].model
    assert best.has_direct == direct
    assert best.order == 3


@pytest.mark.slow
def test_intervals_hold_the_truth_in_coloured_errors_that_outputs_share():
    """At least 75 of 90: at 95 % less happens once in 10⁵, at 93 % once in 2000."""
    rng = np.random.default_rng(59)
    poles = [-0.1, -0.01 + 0.06j]
    system = plant(poles, 1, 2, rng)
    truth, held = np.array([100.0, 10.0]), 0
    for _ in range(45):
        record = log(system, steps(1, 800, rng), rng)
        white = rng.standard_normal((2, 900))
        white[1] = 0.6 * white[0] + 0.8 * white[1]
        coloured = np.zeros_like(white)
        for k in range(1, 900):
            coloured[:, k] = 0.8 * coloured[:, k - 1] + white[:, k]
        columns = dict(record.columns)
        for k in range(2):
            y = columns[f"dT_{k}_K"]
            columns[f"dT_{k}_K"] = y + 0.05 * y.std() * coloured[k, 100:]
        model = identify_subspace(training([replace(record, columns=columns)], 1, 2), 3)
        # Of the pair one: both have the same.
        each = model.outputs[0].time_constant_estimates()[::2]
        held += sum(e.low < t < e.high for e, t in zip(each, truth, strict=True))
    assert held >= 75


def test_covariance_of_white_errors_is_the_inverse_information():
    rng = np.random.default_rng(60)
    data = training([log(plant([-0.1, -0.01], 1, 1, rng), steps(1, 4000, rng), rng, 0.1)], 1, 1)
    problem = SubspaceProblem(data)
    model = identify_subspace(data, 2)
    point = problem.project(model.sections)
    (covariance,), (variance,) = subspace_covariances(problem, point, 2)
    (f,) = problem.linearized(point)
    np.testing.assert_allclose(
        covariance[:2, :2], solve(f.reduced, variance * np.eye(2)), rtol=1e-2
    )


def test_what_data_do_not_carry_is_one_line():
    rng = np.random.default_rng(61)
    record = log(plant([-0.05], 1, 1, rng), steps(1, 1000, rng), rng, 0.05)
    with pytest.raises(FitError, match="1 to 12"):
        identify_subspace(training([record], 1, 1), 13)
    short = training([record.rows(slice(0, 30))], 1, 1)
    with pytest.raises(FitError, match=r"30 rows do not carry 8 modes"):
        identify_subspace(short, 8)


def test_pieces_too_short_for_windows_start_from_single_poles():
    """No piece is long enough for the subspace methods: the grid of time constants is."""
    rng = np.random.default_rng(62)
    record = log(plant([-0.05], 1, 1, rng), steps(1, 600, rng), rng, 0.01)
    keep = np.arange(600) % 17 < 12
    data: TrainingData = training([record.where(keep)], 1, 1)
    assert not realizations(data, 1)
    (e,) = identify_subspace(data, 1).outputs[0].time_constant_estimates()
    assert near(e, 20.0)
    with pytest.raises(FitError, match="long enough for 3 modes"):
        identify_subspace(data, 3)
