"""Clocks: period, bursts, gaps, segments, resampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermaltool.errors import LogError
from thermaltool.logs import Log, resample
from thermaltool.logs.clock import sampling, segments


def log_of(time: np.ndarray, values: np.ndarray) -> Log:
    return Log(
        name="log.csv",
        time=time,
        columns={"T_a_degC": values},
        segments=segments(time),
        digest="",
        lines=np.arange(2, len(time) + 2),
    )


def bursts(count: int, rows: int, step: float, period: float) -> np.ndarray:
    return (period * np.arange(count)[:, None] + step * np.arange(rows)).ravel()


def test_an_even_clock() -> None:
    clock = sampling(0.1 * np.arange(1000))
    assert clock.period == pytest.approx(0.1)
    assert clock.jitter == 0
    assert clock.burst_rows is None


def test_bursts_are_no_gaps_but_a_lost_quarter_of_an_hour_is() -> None:
    time = bursts(100, 3, 4.0, 60.0)
    clock = sampling(time)
    assert (clock.burst_rows, clock.burst_period, clock.period) == (3, 60.0, 4.0)
    assert segments(time) == (slice(0, 300),)
    time[150:] += 900
    assert segments(time) == (slice(0, 150), slice(150, 300))


def test_a_few_pauses_are_gaps_and_no_bursts() -> None:
    time = np.arange(100.0)
    for row in (10, 35, 80):
        time[row:] += 60
    assert sampling(time).burst_rows is None
    assert [part.start for part in segments(time)] == [0, 10, 35, 80]


def test_pauses_without_a_pattern_are_gaps() -> None:
    rows = [5, 40, 12, 80, 3, 150, 25]
    pieces = [np.arange(n) + 1000.0 * i for i, n in enumerate(rows)]
    assert len(segments(np.concatenate(pieces))) == len(rows)


def test_max_gap_is_the_users() -> None:
    time = np.array([0.0, 1, 2, 5, 6])
    assert segments(time) == (slice(0, 5),)
    assert segments(time, 2.5) == (slice(0, 3), slice(3, 5))


def test_few_rows() -> None:
    assert segments(np.empty(0)) == ()
    assert segments(np.zeros(1)) == (slice(0, 1),)
    assert np.isnan(sampling(np.zeros(1)).period)


@given(
    steps=st.lists(st.floats(0.5, 1.5), min_size=2, max_size=50),
    period=st.floats(0.05, 3.0),
    slope=st.floats(-5, 5),
)
def test_resampling_keeps_a_straight_line(steps: list[float], period: float, slope: float) -> None:
    time = np.cumsum(steps)
    even = resample(log_of(time, slope * time), period)
    np.testing.assert_allclose(np.diff(even.time), period, rtol=1e-9)
    assert even.time[0] == time[0]
    assert time[-1] - period < even.time[-1] + 1e-5
    assert even.time[-1] <= time[-1] + 1e-5
    np.testing.assert_allclose(even.columns["T_a_degC"], slope * even.time, atol=1e-4)


def test_resampling_leaves_gaps_and_missing_values() -> None:
    time = np.concatenate([np.arange(10.0), 1000.5 + np.arange(10.0)])
    values = time.copy()
    values[3] = np.nan
    even = resample(log_of(time, values), 0.5)
    assert even.segments == (slice(0, 19), slice(19, 38))
    assert even.time[18] == 9
    assert even.time[19] == 1000.5
    missing = even.time[np.isnan(even.columns["T_a_degC"])]
    assert missing.tolist() == [2.5, 3.0, 3.5]


def test_resampling_needs_an_increasing_clock_and_a_period() -> None:
    with pytest.raises(LogError, match="does not increase"):
        resample(log_of(np.array([0.0, 2, 1]), np.zeros(3)), 1.0)
    with pytest.raises(ValueError, match="above 0 s"):
        resample(log_of(np.arange(3.0), np.zeros(3)), 0.0)


def test_a_clock_that_slows_down_has_no_gaps() -> None:
    logarithmic = np.append(0.0, np.geomspace(1e-5, 1e4, 400))
    assert segments(logarithmic) == (slice(0, 401),)
    dense_then_sparse = np.concatenate([np.arange(0, 1, 0.01), np.arange(1, 100, 1.0)])
    assert segments(dense_then_sparse) == (slice(0, 199),)


@pytest.mark.parametrize("row", [250, 320, 399])
def test_a_gap_in_a_logarithmic_clock_is_one(row: int) -> None:
    time = np.append(0.0, np.geomspace(1e-5, 1e4, 400))
    steps = np.diff(time)
    # The longest step so far, and then a hundred of its neighbours at once.
    steps[row] = 100 * steps[max(row - 4, 0) : row + 5].max()
    assert segments(np.append(0.0, np.cumsum(steps)))[0] == slice(0, row + 1)
