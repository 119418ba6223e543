import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermaltool.responses.sample_clock import CLOCK_STEP, EQUAL_LENGTHS
from thermaltool.runtime.stepper import MAX_CACHED_MATRICES, Stepper

# Sample lengths in clock steps (ns): even stretches, jitter, pauses.
PERIODS = st.lists(
    st.sampled_from([1, 5 * 10**8, 5 * 10**8 + 1, 10**9, 36 * 10**11]) | st.integers(1, 10**11),
    min_size=1,
    max_size=12,
)


def stream(estimator, time, readings):
    stepper = Stepper(estimator, 0.5)
    rows = [stepper.start(readings[0].tolist())]
    ticks = np.round(np.diff(time) / CLOCK_STEP).astype(int).tolist()
    rows += [stepper.step(t, row.tolist()) for t, row in zip(ticks, readings[1:], strict=True)]
    return np.array(rows)


@settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(ticks=PERIODS, seed=st.integers(0, 1000))
def test_stream_equals_batch_for_any_sample_periods(estimator, ticks, seed):
    time = np.concatenate([[0.0], np.cumsum(ticks) * CLOCK_STEP])
    rng = np.random.default_rng(seed)
    readings = rng.normal(3.0, 2.0, (len(time), len(estimator.sensors)))
    batch = estimator.run(time, readings)
    scale = np.max(np.abs(batch), axis=0) + 1e-9
    difference = np.max(np.abs(stream(estimator, time, readings) - batch) / scale)
    # A record takes lengths for one that differ by less than EQUAL_LENGTHS of the shortest.
    assert difference < 10 * EQUAL_LENGTHS


def test_stream_equals_batch_over_a_long_even_record(estimator):
    time = 0.5 * np.arange(5000)
    readings = np.random.default_rng(0).normal(3.0, 0.1, (5000, len(estimator.sensors)))
    batch = estimator.run(time, readings)
    difference = np.abs(stream(estimator, time, readings) - batch)
    assert np.max(difference / np.max(np.abs(batch), axis=0)) < 1e-9


def test_superposition(estimator):
    time = np.cumsum([0.5, 0.5, 0.7, 60.0, 0.5, 0.5])
    rng = np.random.default_rng(0)
    one, two = rng.normal(size=(2, len(time), len(estimator.sensors)))
    both = stream(estimator, time, 2 * one - 3 * two)
    parts = 2 * stream(estimator, time, one) - 3 * stream(estimator, time, two)
    np.testing.assert_allclose(both, parts, rtol=1e-9, atol=1e-9)


def test_a_resumed_stepper_goes_on_as_the_first_would(estimator):
    first, second = Stepper(estimator, 0.5), Stepper(estimator, 0.5)
    reading = [3.0] * len(estimator.sensors)
    first.start(reading)
    first.step(500_000, reading)
    second.resume(first.state())
    assert second.step(700_000, reading) == first.step(700_000, reading)


@pytest.mark.parametrize("state", [[], [0.0], ["x"] * 3, [float("nan")] * 99])
def test_a_state_of_another_estimator_is_refused(estimator, state):
    with pytest.raises(ValueError, match=r"state|convert"):
        Stepper(estimator, 0.5).resume(state)


def test_memory_is_bounded_under_a_jittering_clock(estimator):
    stepper = Stepper(estimator, 0.5)
    stepper.start([0.0] * len(estimator.sensors))
    for k in range(3 * MAX_CACHED_MATRICES):
        stepper.step(500_000 + k, [1.0] * len(estimator.sensors))
    assert len(stepper._matrices) == MAX_CACHED_MATRICES
