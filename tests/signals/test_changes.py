import numpy as np
import pytest

from thermaltool.signals.changes import DOUBLINGS, larger_changes, largest_changes


def test_changes_are_the_largest_of_every_window():
    values = np.cumsum(np.random.default_rng().normal(size=3000))
    for k, change in enumerate(largest_changes([values])):
        windows = np.lib.stride_tricks.sliding_window_view(values, 2**k + 1)
        assert change == pytest.approx(np.ptp(windows, axis=1).max(), rel=1e-12)


def test_a_flicker_between_two_steps_of_a_sensor_counts():
    values = np.full(100, 20.0)
    values[50] = 20.1
    assert largest_changes([values])[0] == pytest.approx(0.1)


def test_pieces_count_apart_and_the_longest_says_how_many():
    assert largest_changes([np.zeros(50), np.full(5, 9.0)]) == (0.0,) * 6
    assert largest_changes([]) == largest_changes([np.ones(1)]) == ()
    assert len(largest_changes([np.arange(2.0**20)])) == DOUBLINGS


def test_the_larger_of_two_never_falls():
    assert larger_changes((1.0, 5.0), (2.0, 3.0, 4.0)) == (2.0, 5.0, 5.0)
    assert larger_changes((), ()) == ()
