"""Choice of orders and delay, forms in continuous time, and what data cannot carry."""

from __future__ import annotations

import re
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference.random_systems import case, fit_percent
from reference.training import fitted, training
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.errors import FitError, LogError, ModelError
from thermaltool.fitting.even_clock import even_records
from thermaltool.fitting.transfer import registry
from thermaltool.fitting.transfer.choose import choose
from thermaltool.fitting.transfer.continuous import ContinuousOeStructure
from thermaltool.fitting.transfer.continuous_term import continuous_term
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.model import simulate_response
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1, Rational2


def data(u, y, dt=1.0, names=None, holds=()):
    return training((u, y), period=dt, inputs=names, holds=holds)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 12))]
)
def test_the_delay_and_a_sufficient_order_are_found(seed):
    known = case(seed, 3000)
    record = data(known.u, known.y)
    best = choose(record, OeStructure())[0].model.orders
    # The slow pole of a stiff one hides the fast one, which moves its output by little.
    if not known.stiff:
        assert best.nk == (known.nk,)
        assert best.nf[0] in (2, 3)
    model = fitted(record, "oe", best.nb, best.nf, best.nk)
    assert fit_percent(known.x, model.respond(known.u[None])) > 98.5


class FixedStructure(OeStructure):
    """OE of nb = nf = 1, whatever is asked for."""

    def orders(self, nb, nf, nk):
        return super().orders((1,) * len(nb), 1, nk)


class RefusingStructure(OeStructure):
    """OE that has no other orders than nb = nf = 1."""

    def orders(self, nb, nf, nk):
        if {*nb} != {1} or nf != 1:
            raise FitError("nb = nf = 1")
        return super().orders(nb, nf, nk)


@pytest.mark.parametrize("structure", [FixedStructure(), RefusingStructure()])
def test_no_candidate_is_listed_that_was_not_fitted_as_listed(structure):
    known = case(0, 1000)
    candidates = choose(data(known.u, known.y), structure)
    assert len(candidates) > 1
    assert {(*each.model.orders.nb, *each.model.orders.nf) for each in candidates} == {(1, 1)}
    assert len({each.model.orders.nk for each in candidates}) == len(candidates)


def test_the_structure_of_the_documentation_as_it_stands(monkeypatch):
    page = (Path(__file__).parents[3] / "docs/development/extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (code,) = (block for block in blocks if "class FopdtStructure" in block)
    (line,) = (block for block in blocks if "StructureEntry(" in block)
    module = types.ModuleType("thermaltool.fitting.transfer.fopdt")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(code, "extending.md", "exec"), module.__dict__)
    ((name, entry),) = eval("{" + line + "}", {"StructureEntry": registry.StructureEntry}).items()
    monkeypatch.setitem(registry.STRUCTURES, name, entry)
    rng = np.random.default_rng(1)
    heat = np.repeat(rng.uniform(0, 100, 20), 60)
    heat[:30] = 0.0
    pole = np.exp(-10 / 300)
    y = lfilter([0, 0, 0, 0, 0.2 * (1 - pole)], [1, -pole], heat)
    columns = {"Q_motor_W": heat, "d_z_um": y + 0.02 * rng.standard_normal(1200)}
    log = tt.Record(10.0 * np.arange(1200), columns)
    (model,) = tt.identify(log, "Q_motor_W", "d_z_um", structure=name).document()["models"]
    assert model["time_constants_s"][0] == pytest.approx(300, rel=0.02)
    assert model["terms"][0]["dead_time_s"] == 30.0
    assert model["orders"]["nb"] == [1]
    with pytest.raises(FitError, match="fopdt has nb = 1"):
        tt.identify(log, "Q_motor_W", "d_z_um", structure=name, orders=[(2, 2, 4)])


def thermal(hold, delay, dt=5.0, rows=3000, seed=3):
    rng = np.random.default_rng(seed)
    response, time = Rational2(3.0, 400.0, 1.0, 40.0, delay), dt * np.arange(rows)
    u = np.repeat(rng.uniform(0, 1, rows // 60), 60)
    if hold == "first":
        u = np.cumsum(u - u.mean()) / 60
    y = simulate_response(response, time, u - u[0], hold)
    return response, time, u, y + 0.01 * np.std(y) * rng.standard_normal(rows) + 20.0


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [0.0, 35.0])
def test_physical_time_constants_and_weights_come_back(hold, delay):
    response, time, u, y = thermal(hold, delay)
    nk = round(delay / 5.0) + (hold == "zero")
    orders = structure_of("oe").orders((2 + (hold == "first"),), 2, (nk,))
    model = structure_of("oe").fit(data(u, y, 5.0, holds=(hold,)).from_rest(), orders)
    way = continuous_term(model, 0)
    assert way.response.kind == "rational2"
    assert way.response.delay == pytest.approx(delay)
    for name in ("tau1", "tau2", "K1", "K2"):
        assert getattr(way.response, name) == pytest.approx(getattr(response, name), rel=0.1)
    again = simulate_response(way.response, time, u - u[0], hold)
    assert fit_percent(y - 20.0, again) > 98.5


def test_a_pole_without_an_equivalent_is_named():
    rng = np.random.default_rng(2)
    u = rng.standard_normal(800)
    y = np.zeros(800)
    for k in range(1, 800):
        y[k] = -0.6 * y[k - 1] + u[k - 1]
    model = fitted(data(u, y), "oe", (1,), 1, (1,))
    assert model.F[0][1] == pytest.approx(0.6, abs=1e-6)
    with pytest.raises(ModelError, match=r"z = -0\.6"):
        continuous_term(model, 0)


@pytest.mark.parametrize("turned", [0.0, 1e-9, -1e-9])
def test_a_pole_that_is_there_twice_becomes_two(turned):
    """Critical damping, to rounding a pair or two values."""
    _, _, u, y = thermal("zero", 0.0)
    found = fitted(data(u, y, 5.0).from_rest(), "oe", (2,), 2, (1,))
    z = np.exp(-5.0 / 200.0)
    twice = replace(found, F=(np.array([1.0, -2 * z, z * z * (1 + turned)]),))
    way = continuous_term(twice, 0)
    assert way.response.kind == "rational2"
    assert way.mismatch < 1e-4
    assert way.response.tau1 == pytest.approx(200.0, rel=2e-2)


def test_rest_is_told_from_a_transient():
    _, _, u, y = thermal("zero", 0.0)
    assert OeStructure().start(data(u, y, 5.0)).records[0].at_rest
    late = slice(150, None)
    assert not OeStructure().start(data(u[late], y[late], 5.0)).records[0].at_rest


STEPPED = {
    "first order": Rational1(1.0, 3000.0),
    "second order": Rational2(1.0, 6000.0, 0.5, 600.0),
    "first order, delayed": Rational1(1.0, 3000.0, 600.0),
    "second order, delayed": Rational2(1.0, 6000.0, 0.5, 600.0, 600.0),
}


def stepped(response, noise, hot=0.0, idle=30, rows=700, dt=60.0):
    """One step of 60 after an idle start, at rest or hot from the past."""
    time = dt * np.arange(rows)
    u = np.where(np.arange(rows) < idle, 0.0, 60.0)
    y = simulate_response(response, time, u, "zero") + hot * np.exp(-time / 3000.0) + 5.0
    return data(u, y + noise * np.random.default_rng(rows).standard_normal(rows), dt)


@pytest.mark.parametrize("noise", [0.0, 0.02, 2.0])
@pytest.mark.parametrize("label", STEPPED)
def test_a_step_after_an_idle_start_is_from_rest(label, noise):
    """The delay alone lets a free state lower the squared error, here by up to a third."""
    assert OeStructure().start(stepped(STEPPED[label], noise)).records[0].at_rest


def test_an_idle_start_that_still_cools_down_is_not_rest():
    cooling = stepped(STEPPED["first order"], 0.02, hot=30.0)
    assert not OeStructure().start(cooling).records[0].at_rest


def test_parts_of_a_record():
    whole = data(np.arange(10.0), np.arange(10.0) ** 2)
    split = whole.split(0.3)
    assert (split.fitted.rows, split.held.rows) == (3, 7)
    assert split.held.y[0][0, 0] == 9.0
    blocks = whole.folds(5)
    assert [fold.held.y[0][0].tolist() for fold in blocks] == [
        [4.0, 9.0], [16.0, 25.0], [36.0, 49.0], [64.0, 81.0]
    ]  # fmt: skip
    assert [len(r) for r in blocks[1].fitted.records] == [4, 4]
    with pytest.raises(FitError, match="split"):
        data(np.arange(3.0), np.arange(3.0)).split(0.01)


def test_an_uneven_clock_is_drawn_and_a_hole_parts():
    time = np.array([0.0, 1.0, 2.0, 3.3, 4.0, 9.0, 10.0])
    y = np.array([0.0, 1.0, 2.0, 3.3, 4.0, np.nan, 7.0])
    parts = list(even_records(Record(time, {"u": time, "y": y}), ("u",), ("y",), 1.0))
    assert [len(p) for p in parts] == [5, 2]
    np.testing.assert_allclose(parts[0].column("y"), [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(parts[1].column("y"), [np.nan, 7.0])


def test_a_missing_input_parts_and_no_line_is_drawn_over_a_missing_output():
    time = np.array([0.0, 1.0, 2.0, 3.3, 4.0, 5.0, 6.0, 7.0])
    u, y = time.copy(), time.copy()
    u[6], y[3] = np.nan, np.nan
    first, last = even_records(Record(time, {"u": u, "y": y}), ("u",), ("y",), 1.0)
    np.testing.assert_array_equal(np.isnan(first.column("y")), [0, 0, 0, 1, 0, 0])
    assert len(last) == 1


GOOD = np.random.default_rng(1).standard_normal(200)
REFUSED = [
    (np.full(200, 4.0), GOOD, (2, 2, 1), "never moves"),
    (GOOD, np.full(200, 4.0), (2, 2, 1), "constant"),
    (GOOD, GOOD, (2, 2, 300), "longer than the record"),
    (GOOD[:20], GOOD[:20], (4, 4, 1), "do not carry"),
    (GOOD, GOOD, (0, 2, 1), "nb counts from 1"),
]


@pytest.mark.parametrize(("u", "y", "orders", "message"), REFUSED)
def test_what_data_cannot_carry_is_refused(u, y, orders, message):
    nb, nf, nk = orders
    for structure in ("oe", "arx"):
        with pytest.raises(FitError, match=message):
            fitted(data(u, y), structure, (nb,), nf, (nk,))


def test_collinear_inputs_are_named_and_others_are_not():
    rng = np.random.default_rng(6)
    a, b = rng.standard_normal((2, 300))
    u = np.array([a, b, 3.0 * a + 1.0])
    record = data(u, a + b, names=("Q_a_W", "Q_b_W", "Q_c_W"))
    with pytest.raises(FitError, match="collinear") as error:
        fitted(record, "oe", (1, 1, 1), 1, (1, 1, 1))
    assert "Q_a_W" in str(error.value)
    assert "Q_c_W" in str(error.value)
    assert "Q_b_W" not in str(error.value)


def test_unequal_lengths_are_refused():
    with pytest.raises(LogError, match="shape"):
        training((np.ones((1, 5)), np.ones(4)))


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("dt", [0.5, 5.0])
def test_continuous_time_gives_the_same_physics(hold, dt):
    response, _, u, y = thermal(hold, 7 * dt, dt, rows=round(15000 / dt))
    nk = 7 + (hold == "zero")
    record = data(u, y, dt, holds=(hold,)).from_rest()
    model = ContinuousOeStructure().fit(record, structure_of("oe").orders((2,), 2, (nk,)))
    assert model.converged
    assert "continuous" in model.method
    way = continuous_term(model, 0)
    assert way.mismatch < 1e-5
    for name in ("tau1", "tau2", "K1", "K2"):
        assert getattr(way.response, name) == pytest.approx(getattr(response, name), rel=0.12)
    slow, fast = model.time_constants()
    assert slow.low < 400.0 < slow.high
    assert fast.low < 40.0 < fast.high


def test_an_irregular_clock_is_cut_at_its_holes_alone():
    generator = np.random.default_rng(8)
    steps = generator.uniform(0.6, 1.4, 600)
    steps[::25] += 1.0  # a row that is not there belongs to such a clock
    steps[300] = 8.0
    time = np.append(0.0, np.cumsum(steps))
    parts = list(even_records(Record(time, {"u": time, "y": time}), ("u",), ("y",), 1.0))
    assert len(parts) == 2
    assert np.allclose(parts[1].columns["y"], parts[1].time)
