"""Shared time constants from simulated logs, as of a measured spindle, in their intervals."""

from __future__ import annotations

import numpy as np
import pytest
from machines.shared_modes import SPINDLE_GAINS, SPINDLE_TAUS, SharedModes

from thermaltool.errors import FitError
from thermaltool.placement.mode_identification import identify_modes
from thermaltool.record import Record

HOUR = 3600.0
SPINDLE = SharedModes(SPINDLE_TAUS, SPINDLE_GAINS)
# The duty of the source, 20 and 15 min, and a cool-down of 12 h.
LONG_COOLING = [(600.0, 0.0), (1200.0, 1.0), (900.0, 0.0), (1200.0, 1.0), (12 * HOUR, 0.0)]
WARM_AND_COOL = [(600.0, 0.0), (8 * HOUR, 1.0), (16 * HOUR, 0.0)]
SHORT = [(600.0, 0.0), (1200.0, 1.0), (900.0, 0.0), (1200.0, 1.0), (900.0, 0.0)]


def identified(duty, seed, modes=None, outputs=tuple(SPINDLE_GAINS)):
    time = np.arange(0.0, sum(duration for duration, _ in duty), 60.0)
    readings = SPINDLE.readings(time, duty, 0.05, np.random.default_rng(seed))
    return identify_modes([Record(time, readings)], ["duty_spindle_1"], outputs, modes)


@pytest.mark.slow
def test_three_time_constants_of_the_spindle_are_found():
    found = identified(WARM_AND_COOL, 7)
    assert len(found.time_constants) == 3
    assert "4 modes" in found.limit
    for e, tau in zip(found.time_constants, SPINDLE_TAUS, strict=True):
        assert e.low < tau < e.high
        assert e.high < 1.1 * e.low
    for k, gains in enumerate(SPINDLE_GAINS.values()):
        expected = np.abs(gains) / np.abs(gains).sum()
        for e, share in zip(found.relative_weight_estimates(k, 0), expected, strict=True):
            assert e.value == pytest.approx(share, abs=0.02)


def test_a_record_of_seventy_minutes_shows_two():
    # A sixth of the slowest time constant: no mode of its own.
    assert len(identified(SHORT, 7).time_constants) == 2


@pytest.mark.slow
def test_a_drift_of_the_room_is_no_mode():
    time = np.arange(0.0, 12 * HOUR, 60.0)
    gains = {name: each[1:] for name, each in SPINDLE_GAINS.items()}
    readings = SharedModes(SPINDLE_TAUS[1:], gains).readings(
        time, [(600.0, 0.0), (5 * HOUR, 1.0), (7 * HOUR, 0.0)], 0.05, np.random.default_rng(7)
    )
    for name in gains:
        readings[name] = readings[name] + 0.5 * time / time[-1]
    found = identify_modes([Record(time, readings)], ["duty_spindle_1"], tuple(gains))
    taus = [e.value for e in found.time_constants]
    assert taus == pytest.approx(SPINDLE_TAUS[1:], rel=0.2)
    assert found.drifts
    assert "is not identified by a log of 4.31e+04 s" in found.limit


@pytest.mark.slow
@pytest.mark.parametrize("duty", [WARM_AND_COOL, LONG_COOLING])
def test_intervals_cover(duty):
    draws = [identified(duty, seed) for seed in range(100, 112)]
    assert all(len(each.time_constants) == 3 for each in draws)
    covered = [
        [e.low < tau < e.high for e, tau in zip(each.time_constants, SPINDLE_TAUS, strict=True)]
        for each in draws
    ]
    # 95 % of 12: fewer than 9 have a probability of 0.2 %.
    assert np.min(np.sum(covered, axis=0)) >= 9


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_readings_that_are_noise_alone_have_no_mode(seed):
    time = np.arange(0.0, 2 * HOUR, 60.0)
    rng = np.random.default_rng(seed)
    readings = {name: 0.05 * rng.standard_normal(len(time)) for name in SPINDLE_GAINS}
    duty = {"duty_spindle_1": (time % HOUR > 1200).astype(float)}
    log = Record(time, {**readings, **duty})
    with pytest.raises(FitError, match="nothing follows duty_spindle_1: a first mode"):
        identify_modes([log], ["duty_spindle_1"], tuple(SPINDLE_GAINS))


def test_too_few_rows_and_nothing_that_moves_are_named():
    time = np.arange(5) * 60.0
    few = Record(time, {"duty_spindle_1": np.array([0.0, 1, 1, 1, 1]),
                        "T_front_degC": 20 + np.arange(5.0) ** 0.5})  # fmt: skip
    with pytest.raises(FitError, match="5 rows do not carry 3 modes"):
        identify_modes([few], ["duty_spindle_1"], ["T_front_degC"], 3)
    still = Record(np.arange(100) * 60.0, {"duty_spindle_1": np.arange(100) % 2.0,
                                           "T_front_degC": np.full(100, 20.0)})  # fmt: skip
    with pytest.raises(FitError, match="T_front_degC is constant"):
        identify_modes([still], ["duty_spindle_1"], ["T_front_degC"])
