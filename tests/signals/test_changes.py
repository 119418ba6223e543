import numpy as np
import pytest
from scipy.signal import medfilt

from thermaltool.signals.changes import DOUBLINGS, larger_changes, largest_changes


def test_changes_are_the_largest_of_every_window():
    values = np.cumsum(np.random.default_rng().normal(size=3000))
    smooth = medfilt(values, 3)[1:-1]
    for k, change in enumerate(largest_changes([values])):
        windows = np.lib.stride_tricks.sliding_window_view(smooth, 2**k + 1)
        assert change == pytest.approx(np.ptp(windows, axis=1).max(), rel=1e-12)


def test_one_reading_that_is_off_is_no_change():
    values = np.arange(100.0)
    values[50] += 1e3
    assert largest_changes([values])[0] == 2.0


def test_pieces_count_apart_and_the_longest_says_how_many():
    assert largest_changes([np.zeros(50), np.full(5, 9.0)]) == (0.0,) * 6
    assert largest_changes([]) == largest_changes([np.ones(1)]) == ()
    assert len(largest_changes([np.arange(2.0**20)])) == DOUBLINGS


def test_the_larger_of_two_never_falls():
    assert larger_changes((1.0, 5.0), (2.0, 3.0, 4.0)) == (2.0, 5.0, 5.0)
    assert larger_changes((), ()) == ()
