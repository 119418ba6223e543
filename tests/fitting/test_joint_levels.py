"""Which logs of a joint are of the reference level: by each drive's own levels, rest aside."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import FitError
from thermaltool.fitting.joint_levels import reference_logs
from thermaltool.model import Drive
from thermaltool.record import Record

HEAT, SPEED, ROWS = "Q_main_1", "n_main_rpm", 100


def log(heat, speed=None):
    """Rest in the first rows, then these."""
    begun = np.arange(ROWS) >= 5
    columns = {HEAT: np.where(begun, heat, 0.0)}
    if speed is not None:
        columns[SPEED] = np.full(ROWS, speed)
    return Record(10.0 * np.arange(ROWS), columns)


def chosen(*logs):
    drives = [Drive(c, "zoh", 0.0, (0.0, 0.0)) for c in logs[0].columns]
    return reference_logs(logs, drives)


def test_the_middle_level_is_the_reference():
    assert chosen(log(0.4), log(0.7), log(1.6)) == [False, True, False]
    assert chosen(log(0.4), log(1.6)) == [True, False]


def test_a_drive_of_another_unit_at_one_level_says_nothing_of_it():
    assert chosen(log(0.4, 3e3), log(0.7, 3e3), log(1.6, 3e3)) == [False, True, False]


def test_a_log_at_rest_is_no_level():
    assert chosen(log(0.001), log(0.4), log(0.7), log(1.6)) == [True, False, True, False]
    with pytest.raises(FitError, match="have one"):
        chosen(log(0.0), log(0.7))


def test_levels_that_are_not_set_to_the_digit_are_one():
    logs = [log(level) for level in (0.700, 0.705, 0.710, 1.0, 1.6)]
    assert chosen(*logs) == [False, False, False, True, False]
    with pytest.raises(FitError, match="have one"):
        chosen(log(0.69), log(0.71))


def test_a_power_that_is_measured_is_one_level():
    noise = 1 + 0.02 * np.random.default_rng(1).normal(size=(3, ROWS))
    logs = [log(level * own) for level, own in zip((0.4, 0.7, 1.6), noise, strict=True)]
    assert chosen(*logs) == [False, True, False]


def test_a_switch_between_rows_makes_no_second_level():
    half = np.where(np.arange(ROWS) == 5, 0.5, 1.0)
    assert chosen(log(0.4 * half), log(0.7 * half), log(1.6 * half)) == [False, True, False]
    with pytest.raises(FitError, match="have one"):
        chosen(log(0.7 * half))


def test_several_levels_in_every_log_are_fitted_together():
    steps = np.repeat([0.4, 1.0], ROWS // 2)
    assert chosen(log(steps), log(2 * steps)) == [True, True]


def test_drives_that_go_in_proportion_are_refused():
    logs = [
        Record(10.0 * np.arange(ROWS), {HEAT: np.full(ROWS, q), SPEED: np.full(ROWS, 3e3)})
        for q in (0.4, 0.7, 1.6)
    ]
    with pytest.raises(FitError, match=r"Q_main_1 and n_main_rpm go in proportion: [^\n]*$"):
        chosen(*logs)
