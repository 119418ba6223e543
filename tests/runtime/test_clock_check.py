"""Times that are refused, and clocks that are followed."""

import pytest

from thermaltool.errors import LogError
from thermaltool.runtime.clock_check import ClockCheck, PeriodCheck, SampleClockCheck


def checked(check, times):
    """Seconds, None where refused; what was reported; how far the clock was set."""
    said, shifts = [], []
    check.report = lambda channel, message: said.append(message)
    check.on_set = shifts.append
    return [check.take(time) for time in times], said, shifts


def nobody(channel, message):
    raise AssertionError


def test_seconds_since_the_line_before():
    assert checked(ClockCheck(nobody), [5.0, 5.5, 7.0])[0] == [0.0, 0.5, 1.5]


def test_a_pause_is_reported_and_counts():
    seconds, said, _ = checked(ClockCheck(nobody, max_gap=3.0), [0.0, 3.0, 6.5])
    assert seconds == [0.0, 3.0, 3.5]
    assert said == ["a pause of 3.5 s"]


def test_a_clock_that_was_set_back_is_followed_after_the_hold():
    times = [100.0, 101.0, 2.0, 1.0, 1.5, 3.0, 3.5, 4.0]
    seconds, said, shifts = checked(ClockCheck(nobody, hold=2.0), times)
    # From the earliest refused time on, 1 s: the hold is over at 3.5 s.
    assert seconds == [0.0, 1.0, None, None, None, None, 2.5, 0.5]
    assert said == [
        "time 2 s after 101 s: line ignored",
        "time 1 s after 101 s: line ignored",
        "the clock was set from 101 s to 3.5 s: followed",
    ]
    assert shifts == [-100.0]


def test_a_clock_that_was_set_back_and_then_paused_is_followed():
    check = ClockCheck(nobody, hold=2.0)
    times = [1e5, 1e5 + 1, 1.0, 2.0, 9002.0, 9003.0, 9004.0, 9005.0, 9006.0]
    seconds = checked(check, times)[0]
    assert seconds[2:7] == [None] * 5
    assert seconds[7:] == [3.0, 1.0]


@pytest.mark.parametrize("ahead", [6.0, 1e5])
def test_one_time_far_ahead_is_forgotten(ahead):
    seconds, said, _ = checked(ClockCheck(nobody, expected=1.0), [0.0, ahead, 1.0, 2.0])
    assert seconds == [0.0, None, 1.0, 1.0]
    assert len(said) == 1


def test_a_pause_is_believed_with_the_next_line():
    check = ClockCheck(nobody, expected=1.0, max_gap=10.0)
    seconds, said, shifts = checked(check, [0.0, 1.0, 500.0, 501.0, 502.0])
    assert seconds == [0.0, 1.0, None, 500.0, 1.0]
    assert said == ["time 500 s after 1 s: line ignored", "a pause of 500 s"]
    assert shifts == []


def test_lines_that_come_more_slowly_than_expected_are_not_doubted_for_long():
    seconds, _, _ = checked(ClockCheck(nobody, expected=1.0), [10.0 * k for k in range(9)])
    assert seconds == [0.0, None, 20.0, *[10.0] * 6]


@pytest.mark.parametrize(
    ("pace", "pause", "taken"),
    [(1.0, 2.0, 1.0), (1.0, 3600.0, 3601.0), (0.0, 0.0, 3601.0)],
    ids=["set", "paused", "played"],
)
def test_a_leap_that_the_computer_has_not_seen_is_a_clock_that_was_set(pace, pause, taken):
    """Lines live: an hour ahead at once is no pause. A log that is played has its pauses."""
    wall = 0.0
    check = ClockCheck(nobody, expected=1.0, now=lambda: wall)
    check.report, said = (lambda channel, message: said.append(message)), []
    for k in range(20):
        wall += pace
        assert check.take(float(k)) is not None
    wall += pause
    assert check.take(3619.0) is None
    wall += pace
    assert check.take(3620.0) == taken
    assert ("the clock was set" in said[-1]) == (taken == 1.0)


def test_a_clock_that_was_set_ahead_by_years_is_followed():
    check = ClockCheck(nobody, expected=1.0)
    seconds, said, shifts = checked(check, [0.0, 1.0, 1.7e9, 1.7e9 + 1, 1.7e9 + 2])
    assert seconds == [0.0, 1.0, None, 1.0, 1.0]
    assert shifts == [1.7e9 - 1.0]
    assert said[1] == "the clock was set from 1 s to 1700000001 s: followed"


def test_samples_are_followed_by_their_number():
    check = SampleClockCheck(nobody, min_step=0.5, max_refused=2)
    seconds, said, shifts = checked(check, [10.0, 10.0, 9.0, 9.0, 10.0, 1e6])
    assert seconds == [0.0, None, None, 0.0, 1.0, 1e6 - 10.0]
    assert said == [
        "time 10 s after 10 s: line ignored",
        "the clock was set from 10 s to 9 s: followed",
    ]
    assert shifts == [-1.0]


@pytest.mark.parametrize(("step", "refused"), [(0.92, False), (1.08, False), (0.5, True)])
def test_the_period_is_that_of_the_lines(step, refused):
    check = PeriodCheck(1.0, "log.csv")
    times = [step * k for k in range(21)]
    # Pauses do not move a median.
    times = times[:5] + [time + 30.0 for time in times[5:]]
    if refused:
        with pytest.raises(LogError, match=r"log.csv: lines come each 0.5 s, the period is 1 s"):
            [check.take(time) for time in times]
    else:
        [check.take(time) for time in times]
