"""A pause of a record is rows that nobody has read."""

from __future__ import annotations

import numpy as np

from thermaltool.estimation.pauses import MAX_ROWS_OF_PAUSE, with_pauses


def test_a_pause_has_rows_without_readings_and_the_others_stay():
    time = np.r_[0.0:40.0:2.0, 60.5:100.0:2.0]
    readings = np.column_stack([time, -time])
    clock, filled, there = with_pauses(time, readings)
    assert clock[there].tolist() == time.tolist()
    assert filled[there].tolist() == readings.tolist()
    assert np.isnan(filled[~there]).all()
    assert np.count_nonzero(~there) == 10
    assert np.all(np.abs(np.diff(clock) - 2.0) < 0.2)


def test_a_lost_line_is_no_pause_and_a_long_one_has_long_samples():
    time = np.delete(np.arange(0.0, 60.0, 2.0), [7, 20])
    clock, _, there = with_pauses(time, time[:, None])
    assert there.all()
    assert clock is time
    for rows in (200, 20, 4):
        time = np.r_[0:rows, 86400 : 86400 + rows].astype(float)
        clock, _, there = with_pauses(time, time[:, None])
        assert np.count_nonzero(~there) == min(MAX_ROWS_OF_PAUSE, 2 * rows - 4)
        assert np.all(np.diff(clock) > 0)
        # The sample stays that of the record.
        assert np.median(np.diff(clock)) == 1.0
    for few in (time[:0], time[:1]):
        assert with_pauses(few, few[:, None])[2].all()
