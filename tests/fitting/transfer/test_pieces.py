"""Records in pieces: gaps, several logs, short ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from reference.training import fitted, sampled, training
from scipy.signal import lfilter

from thermaltool.errors import FitError
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.network.identify import identify_network
from thermaltool.fitting.residuals import residual_tests
from thermaltool.fitting.transfer.choose import choose
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.registry import STRUCTURES, structure_of
from thermaltool.record import Record

ORDERS = (1,), 1, (1,)
POLE = np.exp(-1 / 300)


def plant(seed, n=3000, noise=0.01, colour=0.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0, 1, n // 100), 100)
    y = lfilter([0, 1 - POLE], [1, -POLE], u)
    return u, y + noise * lfilter([1], [1, -colour], rng.standard_normal(n))


def pieces(u, y, *parts):
    return training(*((u[p], y[p]) for p in parts))


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("end", [1, 2, 3, 4, 7, 30])
def test_a_short_piece_beside_a_long_one_takes_nothing(structure, end):
    u, y = plant(1)
    whole = fitted(pieces(u, y, slice(0, 2960)), structure, *ORDERS)
    data = pieces(u, y, slice(0, 2960), slice(3000 - end, 3000))
    model = fitted(data, structure, *ORDERS)
    tests, alone = residual_tests(model, data), residual_tests(whole, data)
    assert tests.lags == alone.lags == 25
    assert tests.white_p == pytest.approx(alone.white_p, abs=0.1)
    gain = whole.gain(0)
    assert gain.low < model.gain(0).value < gain.high
    assert model.rows <= whole.rows + end


def test_a_short_piece_does_not_switch_off_the_colour_of_the_errors():
    u, y = plant(3, 6000, colour=0.9)
    whole = fitted(pieces(u, y, slice(0, 6000)), "oe", *ORDERS)
    parted = fitted(pieces(u, y, slice(0, 5990), slice(5992, 6000)), 'oe', *ORDERS)  # fmt: skip
    (a,), (b,) = whole.time_constants(), parted.time_constants()
    assert (b.low, b.high) == pytest.approx((a.low, a.high), rel=0.01)
    assert a.low < 300 < a.high


def test_noise_of_many_pieces_is_not_taken_for_smaller():
    """Rows that the start of a piece takes, and pieces too short to count, are no rows."""
    u, y = plant(4, 6000, noise=0.0074)
    ends = np.cumsum(np.tile([60, 3], 95))
    parts = [slice(a, b) for a, b in zip(np.r_[0, ends[:-1]], ends, strict=True)]
    model = fitted(pieces(u, y, *parts), "oe", *ORDERS)
    assert model.rows == 95 * 59
    assert np.sqrt(model.sigma2) == pytest.approx(0.0074, rel=0.05)


def test_pieces_that_are_all_too_short_are_refused():
    u, y = plant(5)
    parts = [slice(a, a + 4) for a in range(0, 3000, 6)]
    with pytest.raises(FitError, match="no run of inputs with more than 3 readings"):
        fitted(pieces(u, y, *parts), "oe", (2,), 2, (1,))


def test_a_short_log_beside_a_long_one_in_a_network():
    u, y = plant(6)
    parts = slice(0, 2900), slice(2950, 2958)
    data = training(*((u[p], y[p], k) for k, p in enumerate(parts)))
    tests = residual_tests(identify_network(data, 1, ((0.0,),)).outputs[0], data)
    assert tests.lags == 25


@pytest.mark.slow
@pytest.mark.parametrize(("inputs", "lags"), [(1, (300.0, 40.0)), (3, (20.0, 4.0))])
def test_residuals_of_the_true_orders_are_seldom_called_wrong(inputs, lags):
    """At 5 %: of 60 records, or inputs of records, about 3 (8 or 12 are beyond 99 %)."""
    white, independent = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u = np.array([np.repeat(rng.uniform(0, 1, 40), 50) for _ in range(inputs)])
        y = np.zeros(2000)
        for k in range(inputs):
            x = u[k]
            for tau in lags:
                pole = np.exp(-1 / (tau * (1 + 0.3 * k)))
                x = lfilter([0, 1 - pole], [1, -pole], x)
            y += x
        y += 0.1 * y.std() * rng.standard_normal(2000)
        data = training((u, y))
        model = fitted(data, "oe", (2,) * inputs, 2, (1,) * inputs)
        tests = residual_tests(model, data)
        white.append(tests.white_p < 0.05)
        independent += [p < 0.05 for p in tests.independent_p.values()]
    assert sum(white) <= 8
    assert np.mean(independent) <= 12 / 60


@pytest.mark.slow
def test_orders_of_several_logs_with_zeros_of_their_own():
    u, y = plant(7, 4500)
    x = np.exp(-1 / 30)
    y = y + lfilter([0, 0.5 * (1 - x)], [1, -x], u)
    logs = [(u[a : a + 1500], y[a : a + 1500] + zero, k)
            for k, (a, zero) in enumerate(((0, 0.0), (1500, 5.0), (3000, 50.0)))]  # fmt: skip
    choice = choose(training(*logs), OeStructure())
    assert choice[0].model.orders.nf == (2,)
    assert choice[0].fit_percent[0] > 90


def bursts(readings):
    """So many readings every 15 samples, of one lag behind a restless input, a sample late."""
    rng = np.random.default_rng(9)
    u = rng.uniform(0, 1, 1200)
    y = lfilter([0, 0, 0.5], [1, -0.5], u) + 0.01 * rng.standard_normal(1200)
    return pieces(u, y, *(slice(a, a + readings) for a in range(0, 1200, 15)))


def test_bursts_too_short_for_the_choice_of_orders_are_named():
    with pytest.raises(FitError, match="no run of inputs with more than 3 readings"):
        choose(bursts(3), OeStructure())


@pytest.mark.slow
def test_a_delay_that_leaves_no_row_is_not_the_best():
    best = choose(bursts(8), OeStructure())[0].model
    assert best.orders.nk == (2,)
    assert best.rows > 0


def test_logs_without_a_reading_are_no_experiments():
    u, y = plant(10, 1200)
    lost = Record(np.arange(1200.0), {"Q_a_W": u, "d_z_um": np.full(1200, np.nan)})
    logs = [lost, *(lost.with_columns({"d_z_um": y + zero}) for zero in (5.0, 50.0)), lost]
    data = even_training_data(logs, ["Q_a_W"], ["d_z_um"])
    assert [record.origin for record in data.records] == [0, 1]
    assert fitted(data, "oe", *ORDERS).offsets == pytest.approx((5.0, 50.0), abs=0.05)
    with pytest.raises(FitError, match="d_z_um: no reading at all"):
        even_training_data([lost], ["Q_a_W"], ["d_z_um"])


@pytest.mark.slow
def test_a_long_idle_start_is_no_reason_to_give_up():
    u, y = plant(8, 30000)
    u[:13000] = u[0]
    rng = np.random.default_rng(8)
    y = lfilter([0, 1 - POLE], [1, -POLE], u - u[0]) + 0.01 * rng.standard_normal(30000)
    choice = choose(pieces(u, y, slice(0, 30000)), OeStructure())
    assert choice[0].model.orders.nf == (1,)
    assert choice[0].model.orders.nk == (1,)


def test_starts_of_pieces_are_projected_out_one_by_one():
    """As by one dense regression over all pieces, but its size does not grow with them."""
    u, y = plant(9, 400)
    edges = np.linspace(0, 400, 9).astype(int)
    data = pieces(u, y, *(slice(a, b - 1) for a, b in pairwise(edges)))
    problem = Problem(data, structure_of("oe").orders((2,), 2, (1,)))
    poles = np.exp(-1 / np.array([300.0, 20.0]))
    F = np.poly(poles)
    projected = problem.project((F,))
    blocks, rows = [], sum(len(r) - 2 for r in data.records)
    dense, at = np.zeros((rows, 2 + 1 + 2 * 8)), 0
    for k, (piece_u, piece_y) in enumerate(zip(data.u, data.y, strict=True)):
        n = piece_u.shape[1] - 2
        filtered = lfilter([1.0], F, piece_u[0])
        part = slice(at, at + n)
        dense[part, 0], dense[part, 1], dense[part, 2] = filtered[1:-1], filtered[:-2], 1.0
        dense[part, 3 + 2 * k : 5 + 2 * k] = poles ** np.arange(n)[:, None]
        blocks.append(piece_y[0, 2:])
        at += n
    y = np.concatenate(blocks)
    left = y - dense @ np.linalg.lstsq(dense, y, rcond=None)[0]
    assert projected.loss == pytest.approx(float(left @ left), rel=1e-6)
    assert problem.slopes((F,), projected).mixed.shape == (2 + 2 + 1,) * 2


def test_readings_of_inputs_and_of_outputs_in_turn_have_no_row():
    u, y = np.random.default_rng(20261126).standard_normal((2, 200))
    u[::2] = y[1::2] = np.nan
    with pytest.raises(FitError, match="no row has a reading of all inputs and of an output"):
        even_training_data([sampled(("Q_a_W",), u, ("T_a_degC",), y, 1.0)], ["Q_a_W"], ["T_a_degC"])
