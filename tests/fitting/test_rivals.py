"""Structures side by side, judged by blocks held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.errors import DataError, FitError
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.identification import identify, identify_first
from thermaltool.fitting.rivals import HeldFit, Separate, held_fit
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.model import SubspaceOutput
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.record import Record
from thermaltool.report.identification import identification_table


def quiet(message):
    pass


def swinging(rows=600):
    """A pair of two per cent damping behind an input of steps."""
    rng = np.random.default_rng(20261127)
    u = np.repeat(rng.uniform(-1, 1, rows // 40), 40)
    u[:40] = 0.0
    pole = 0.98 * np.exp(0.3j)
    a = np.poly([pole, pole.conjugate()]).real
    y = lfilter([0.0, a.sum()], a, u)
    return u, y, y + 0.05 * y.std() * rng.standard_normal(rows)


def record_of(u, y, output="dT_a_K"):
    return Record(np.arange(float(len(u))), {"Q_a_W": u, output: y}, name="log")


@pytest.mark.parametrize(("level", "fits", "taken"), [
    (-0.2, (60.0, 70.0), True),
    (-0.05, (60.0, 70.0), False),
    (-0.2, (47.0, 90.0), False),
    (0.2, (60.0, 70.0), False),
])  # fmt: skip
def test_another_structure_has_to_be_decisively_better_and_give_up_no_output(level, fits, taken):
    assert HeldFit(level, fits, (level,)).beats(HeldFit(0.0, (50.0, 65.0), (0.0,))) is taken


@pytest.mark.parametrize(("blocks", "agree"), [
    ((-0.3, -0.2, -0.5, -1.4), True),  # every block gains
    ((-2.0, -1.8, -2.4, 0.05), True),  # the last one stands still
    ((-2.0, 0.3, 0.1, 0.1), False),
    ((-0.9,), False),
    ((-1.5,), True),
])  # fmt: skip
def test_where_heat_acts_the_blocks_have_to_agree_on_pairs(blocks, agree):
    level = float(np.mean(blocks))
    pairs, real = HeldFit(level, (60.0,), blocks), HeldFit(0.0, (50.0,), (0.0,) * len(blocks))
    assert pairs.beats(real)
    assert pairs.beats(real, everywhere=True) is agree


def test_blocks_without_a_reading_leave_the_whole_to_say():
    pairs, real = HeldFit(-2.0, (60.0,), ()), HeldFit(0.0, (50.0,), (0.0, 0.0))
    for other in (real, HeldFit(0.0, (50.0,), ())):
        assert pairs.beats(other, everywhere=True)
        assert not HeldFit(-1.0, (60.0,), ()).beats(other, everywhere=True)


def heated_chain(seed, rows=400):
    """Twelve bodies in a row, one heated, and three of their temperatures."""
    rng = np.random.default_rng(seed)
    conducts, mass = rng.uniform(0.3, 1.5, 11), rng.uniform(20, 80, 12)
    A = np.diag(conducts, 1) + np.diag(conducts, -1)
    A -= np.diag(A.sum(axis=1) + rng.uniform(0, 0.08, 12))
    F = np.linalg.inv(np.eye(12) - A / mass[:, None])
    u = np.repeat(rng.choice([0.0, 50.0, 100.0], rows // 20), 20)
    u[:20] = 0.0
    x, seen = np.zeros(12), np.empty((3, rows))
    for k in range(rows):
        seen[:, k] = x[[1, 5, 9]]
        x = F @ (x + np.eye(12)[2] * u[k] / mass)
    noise = 0.02 * seen.std(axis=1, keepdims=True) * rng.standard_normal(seen.shape)
    names = ["dT_a_K", "dT_b_K", "dT_c_K"]
    return Record(
        np.arange(float(rows)), {"Q_a_W": u, **dict(zip(names, seen + noise, strict=True))}
    ), names


@pytest.mark.slow
def test_bodies_that_conduct_heat_do_not_swing():
    swings = []
    for seed in range(4):
        record, names = heated_chain(seed)
        model = tt.identify(record, ["Q_a_W"], names, warn=quiet).fits[0].model
        roots = [np.roots(f) for f in getattr(model, "F", ()) if len(f) > 1]
        swings.append(
            any(section.is_pair for section in getattr(model, "sections", ()))
            or any(np.any(np.abs(z.imag) > 1e-9 * np.abs(z)) for z in roots)
        )
    assert not any(swings), swings


def test_a_search_over_real_poles_ends_at_real_ones_also_where_the_data_swing():
    u, _, y = swinging()
    data = even_training_data([record_of(u, y)], ["Q_a_W"], ["dT_a_K"]).from_rest()
    assert np.any(identify_subspace(data, 2).outputs[0].poles.imag)
    for order in (2, 3):
        poles = identify_subspace(data, order, real=True).outputs[0].poles
        assert not np.any(poles.imag)
        assert np.all(poles.real < 0)


def test_blocks_held_out_tell_a_pair_from_real_poles():
    u, _, y = swinging()
    data = even_training_data([record_of(u, y)], ["Q_a_W"], ["dT_a_K"]).from_rest()

    def held(real, nf):
        structure = structure_of("oe", real=real)
        orders = structure.orders((1,), nf, (1,))
        return held_fit(data, lambda part: Separate((structure.fit(part, orders),)))

    pair, real = held(False, 2), held(True, 1)
    assert pair.fit_percent[0] > 90
    assert real.fit_percent[0] < 70
    assert pair.beats(real)
    assert not real.beats(pair)


@pytest.mark.slow
def test_heat_that_swings_has_pairs_and_the_table_says_so():
    u, _, y = swinging()
    found = tt.identify(record_of(u, y), ["Q_a_W"], ["dT_a_K"], split=0.6, warn=quiet)
    assert found.fits[0].validation.carried_on.fit_percent > 90
    assert "structure of dT_a_K: " in found.table()
    assert "oe with real poles has" in found.table()
    assert found.document()["models"][0]["chosen_over"]["usual"] == "oe with real poles"
    kept = tt.identify(record_of(u, y), ["Q_a_W"], ["dT_a_K"], split=0.6, real_poles=True,
                       warn=quiet)  # fmt: skip
    assert kept.fits[0].chosen_over is None
    assert "structure of" not in identification_table(kept.fits)


@pytest.mark.slow
def test_a_free_start_has_to_predict_rows_held_out_too():
    """Slow lags from rest in coloured noise, where the first rows do not stand still."""
    rng = np.random.default_rng(20261128)
    rows = 1200
    u = np.repeat(rng.uniform(0, 1, (2, rows // 60)), 60, axis=1)
    u[:, :5] = 0.0
    lags = [lfilter([0, 1 - a], [1, -a], u, axis=1) for a in np.exp(-1 / np.array([400, 60, 9.0]))]
    y = np.array([[1.0, 0.5], [0.4, 1.2]]) @ lags[0] + rng.uniform(0, 1, (2, 2)) @ lags[1] + lags[2]
    y += 0.02 * y.std() * lfilter([0.6], [1, -0.8], rng.standard_normal((2, rows)), axis=1)
    names = ["Q_a_W", "Q_b_W"], ["dT_a_K", "dT_b_K"]
    record = Record(
        np.arange(float(rows)), dict(zip([*names[0], *names[1]], [*u, *y], strict=True))
    )
    plan = SubspacePlan()
    assert all(each.at_rest for each in plan.start(plan.data_sets([record], *names)[0]).records)


@pytest.mark.slow
def test_several_responses_share_their_poles_by_default():
    rng = np.random.default_rng(20261129)
    u = np.repeat(rng.uniform(-1, 1, (2, 40)), 20, axis=1)
    u[:, :20] = 0.0
    lag = lfilter([0, 0.1], [1, -0.9], u, axis=1)
    y = np.array([[1.0, 0.5], [-0.4, 1.2]]) @ lag
    y += 0.05 * rng.standard_normal(y.shape)
    columns = dict(zip(["Q_a_W", "Q_b_W", "dT_a_K", "dT_b_K"], [*u, *y], strict=True))
    record = Record(np.arange(800.0), columns, name="log")
    fits = tt.identify(record, ["Q_a_W", "Q_b_W"], ["dT_a_K", "dT_b_K"], warn=quiet).fits
    assert all(isinstance(fit.model, SubspaceOutput) for fit in fits)
    # A row counts where all outputs have a reading: most of them do, or they do not.
    for every, shared in ((50, True), (3, False)):
        holed = record.columns["dT_a_K"].copy()
        holed[::every] = np.nan
        other = record.with_columns({"dT_a_K": holed})
        fits = tt.identify(other, ["Q_a_W", "Q_b_W"], ["dT_a_K", "dT_b_K"], nan_policy="omit",
                           warn=quiet).fits  # fmt: skip
        assert all(isinstance(fit.model, SubspaceOutput) is shared for fit in fits)


@dataclass(frozen=True, kw_only=True)
class Refusing(SubspacePlan):
    """A plan that has one answer."""

    error: Exception

    def start(self, data):
        raise self.error


class Parted(Refusing):
    """The same, for each output."""

    joint = False


@pytest.mark.parametrize(("error", "tried"), [(FitError("too few"), True),
                                              (DataError("none moves"), False)])  # fmt: skip
def test_another_plan_is_tried_where_the_structure_is_at_fault(error, tried):
    u, _, y = swinging()
    plans = Refusing(error=error), SubspacePlan(modes=2)
    said = []
    if tried:
        identify_first([record_of(u, y)], ["Q_a_W"], ["dT_a_K"], plans, warn=said.append)
        assert len(said) == 1
    else:
        with pytest.raises(DataError, match="none moves"):
            identify_first([record_of(u, y)], ["Q_a_W"], ["dT_a_K"], plans, warn=said.append)


@pytest.mark.parametrize(("error", "message"), [
    (FitError("dT_a_K_2 is odd"), "dT_a_K: dT_a_K_2 is odd"),
    (FitError("dT_a_K is odd", "dT_a_K"), "dT_a_K is odd"),
])  # fmt: skip
def test_an_error_has_the_output_once(error, message):
    u, _, y = swinging()
    with pytest.raises(FitError) as raised:
        identify([record_of(u, y)], ["Q_a_W"], ["dT_a_K"], Parted(error=error))
    assert str(raised.value) == message


@pytest.mark.slow
def test_holes_are_told_of_the_structure_that_was_taken(monkeypatch):
    """Not of one that was replaced."""
    u, _, y = swinging(400)
    y[200] = np.nan
    log = record_of(u, y).with_columns({"dT_b_K": 2.0 * y})
    monkeypatch.setattr("thermaltool.api.identification_plans.MAX_SEPARATE", 0)
    call = {"real_poles": False, "nan_policy": "omit"}
    for refused in (False, True):
        if refused:
            monkeypatch.setattr(SubspacePlan, "start", Refusing(error=FitError("no")).start)
        said = []
        tt.identify(log, "Q_a_W", ["dT_a_K", "dT_b_K"], warn=said.append, **call)
        assert any("a row counts where" in message for message in said) is not refused
        assert any("stands in" in message for message in said) is refused
