"""The shared checks: whatever is registered in `KINDS` has to pass them."""

from __future__ import annotations

import itertools
import pickle
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.ring import panels

from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term, dumps, loads, simulate_response
from thermaltool.responses import KINDS, MORE_RATIONAL, parameter_names, response_class
from thermaltool.responses.modes import Modes

PERIOD, DURATION = 5.0, 8000.0
# What `fit_relaxation` promises, as a share of the largest value of the step response.
TOLERANCE = 3e-5

kinds = pytest.mark.parametrize("kind", [*KINDS, *MORE_RATIONAL])


@cache
def examples(kind):
    """Responses at seven of the places where a fit starts, with gains of both signs."""
    cls = response_class(kind)
    starts = cls.starts(PERIOD, DURATION, **cls.fixed)
    gains = dict(zip(cls.gains, itertools.cycle((3.5, -1.2, 0.004, -0.002, 0.7, 0.3))))
    chosen = [starts[k] for k in np.linspace(0, len(starts) - 1, 5).astype(int)]
    return [
        cls(**dict(zip(cls.searched, place, strict=True)), **gains, **cls.fixed) for place in chosen
    ]


def feedthrough(response):
    return getattr(response, "direct", 0.0)


def size(response):
    return float(np.max(np.abs(response.step(np.geomspace(1e-2, 60 * response.slowest(), 300)))))


@kinds
def test_transfer_is_the_laplace_transform_of_the_step(kind):
    x, w = panels(np.concatenate([[0], np.geomspace(1e-7, 45, 60)]))
    for response in examples(kind):
        for rate in (0.3, 3.0):
            sigma = rate / response.slowest()
            for s in sigma * np.array([1.0, 1 + 1j, 1 - 2j]):
                # s ∫ h(t) e^(−st) dt with x = σt
                integral = np.sum(w * response.step(x / sigma) * np.exp(-s / sigma * x)) / sigma
                got = response.transfer(np.array([s]))[0]
                assert abs(s * integral - got) < 1e-9 * size(response)


@pytest.mark.parametrize(
    "kind",
    [each for each in [*KINDS, *MORE_RATIONAL] if hasattr(response_class(each), "unit_steps")],
)
def test_unit_steps_are_steps_of_one_gain_each(kind):
    cls, times = response_class(kind), np.geomspace(1.0, 1e6, 60)
    x, w = panels(np.concatenate([[0], np.geomspace(1e-7, 45, 60)]))
    for response in examples(kind):
        searched = {name: getattr(response, name) for name in cls.searched}
        steps, steady = cls.unit_steps(times, **searched, **cls.fixed)
        for k, gain in enumerate(cls.gains):
            alone = cls(**searched, **{other: float(other == gain) for other in cls.gains})
            atol = 1e-13 * float(np.max(np.abs(steps[:, k])))
            np.testing.assert_allclose(steps[:, k], alone.step(times), rtol=1e-12, atol=atol)
            assert steady[k] == alone.dc_gain()
            # Of the transfer function, which does not come from the steps.
            rate = 1.0 / response.slowest()
            course = cls.unit_steps(x / rate, **searched, **cls.fixed)[0][:, k]
            got = alone.transfer(np.array([rate]))[0]
            assert abs(np.sum(w * course * np.exp(-x)) - got) < 1e-9 * np.max(np.abs(course))


@kinds
def test_transfer_at_the_conjugate_is_the_conjugate_and_shapes_are_kept(kind):
    s = np.array([[0.01 + 0.2j, 0.3 - 1j, 2.0 + 0j]])
    for response in examples(kind):
        here = response.transfer(s)
        assert here.shape == s.shape
        np.testing.assert_allclose(response.transfer(np.conj(s)), np.conj(here), rtol=1e-13)
        assert response.step(np.ones((2, 3))).shape == (2, 3)


@kinds
def test_starts_at_zero_and_ends_at_the_gain(kind):
    for response in examples(kind):
        direct = feedthrough(response)
        np.testing.assert_array_equal(response.step(np.array([-5.0, 0.0])), [0.0, direct])
        soon = response.step(np.array([1e-9 * response.slowest()]))[0]
        assert abs(soon - direct) < 1e-4 * size(response)
        end = response.step(np.array([60 * response.slowest()]))[0]
        assert end == pytest.approx(response.dc_gain(), rel=1e-8)
        at_zero = response.transfer(np.zeros(1, complex))[0]
        assert at_zero == pytest.approx(response.dc_gain(), rel=1e-12)


@kinds
@pytest.mark.parametrize("dt", [0.1, PERIOD, 50.0, 1000.0])
def test_modes_keep_the_step_within_the_stated_tolerance(kind, dt):
    for response in examples(kind):
        t = np.unique(np.concatenate([dt * np.arange(1, 200), np.geomspace(dt, 6e5, 200)]))
        error = np.max(np.abs(response.modes(dt).step(t) - response.step(t)))
        assert error <= TOLERANCE * size(response)
        assert response.modes(dt).dc_gain() == pytest.approx(
            response.dc_gain(), abs=TOLERANCE * size(response)
        )


@kinds
@pytest.mark.parametrize("dt", [0.5, PERIOD, 300.0])
def test_recursions_follow_step_and_ramp(kind, dt):
    n = 60
    # Modes much faster than the sample live in the first one only.
    first, w_first = panels(np.concatenate([[0], dt * np.geomspace(1e-6, 1, 40)]))
    inside, w = panels(dt * np.arange(1, n + 1))
    for response in examples(kind):
        modes = response.modes(dt)
        t = dt * np.arange(n + 1)
        held, _ = modes.discretize(dt, "zero").run(np.ones((n + 1, 1)))
        # At the first row all is at rest, in a recursion whatever the input is.
        wanted = modes.step(t) - np.append(feedthrough(response), np.zeros(n))
        np.testing.assert_allclose(held[:, 0], wanted, atol=1e-10 * size(response))
        # The response to a ramp is the integral of the response to a step.
        later = (w * modes.step(inside)).reshape(n - 1, -1).sum(1)
        area = np.cumsum([np.sum(w_first * modes.step(first)), *later])
        ramp, _ = modes.discretize(dt, "first").run(t[:, None])
        np.testing.assert_allclose(ramp[1:, 0], area, rtol=1e-9, atol=1e-10 * dt * size(response))


@kinds
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_batch_is_stream(kind, hold):
    u = np.random.default_rng(7).standard_normal((203, 1))
    for response in examples(kind)[::3]:
        recursion = response.modes(PERIOD).discretize(PERIOD, hold)
        batch, last = recursion.run(u)
        x = np.zeros(len(recursion.F))
        stream = [recursion.C @ x]
        for before, now in itertools.pairwise(u):
            x = recursion.F @ x + recursion.G0 @ before + recursion.G1 @ now
            stream.append(recursion.C @ x)
        np.testing.assert_allclose(batch, stream, atol=1e-11 * size(response))
        np.testing.assert_allclose(last, x, rtol=1e-9, atol=1e-11 * np.max(np.abs(x)))
        first, state = recursion.run(u[:91])
        second, _ = recursion.run(u[90:], state)
        np.testing.assert_allclose(
            np.vstack([first, second[1:]]), batch, atol=1e-11 * size(response)
        )


inputs = st.lists(st.floats(-5, 5, width=32), min_size=3, max_size=90).map(np.array)


@kinds
@pytest.mark.parametrize("hold", ["zero", "first"])
@settings(max_examples=12, deadline=None)
@given(u=inputs, wait=st.integers(1, 70))
def test_a_later_input_gives_the_same_output_later(kind, hold, u, wait):
    response = examples(kind)[3]
    u[0] = 0.0
    late = np.concatenate([np.zeros(wait), u])
    now = simulate_response(response, PERIOD * np.arange(len(u)), u, hold)
    later = simulate_response(response, PERIOD * np.arange(len(late)), late, hold)
    np.testing.assert_allclose(later[wait:], now, atol=1e-11 * 5 * size(response))
    np.testing.assert_array_equal(later[:wait], 0.0)


@kinds
@pytest.mark.parametrize("hold", ["zero", "first"])
@settings(max_examples=12, deadline=None)
@given(pair=st.integers(3, 25).flatmap(lambda n: st.tuples(*(
    st.lists(st.floats(-5, 5, width=32), min_size=n, max_size=n).map(np.array) for _ in "ab"
))), gain=st.floats(-3, 3))  # fmt: skip
def test_superposition(kind, hold, pair, gain):
    u, v = pair
    time = np.cumsum(1 + np.arange(len(u)) % 3.0)  # a clock that is not uniform
    response = examples(kind)[4]
    both = simulate_response(response, time, u + gain * v, hold)
    apart = simulate_response(response, time, u, hold)
    apart = apart + gain * simulate_response(response, time, v, hold)
    np.testing.assert_allclose(both, apart, atol=1e-10 * 20 * size(response))


@kinds
def test_any_clock_gives_the_sum_of_steps(kind):
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.choice([0.5, 1.7, 20.0, 400.0], 60))
    u = rng.standard_normal(60)
    changes = np.diff(u, prepend=0.0)
    for response in examples(kind):
        expected = response.step(time[:, None] - time) @ changes
        got = simulate_response(response, time, u, "zero")
        allowed = TOLERANCE * size(response) * np.sum(np.abs(changes))
        np.testing.assert_allclose(got, expected, atol=allowed)


@kinds
def test_the_file_keeps_every_bit(kind):
    for response in examples(kind):
        model = Model(
            (Drive("Q_main_W", "zero", 0.0, (0.0, 1 / 3)),),
            (Output("T_a_degC", "sensor", 0.1 + 0.2, (0.0, 8.0)),),
            (Term("Q_main_W", "T_a_degC", response, np.array([[np.pi]]), (response.gains[0],)),),
            0.1,
        )
        back = loads(dumps(model))
        assert back.terms[0].response == response
        assert dumps(back) == dumps(model)
        assert back.parameters_digest() == model.parameters_digest()


@kinds
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_parameters_are_named(kind, value):
    cls = response_class(kind)
    good = {name: getattr(examples(kind)[0], name) for name in parameter_names(kind)}
    for name in cls.searched:
        with pytest.raises(ModelError, match=rf"{kind}.*\b{name}\b"):
            cls(**{**good, name: value})
    if not np.isfinite(value):
        for name in cls.gains:
            with pytest.raises(ModelError, match=rf"{kind}.*\b{name}\b"):
                cls(**{**good, name: value})


@kinds
@pytest.mark.parametrize(("period", "duration"), [(0.5, 2000.0), (10.0, 600.0), (60.0, 1e6)])
def test_starts_lie_in_the_search_box(kind, period, duration):
    cls = response_class(kind)
    box = cls.search_box(period, duration, **cls.fixed)
    assert set(box) == set(cls.searched)
    assert all(0 < low < high < np.inf for low, high in box.values())
    starts = cls.starts(period, duration, **cls.fixed)
    assert len(set(starts)) > 10
    for place in starts:
        for name, value in zip(cls.searched, place, strict=True):
            low, high = box[name]
            assert low <= value <= high * (1 + 1e-12), (name, value, box[name])


@pytest.mark.parametrize("kind", ["rational0", "rational13", "rational03", "oscillation11",
                                  "oscillations1_2", "oscillations7_0", "direct"])  # fmt: skip
def test_a_family_has_one_name_for_each_and_an_end(kind):
    with pytest.raises(ModelError, match="unknown response"):
        response_class(kind)


def test_a_generated_kind_can_be_pickled():
    response = examples("oscillations3_2_direct")[0]
    assert pickle.loads(pickle.dumps(response)) == response


def test_an_unknown_kind_lists_the_known_ones():
    with pytest.raises(ModelError, match=r"convection.*conduction, slab, rod, deflection"):
        response_class("convection")


def test_a_clock_that_jitters_leaves_nothing_behind():
    """A stream asks for a recursion for every length of a sample; only an even record's is kept."""
    modes = Modes(np.array([-0.1 + 0j]), np.array([1.0 + 0j]))
    for step in np.linspace(1.0, 2.0, 50):
        modes.discretize(float(step))
        modes.run(float(step) * np.arange(20.0), np.ones(20), "zero")
    assert len(modes._last) == 1
