from datetime import UTC, datetime

import pytest

from thermaltool.runtime.clocks import ArrivalClock, ColumnClock, PeriodClock, StampClock


def test_arrival_is_on_a_grid_from_the_first_line():
    now = [100.0]
    clock = ArrivalClock(1e-3, monotonic=lambda: now[0])
    times = []
    for now[0] in (100.0, 100.5003, 101.0009):
        times.append(clock.stamp(None))
    assert times == [0.0, 0.5, 1.001]


def test_arrival_goes_on_by_the_wall_clock_after_a_restart():
    first = ArrivalClock(1e-3, monotonic=lambda: 50.0, wall=lambda: 1000.0)
    first.stamp(None)
    first.monotonic, first.wall = lambda: 60.0, lambda: 1010.0
    assert first.stamp(None) == 10.0
    # The machine has been started again: its monotonic clock has too.
    second = ArrivalClock(1e-3, monotonic=lambda: 5.0, wall=lambda: 1025.0)
    second.resume(first.state(), 10.0)
    assert second.stamp(None) == pytest.approx(25.0)
    # A wall clock that was set back does not take the stream back.
    third = ArrivalClock(1e-3, monotonic=lambda: 5.0, wall=lambda: 900.0)
    third.resume(first.state(), 10.0)
    assert third.stamp(None) == 10.0


def test_stamps_keep_their_epoch_over_a_restart():
    first, second = StampClock(0), StampClock(0)
    assert first.stamp([b"2026-01-01 10:00:00"]) == 0.0
    second.resume(first.state(), 0.0)
    assert second.stamp([b"2026-01-01 10:00:02.5"]) == 2.5
    assert second.epoch == datetime(2026, 1, 1, 10)


def test_stamps_of_a_pattern_and_with_a_zone():
    assert StampClock("t", "%d.%m.%Y %H:%M").stamp({"t": "03.01.2026 10:00"}) == 0.0
    clock = StampClock(0, epoch=datetime(2026, 1, 1, tzinfo=UTC))
    # The clock on the wall goes on, with a zone or without.
    assert clock.stamp([b"2026-01-01T00:00:05"]) == 5.0
    assert clock.stamp([b"2026-01-01T00:00:06Z"]) == 6.0


def test_a_period_goes_on_after_a_restart():
    clock = PeriodClock(0.5)
    clock.resume({}, 7.0)
    assert clock.stamp(None) == 7.5


def test_a_column_that_is_no_time():
    with pytest.raises(ValueError, match="no time"):
        ColumnClock(0, float).stamp([b"nan"])
