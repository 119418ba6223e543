"""Poles that take one combination of the inputs each: plants are those of scipy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.document import model_document
from thermaltool.fitting.identification import identify
from thermaltool.fitting.selection import Candidate
from thermaltool.fitting.subspace.choose import CLOSE, _settled, choose_order
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.modal import grown, identify_modal
from thermaltool.fitting.subspace.modal_problem import ModalProblem, ModalStart
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.fitting.subspace.problem import SubspaceProblem
from thermaltool.record import Record

PERIOD = 2.0
# One combination of three inputs for each mode, one weight for each of four outputs.
RATES = np.array([0.3, 0.06, 0.01])
DRIVES = np.array([[1.0, -0.5, 0.2], [0.3, 1.0, 0.6], [0.8, 0.4, -0.9]])
SHAPES = np.array([[1.0, 0.4, 0.8], [-0.6, 1.0, 0.5], [0.5, -0.7, 1.0], [0.9, 0.8, -0.4]])


def modes():
    return StateSpace(-np.diag(RATES), DRIVES * RATES[:, None], SHAPES, np.zeros((4, 3)))


def wall(nodes=14):
    """Nodes in a row that lose heat to the air, heated in two places, read in five."""
    A = np.diag(np.full(nodes - 1, 1.0), 1)
    A = A + A.T
    A -= np.diag(A.sum(axis=1) + 0.03)
    B = np.zeros((nodes, 2))
    B[1, 0] = B[8, 1] = 1.0
    return StateSpace(0.08 * A, 0.08 * B, np.eye(nodes)[[0, 3, 6, 10, 13]], np.zeros((5, 2)))


def log(system, rng, rows=1200, noise=0.0, state=None, colour=0.0):
    """A log under steps; the first rows stand still. And the outputs without noise."""
    inputs = system.B.shape[1]
    u = np.repeat(rng.standard_normal((inputs, rows // 20 + 1)), 20, axis=1)[:, :rows]
    u[:, :20] = 0.0
    time = PERIOD * np.arange(rows)
    clean = lsim(system, u.T, time, X0=state, interp=False)[1].T
    e = rng.standard_normal(clean.shape)
    for k in range(1, rows):
        e[:, k] = colour * e[:, k - 1] + np.sqrt(1 - colour**2) * e[:, k]
    y = clean + noise * clean.std(axis=1, keepdims=True) * e + 7.0
    columns = dict(zip([*ins(inputs), *outs(len(y))], [*u, *y], strict=True))
    return Record(time, columns, name="log"), clean + 7.0


def ins(count):
    return [f"Q_{k}_W" for k in range(count)]


def outs(count):
    return [f"dT_{k}_K" for k in range(count)]


def training(records, inputs=3, outputs=4):
    return even_training_data(records, ins(inputs), outs(outputs))


def of_order(data, order, direct=False):
    return next(model for model in grown(data, order, direct) if model.order == order)


@pytest.mark.parametrize("state", [None, [1.0, -2.0, 1.5]])
def test_poles_and_gains_without_noise(state):
    data = training([log(modes(), np.random.default_rng(81), state=state)[0]])
    data = data if state is not None else data.from_rest()
    model = identify_modal(data, of_order(data, 3))
    output = model.outputs[2]
    found = [e.value for e in output.time_constant_estimates()]
    np.testing.assert_allclose(found, 1 / RATES[::-1], rtol=1e-3)
    gains = SHAPES @ DRIVES
    for own, expected in zip(model.outputs, gains, strict=True):
        np.testing.assert_allclose([own.gain(i).value for i in range(3)], expected, rtol=5e-3)
        assert own.offsets[0] == pytest.approx(7.0, abs=5e-3)


def test_slopes_are_those_of_the_criterion():
    """Two logs, one from rest, offsets of their own, every third row."""
    rng = np.random.default_rng(82)
    data = training([log(modes(), rng, 400, 0.1)[0] for _ in range(2)])
    data = replace(data, records=tuple(replace(r, at_rest=r.origin == 0) for r in data.records))
    problem = ModalProblem(SubspaceProblem(data, stride=3))
    own = rng.standard_normal((3, 3))
    start = ModalStart(
        np.log(np.array([0.4, 0.15, 0.03])), own / np.linalg.norm(own, axis=1, keepdims=True)
    )
    point = problem.project(start)
    gradient = -sum(f.rows / f.loss * f.pull for f in point.linearized)

    def criterion(step):
        turned = np.einsum("nt,ntm->nm", step[3:].reshape(3, 2), point.tangents)
        there = ModalStart(start.rates + step[:3], start.participations + turned)
        return problem.project(there).criterion

    for k in range(9):
        step = 1e-4 * np.eye(9)[k]
        own_slope = (criterion(step) - criterion(-step)) / 2e-4
        assert gradient[k] == pytest.approx(own_slope, rel=2e-3, abs=1e-3 * np.abs(gradient).max())


def test_intervals_hold_the_truth_and_are_narrower_than_with_weights_free():
    data = training([log(modes(), np.random.default_rng(83), noise=0.05)[0]]).from_rest()
    model = identify_modal(data, of_order(data, 3))
    free = identify_subspace(data, 3, beside=[model.sections])
    gains = SHAPES @ DRIVES
    for k, (own, other) in enumerate(zip(model.outputs, free.outputs, strict=True)):
        for i in range(3):
            e, wide = own.gain(i), other.gain(i)
            error = (e.high - e.low) / 3.92
            assert abs(e.value - gains[k, i]) < 4 * error
            assert error < 1.01 * (wide.high - wide.low) / 3.92
        for e, tau in zip(own.time_constant_estimates(), 1 / RATES[::-1], strict=True):
            assert abs(np.log(e.value / tau)) < 4 * np.log(e.high / e.low) / 3.92
    assert model.criteria.bic < free.criteria.bic


@pytest.mark.slow
def test_an_output_that_follows_an_input_at_once_does_so_beside_the_poles():
    """As a flow follows its valve: a fast pole, which a held input reaches a row later, has not."""
    system, at_once = modes(), np.zeros((4, 3))
    at_once[1, 2], at_once[3, 0] = 1.5, -0.8
    system = StateSpace(system.A, system.B, system.C, at_once)
    data = training([log(system, np.random.default_rng(89), noise=0.05)[0]]).from_rest()
    model = identify_modal(data, of_order(data, 3, True))
    assert model.has_direct
    for k, output in enumerate(model.outputs):
        errors = np.sqrt(np.diag(output.covariance))[-3:]
        assert np.all(np.abs(output.direct - at_once[k]) < 4 * errors)
        assert np.all(errors < 0.05)
        for i, gain in enumerate((SHAPES @ DRIVES + at_once)[k]):
            e = output.gain(i)
            assert abs(e.value - gain) < 4 * (e.high - e.low) / 3.92
    without = identify_modal(data, of_order(data, 5))
    assert model.criteria.bic < without.criteria.bic
    (best, *_) = choose_order(data, orders=[3])
    assert best.model.has_direct
    assert best.model.participations is not None


def test_units_of_the_inputs_do_not_matter():
    record = log(modes(), np.random.default_rng(84), noise=0.05)[0]
    columns = dict(record.columns)
    columns["Q_1_W"] = 1e4 * columns["Q_1_W"]
    other = Record(record.time, columns, name="log")
    one, two = (of_order(training([r]).from_rest(), 3) for r in (record, other))
    for a, b in zip(one.outputs, two.outputs, strict=True):
        assert b.gain(1).value == pytest.approx(a.gain(1).value / 1e4, rel=1e-3)
        assert b.gain(0).value == pytest.approx(a.gain(0).value, rel=1e-3)


@pytest.mark.slow
def test_of_a_wall_more_poles_with_fewer_weights_predict_better():
    """Free weights for every input and output take what is scarce for what is the same."""
    better = []
    for seed in range(3):
        rng = np.random.default_rng([85, seed])
        record, clean = log(wall(), rng, 2000, 0.03, colour=0.8)
        data = training([record.rows(slice(0, 1200))], 2, 5).from_rest()
        candidates = choose_order(data)
        assert candidates[0].model.participations is not None
        free = next(c.model for c in candidates if c.model.participations is None)
        errors = []
        for fitted in (
            identify_modal(data, candidates[0].model),
            identify_subspace(data, free.order, free.has_direct, [free.sections]),
        ):
            going_on = replace(record, at_rest=True)
            run = np.array([output.simulate(going_on) for output in fitted.outputs])
            errors.append(np.sqrt(np.mean((run - clean)[:, 1200:] ** 2)))
        better.append(errors[0] < errors[1])
    assert sum(better) >= 2


@pytest.mark.slow
def test_a_number_of_poles_that_is_given_is_reached():
    """Poles are grown up to it, also where those before it do not pay."""
    data = training([log(modes(), np.random.default_rng(20261126), rows=400, noise=0.3)[0]])
    found = choose_order(data.from_rest(), [8])
    assert [c for c in found if c.model.participations is not None]


@pytest.mark.slow
def test_identify_takes_them_and_writes_them():
    record, clean = log(wall(), np.random.default_rng(86), 1500, 0.02)
    fits = identify([record], ins(2), outs(5), SubspacePlan(real=True))
    assert fits[0].model.participations is not None
    document = model_document(fits, None, {})
    assert len(document.terms) == 10
    run = np.array([fit.model.simulate(replace(record, at_rest=True)) for fit in fits])
    assert np.all(np.std(run - clean, axis=1) < 0.02 * np.std(clean, axis=1))


def test_one_input_or_output_alone_has_weights_free():
    rng = np.random.default_rng(87)
    record = log(modes(), rng, 300, 0.05)[0]
    data = even_training_data([record], ins(1), outs(2)).from_rest()
    found = choose_order(data, orders=[1, 2])
    assert all(c.model.participations is None for c in found)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_intervals_hold_the_truth_in_repetitions(colour):
    held, gains = [], SHAPES @ DRIVES
    for k in range(80):
        rng = np.random.default_rng([88, k])
        data = training([log(modes(), rng, 800, 0.1, colour=colour)[0]]).from_rest()
        outputs = identify_modal(data, of_order(data, 3)).outputs
        taus = outputs[0].time_constant_estimates()
        held += [e.low < 1 / r < e.high for e, r in zip(taus, RATES[::-1], strict=True)]
        each = [(own.gain(i), gains[j, i]) for j, own in enumerate(outputs) for i in range(3)]
        held += [e.low < truth < e.high for e, truth in each]
    assert 0.91 < np.mean(held) < 0.98


@pytest.mark.parametrize("apart", [0.0, 2 * CLOSE])
@pytest.mark.parametrize(("scale", "missing"), [(1.0, 0), (1.0, 120), (1e3, 120)])
def test_where_both_kinds_are_close_all_rows_decide(apart, scale, missing):
    """Of a plant whose poles take one combination each, free weights are parameters for nothing."""
    rng = np.random.default_rng(86)
    record = log(modes(), rng, noise=0.05)[0]
    columns = {n: v * (scale if n.startswith("dT") else 1.0) for n, v in record.columns.items()}
    columns["dT_0_K"] = columns["dT_0_K"].copy()
    columns["dT_0_K"][rng.choice(1200, missing, replace=False)] = np.nan
    data = training([Record(record.time, columns, name="log")]).from_rest()
    combined, free = of_order(data, 3), identify_subspace(data, 3)
    ranked = (Candidate(free, (90.0, 90.0), -5.0), Candidate(combined, (90.0, 90.0), apart - 5.0))
    assert _settled(ranked, data, real=True)[0].model is (free if apart else combined)
    # What held better is not given up for more weights.
    assert _settled(ranked[::-1], data, real=True)[0].model is combined
