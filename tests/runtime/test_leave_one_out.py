"""Filters beside the full one, and the vote on what they predict."""

import numpy as np
import pytest
from faults.streams import PERIOD, machine, pipeline, warming

from thermaltool.control.setpoint import Limits
from thermaltool.estimation.estimator import load_estimator
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.sensing.leave_one_out import LeaveOneOut
from thermaltool.runtime.sensing.vote import Vote
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stepper import Stepper

TICKS, JITTER = round(PERIOD / CLOCK_STEP), round(0.012 / CLOCK_STEP)


@pytest.fixture
def watched():
    return LeaveOneOut(pipeline(3).estimator, PERIOD, (1.0,))


def readings(rows, seed=4):
    return warming(np.random.default_rng(seed), 3, rows) - 20.0


def test_all_sensors_give_the_estimates_of_the_filter_alone(watched):
    values = readings(400)
    expected = load_estimator(dict(machine(3).design)).run(PERIOD * np.arange(400), values)
    watched.start(values[0].tolist())
    found = [watched.step(TICKS, row.tolist()) for row in values[1:]]
    np.testing.assert_allclose(found, expected[1:], atol=1e-9)


def test_a_clock_that_jitters_takes_few_sample_lengths_and_the_same_time(watched):
    rng = np.random.default_rng(5)
    lengths = (TICKS + rng.integers(-JITTER, JITTER, 500)).tolist()
    coarse = [watched._coarse(ticks) for ticks in lengths]
    assert len(set(coarse)) <= 8
    assert abs(sum(coarse) - sum(lengths)) <= watched._grid


def test_a_filter_that_took_a_held_reading_is_not_trusted_next(watched):
    values = readings(600)
    watched.start(values[0].tolist())
    for row in values[1:200]:
        watched.step(TICKS, row.tolist())
    assert watched.can_do_without([0])
    assert watched.can_do_without([1])
    watched.out = {0}
    for row in values[200:400]:
        watched.step(TICKS, [values[199, 0], *row[1:].tolist()])
    assert watched.can_do_without([0])
    assert not watched.can_do_without([1])
    assert np.isnan(watched.residuals[1])


def test_what_is_left_out_is_told_by_the_state(watched):
    values = readings(300)
    watched.start(values[0].tolist())
    watched.out = {2}
    for row in values[1:]:
        watched.step(TICKS, row.tolist())
    again = LeaveOneOut(pipeline(3).estimator, PERIOD, (1.0,))
    again.resume(watched.state())
    assert again.left_out == 2
    with pytest.raises(ValueError, match="not a state"):
        again.resume([*watched.state()[:-1], [[True], 7]])


def test_filters_that_start_beside_a_kept_one_are_not_trusted_until_they_settle(watched):
    """A stream that trusted its sensors has kept the full filter alone."""
    values = readings(4000)
    alone = Stepper(pipeline(3).estimator, PERIOD)
    alone.start(values[0].tolist())
    for row in values[1:1000]:
        alone.step(TICKS, row.tolist())
    watched.resume(alone.state())
    settled = watched.settling_time / PERIOD
    assert settled < 2000
    for k, row in enumerate(values[1000:], 1):
        watched.step(TICKS, row.tolist())
        if k < settled:
            assert np.isnan(watched.residuals).all()
            assert not watched.can_do_without([0])
    assert watched.can_do_without([0])
    # And the other way round: the full one goes on alone.
    alone.resume(watched.state())
    np.testing.assert_array_equal(alone.state(), watched.state()[0])


def test_a_contradiction_counts_by_its_size_and_goes_again():
    vote = Vote([1.0, 1.0, 1.0], patience=10.0)
    for _ in range(9):
        vote.take(1.0, [2.0, 0.5, -0.5])
    assert vote.against is None
    vote.take(1.0, [2.0, 0.5, -0.5])
    assert vote.against == 0
    for _ in range(30):
        vote.take(1.0, [0.1, 0.1, 0.1])
    assert vote.against is None


def test_two_that_differ_alike_accuse_nobody():
    vote = Vote([1.0, 1.0, 1.0], patience=10.0)
    for _ in range(100):
        vote.take(1.0, [2.0, -1.9, 0.5])
    assert vote.against is None


def test_forgotten_is_forgotten():
    vote = Vote([1.0, 1.0], patience=10.0)
    for _ in range(20):
        vote.take(1.0, [3.0, 0.0])
    vote.forget()
    assert vote.against is None
    vote.take(1.0, [3.0, 0.0])
    assert vote.against is None


def test_with_a_sensor_left_out_set_points_go_no_farther_than_the_calibration():
    """The range of the machine's deflection is 0 to 90 um; a heat of 1.5 goes beyond."""
    process = offsets(machine(3), Settings(slew=1e6), Messages(lambda line: None))
    heat = [3.0, 2.0, 1.0]
    for k in range(3000):
        rise = -np.expm1(-k / 400)
        row = [20 + 3 * each * rise for each in heat]
        missing = k > 1000
        process.take(Row(PERIOD * k, [row[0], row[1], np.nan if missing else row[2]], ("",) * 3))
        if k == 1000:
            free = process.values()[0]
    assert free < -100.0
    assert process.status == "reduced"
    assert process.values()[0] == -90.0
    assert Limits(-90.0, 0.0).clip(free) == -90.0


def test_what_is_safe_is_so_with_a_sensor_left_out():
    """It may lie outside what the calibration has seen; a ramp towards it would never end."""
    process = offsets(machine(3), Settings(slew=1e6, safe=50.0), Messages(lambda line: None))
    for k in range(3000):
        read = [20.0, 20.0 if k < 1500 else np.nan, 20.0 if k < 1000 else np.nan]
        process.take(Row(PERIOD * k, read, ("",) * 3))
        if k == 1400:
            assert process.status == "reduced"
    assert process.status == "safe"
    assert process.values()[0] == 50.0
    assert process.at_safe
