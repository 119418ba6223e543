import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermaltool.control.setpoint import HYSTERESIS, Limits, Setpoint, quantized

WANTED = st.floats(-500, 500) | st.sampled_from([math.nan, math.inf, -math.inf])
MOVES = st.lists(st.tuples(WANTED, st.floats(0, 100)), min_size=1, max_size=40)
STEPS = st.sampled_from([0.0, 0.1, 0.5, 1.0, 3.0])


@given(
    moves=MOVES,
    step=STEPS,
    rate=st.floats(0.01, 100) | st.just(math.inf),
    low=st.floats(-100, 0),
    high=st.floats(0, 100),
)
def test_limits_and_slew_rate_are_never_exceeded(moves, step, rate, low, high):
    setpoint = Setpoint(Limits(low, high), rate, step)
    for wanted, dt in moves:
        value, ramp = setpoint.value, setpoint.ramp
        moved = setpoint.move(wanted, dt)
        assert math.isfinite(moved)
        assert low - 1e-9 <= moved <= high + 1e-9
        if math.isfinite(rate):
            assert abs(setpoint.ramp - ramp) <= rate * dt + 1e-9
            assert abs(moved - value) <= rate * dt + 1.25 * step + 1e-9


@given(moves=MOVES, step=STEPS, rate=st.floats(0.01, 100), low=st.floats(-100, 0))
def test_setpoint_stays_within_three_quarters_of_a_step_of_the_ramp(moves, step, rate, low):
    setpoint = Setpoint(Limits(low, 80.3), rate, step)
    for wanted, dt in moves:
        setpoint.move(wanted, dt)
        assert abs(setpoint.value - setpoint.ramp) <= (0.5 + HYSTERESIS) * step + 1e-9


@given(moves=MOVES, step=st.sampled_from([0.1, 0.5, 3.0]), low=st.floats(-100, 0))
def test_every_setpoint_is_a_multiple_of_the_step(moves, step, low):
    setpoint = Setpoint(Limits(low), math.inf, step)
    for wanted, dt in moves:
        value = setpoint.move(wanted, dt)
        assert value == pytest.approx(round(value / step) * step, abs=1e-9)


@given(level=st.integers(-1000, 1000), wanted=st.floats(-500, 500), step=STEPS)
def test_quantizer_is_idempotent_and_keeps_its_own_levels(level, wanted, step):
    start = round(level * step, 9)
    once = quantized(start, wanted, step)
    assert quantized(once, wanted, step) == once
    assert quantized(once, once, step) == once


@given(noise=st.lists(st.floats(-0.12, 0.12), min_size=2))
def test_noise_below_the_hysteresis_does_not_move_the_setpoint(noise):
    """At the border between two levels: without hysteresis each sign change would be a move."""
    setpoint = Setpoint(step=0.5)
    values = {setpoint.move(0.25 + each, 1.0) for each in noise}
    assert values == {0.0}


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_leaves_the_setpoint(wanted):
    setpoint = Setpoint(value=3.0)
    assert setpoint.move(wanted, 1.0) == 3.0
    assert setpoint.move(4.0, 1.0) == 4.0


def test_limits_without_a_multiple_of_the_step_are_refused():
    with pytest.raises(
        ValueError, match=r"no multiple of the step 0\.5 lies between 0\.1 and 0\.4"
    ):
        Setpoint(Limits(0.1, 0.4), step=0.5)
    with pytest.raises(ValueError, match="no value lies between 2 and 1"):
        Limits(2, 1)


@given(value=st.floats(-50, 50), ramp=st.floats(-50, 50), step=STEPS, wanted=st.floats(-50, 50))
def test_a_resumed_setpoint_goes_on_as_the_first_would(value, ramp, step, wanted):
    first = Setpoint(Limits(-40, 40), 1.0, step)
    first.move(value, 60.0)
    first.move(ramp, 3.0)
    second = Setpoint(Limits(-40, 40), 1.0, step)
    second.resume(first.value, first.ramp)
    assert second.move(wanted, 2.0) == first.move(wanted, 2.0)
