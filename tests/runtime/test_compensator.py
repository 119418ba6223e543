import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermaltool.control.setpoint import HYSTERESIS
from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import load_estimator
from thermaltool.runtime.compensation import setpoint_name
from thermaltool.runtime.rows.row import Row

FIXTURES = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def warming(time):
    return 5.0 * -np.expm1(-np.asarray(time) / 30.0)


def take(compensator, time, reading=None, fault=""):
    reading = warming(time) if reading is None else reading
    compensator.take(Row(time, [float(reading)], (fault,)))
    return compensator.values()


def test_setpoints_are_the_negative_of_the_batch_estimates(compensator, model):
    time = 0.5 * np.arange(400)
    estimates = load_estimator(dict(model.design)).run(time, warming(time)[:, None])
    plain, turned = compensator(), compensator(sign=1.0)
    setpoints = np.array([take(plain, float(t)) for t in time])
    np.testing.assert_allclose(setpoints, -estimates[:, 1:], atol=1e-9)
    np.testing.assert_allclose([take(turned, float(t)) for t in time], estimates[:, 1:], atol=1e-9)
    np.testing.assert_allclose(plain.estimates, estimates[-1], atol=1e-9)


def test_actuation_adds_less_than_half_a_micrometre_to_the_error_of_estimation(compensator):
    """0.5 µm steps: residual and error of estimation differ by 0.375 µm at the most."""
    stepped = compensator(step=0.5, slew=10.0)
    worst = 0.0
    for t in 0.5 * np.arange(3000):
        setpoints = take(stepped, float(t))
        worst = max(
            worst, *(abs(s + d) for s, d in zip(setpoints, stepped.estimates[1:], strict=True))
        )
    assert 0.25 < worst <= (0.5 + HYSTERESIS) * 0.5 + 1e-9


def test_lost_readings_end_in_the_safe_setpoint_and_return_at_the_slew_rate(compensator):
    said = []
    slow = compensator(messages=said, slew=2.0, hold=10.0)
    for t in 0.5 * np.arange(2000):
        before = take(slow, float(t))
    assert before[1] < -50
    path = [before]
    for k in range(1, 301):
        path.append(take(slow, 999.5 + 0.5 * k, math.nan, "empty"))
    moves = np.abs(np.diff(np.array(path), axis=0))
    assert np.max(moves) <= 2.0 * 0.5 + 1e-9
    assert path[-1] == [0.0, 0.0]
    # Held for 10 s, 20 lines, before it goes.
    assert np.all(np.array(path[:21])[:, 1] < -50)
    back = [take(slow, 1149.5 + 0.5 * k, warming(1000.0)) for k in range(1, 301)]
    moves = np.abs(np.diff(np.array([path[-1], *back]), axis=0))
    assert np.max(moves) <= 2.0 * 0.5 + 1e-9
    assert back[-1][1] < -50
    assert [message.split(": ", 2)[2] for message in said] == [
        f"empty: holding {float(warming(999.5))!r}",
        "empty: no good reading for 10.5 s: safe setpoint",
        "good again",
    ]


@pytest.mark.parametrize(("safe", "end"), [(None, "before"), (0.0, 0.0), (-12.0, -12.0)])
def test_safe_setpoints(compensator, safe, end):
    each = compensator(safe=safe, step=0.5, hold=5.0)
    for t in 0.5 * np.arange(1000):
        take(each, float(t))
    for k in range(1, 6):
        before = take(each, 499.5 + k, math.nan)
    for k in range(6, 20):
        after = take(each, 499.5 + k, math.nan)
    wanted = before if end == "before" else [end, end]
    assert after == wanted
    each.finish()
    assert each.values() == wanted


def test_until_sensors_have_been_good_the_setpoint_is_safe(make_machine, make_kalman, compensator):
    each = compensator(make_machine(make_kalman(2)), safe=3.0)
    each.take(Row(0.0, [math.nan, math.nan], ("empty", "empty")))
    assert each.values() == [3.0, 3.0]
    each.take(Row(1.0, [1.0, 25.0], ("", "")))
    # The first complete record is rest.
    assert each.values() == [0.0, 0.0]
    each.take(Row(2.0, [1.0, 25.0], ("", "")))
    assert each.sensors[1].rest == 25.0


@pytest.mark.parametrize("time", [10.0, 9.5, -1e300, 1e300, None])
def test_a_clock_that_stands_still_or_jumps_is_refused(compensator, time):
    said = []
    each = compensator(messages=said)
    take(each, 9.5, 0.0)
    before = take(each, 10.0)
    estimates = each.estimates
    assert take(each, time, 7.0) == before
    assert (each.time, each.accepted, each.estimates) == (10.0, 2, estimates)
    assert len(said) == 1
    assert "ignored" in said[0]


def test_a_clock_that_was_set_back_is_followed_after_the_hold(compensator):
    said = []
    each, twin = compensator(messages=said, hold=5.0), compensator(hold=5.0)
    for t in 0.5 * np.arange(1000):
        last = take(each, float(t))
        take(twin, float(t))
    answers = [take(each, 0.5 * k, 5.0) for k in range(60)]
    assert answers[:11] == [last] * 11
    assert each.time == 29.5
    # It goes on as after a pause of the same length: no step, nothing lost.
    take(twin, 499.5 + 5.5, 5.0)
    for k in range(1, 49):
        expected = take(twin, 505.0 + 0.5 * k, 5.0)
    np.testing.assert_allclose(answers[-1], expected, atol=1e-6)
    assert [message.split(": ", 1)[1] for message in said] == [
        "time 0 s after 499.5 s: line ignored",
        "the clock was set from 499.5 s to 5.5 s: followed",
    ]


def test_a_pause_is_told_and_does_not_loosen_the_slew_rate(compensator):
    said = []
    each = compensator(messages=said, slew=1.0, max_gap=3.0)
    take(each, 0.0)
    before = take(each, 1.0)
    assert take(each, 3601.0) == before
    after = take(each, 3602.0)
    assert abs(after[1] - before[1]) == pytest.approx(3.0)
    assert said[1] == "<stdin>: a pause of 3601 s"
    assert "the estimate settles" in said[2]
    assert len(said) == 3


def test_silence_goes_to_the_safe_setpoint_at_the_slew_rate(compensator):
    each = compensator(slew=1.0, max_gap=10.0)
    assert each.silence(10.0)[0] is None
    assert each.values() == [0.0, 0.0]
    for t in 0.5 * np.arange(400):
        before = take(each, float(t))
    assert each.silence(5.0)[0] == 204.5
    after = each.values()
    assert abs(after[1] - before[1]) == pytest.approx(5.0)
    assert not each.at_safe
    # A line that comes now has only the time since for its way back.
    back = take(each, 205.0)
    assert abs(back[1] - after[1]) == pytest.approx(0.5)
    each.silence(1000.0)
    while not each.at_safe:
        each.silence(each._moved_at - each.time + 10.0)
    assert each.values() == [0.0, 0.0]


READING = st.floats() | st.floats(-10, 20)


@FIXTURES
@given(
    st.lists(
        st.tuples(
            st.floats(-100, 1e4) | st.none() | st.sampled_from([math.inf, 1e300, 1e7, 1e-6]),
            READING,
        ),
        max_size=30,
    )
)
def test_nothing_makes_a_setpoint_that_is_not_finite_or_outside_its_limits(compensator, samples):
    each = compensator(step=0.5, slew=50.0, limits=(-100.0, 20.0))
    time = 0.0
    for dt, reading in samples:
        each.take(Row(None if dt is None else time + dt, [reading], ("",)))
        time = each.time or 0.0
        assert all(-100.0 <= value <= 20.0 for value in each.values())
        assert all(map(math.isfinite, each.estimates))


def test_estimates_that_are_not_finite_start_again_from_rest(compensator):
    said = []
    each = compensator(messages=said, ranges={"dT_pair1_K": (-math.inf, math.inf)})
    take(each, 0.0, 0.0)
    with np.errstate(all="ignore"):
        take(each, 1.0, 1e308)
        take(each, 2.0, -1e308)
    assert all(map(math.isfinite, each.values()))
    assert any("started again from rest" in message for message in said)
    take(each, 3.0, 0.0)
    take(each, 4.0, 0.0)
    assert all(map(math.isfinite, each.estimates))


@FIXTURES
@given(shift=st.integers(-(10**6), 10**6))
def test_time_shift_changes_nothing(compensator, shift):
    one, other = compensator(), compensator()
    for k in range(20):
        assert take(one, 0.5 * k, 0.1 * k) == take(other, 0.5 * k + shift, 0.1 * k)


def test_a_setpoint_is_named_after_its_deflection():
    assert setpoint_name("d_x_um") == "offset_x_um"
    assert setpoint_name("d_um") == "offset_um"


def test_a_range_for_no_sensor_and_a_design_without_deflection(compensator, model):
    with pytest.raises(ModelError, match=r"a range for T_x_degC, but the sensors .* dT_pair1_K"):
        compensator(ranges={"T_x_degC": (0.0, 1.0)})
    alone = replace(model, outputs=model.outputs[:1])
    with pytest.raises(ModelError, match="no deflection"):
        compensator(alone)


def test_one_stamp_far_ahead_is_refused_and_forgotten(compensator):
    """A day ahead for one line: the next line is where the stream was."""
    said = []
    each, twin = compensator(messages=said), compensator()
    for t in 0.5 * np.arange(100):
        take(each, float(t))
        expected = take(twin, float(t))
    refused = take(each, 86450.0)
    assert refused == expected
    assert take(each, 50.0) == take(twin, 50.0)
    assert len(said) == 1
    assert "line ignored" in said[0]


def test_a_long_pause_is_followed_once_it_is_confirmed(compensator):
    said = []
    each = compensator(messages=said, hold=10.0)
    take(each, 0.0)
    take(each, 1.0)
    for t in 0.5 * np.arange(30):
        take(each, 90000.0 + float(t))
    assert [message.split(": ", 1)[1] for message in said[:2]] == [
        "time 90000 s after 1 s: line ignored",
        "a pause of 89999.5 s",
    ]
    assert "the estimate settles" in said[2]
    assert len(said) == 3


def test_a_pause_saves_up_no_way(compensator):
    """By default the slew rate counts two sample periods, whatever the pause."""
    each = compensator(slew=1.0)
    take(each, 0.0)
    before = take(each, 1.0)
    take(each, 3001.0)
    after = take(each, 3002.0)
    assert after != before
    assert abs(after[1] - before[1]) <= each.policy.slew_gap + 1e-9
    assert each.policy.slew_gap <= 2.0
