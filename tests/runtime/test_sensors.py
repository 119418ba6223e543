import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermaltool.runtime.messages import Messages
from thermaltool.runtime.sensing.sensors import SensorChannel, widened


def sensor(**kept):
    said = []
    kept = {"bounds": (-3.0, 27.0), "hold": 10.0, **kept}
    each = SensorChannel("dT_pair1_K", report=lambda channel, message: said.append(message), **kept)
    return each, said


def test_a_bad_reading_is_held_then_lost_then_good_again():
    each, said = sensor()
    states = []
    for time, reading in [(0, 1.0), (1, math.nan), (10, 99.0), (11, 99.0), (12, 2.0), (13, 2.0)]:
        each.take(time, reading)
        states.append((each.value, each.held, each.lost))
    assert states == [
        (1.0, False, False),
        (1.0, True, False),
        (1.0, True, False),
        (1.0, True, True),
        (2.0, False, False),
        (2.0, False, False),
    ]
    assert said == [
        "not finite: holding 1.0",
        "out of range: 99 not in -3..27: no good reading for 11 s: safe setpoint",
        "good again",
    ]


@pytest.mark.parametrize("reading", [math.nan, math.inf, -math.inf, -3.1, 27.1])
def test_a_first_reading_that_is_bad_is_lost_at_once(reading):
    each, said = sensor()
    each.take(0.0, reading)
    assert each.lost
    assert math.isnan(each.value)
    assert said[0].endswith("none good yet: safe setpoint")


def test_a_frozen_reading_is_bad_until_it_moves():
    each, said = sensor(frozen_after=5.0, hold=3.0)
    lost = []
    for time in range(12):
        each.take(float(time), 1.5)
        lost.append(each.lost)
    # Good up to 5 s; the hold counts from there.
    assert lost == [False] * 9 + [True] * 3
    each.take(12.0, 1.6)
    assert not each.lost
    assert said[0] == "frozen at 1.5 for 6 s: holding 1.5"
    assert said[-1] == "good again"


def test_the_first_reading_is_the_rest_where_the_model_says_so():
    each, said = sensor(bounds=None, rest=math.nan, calibrated=(0.0, 5.0))
    each.take(0.0, 21.5)
    assert each.rest == 21.5
    for time, reading, held in [(1.0, 31.5, False), (2.0, 31.6, True), (3.0, 16.4, True)]:
        each.take(time, reading)
        assert each.held is held
    assert said[-1] == "out of range: 31.6 not in 16.5..31.5: holding 31.5"


def test_leaving_the_calibrated_range_is_told_once():
    each, said = sensor(bounds=None, calibrated=(0.0, 10.0))
    for time, reading in enumerate([9.0, 10.9, 11.1, 11.2, 11.3, 5.0, 6.0, -1.1]):
        each.take(float(time), reading)
    assert said == [
        "11.1 is outside the calibrated range: the model extrapolates",
        "-1.1 is outside the calibrated range: the model extrapolates",
    ]


@given(st.lists(st.tuples(st.floats(0.01, 20), st.floats()), min_size=1))
def test_what_is_held_is_always_a_good_reading_or_lost(samples):
    each, _ = sensor()
    time = 0.0
    for dt, reading in samples:
        time += dt
        each.take(time, reading)
        assert each.lost or -3 <= each.value <= 27
        assert each.lost or time - each.good_at <= each.hold


def test_a_resumed_sensor_is_the_same():
    kept = {"bounds": None, "rest": math.nan, "calibrated": (0.0, 5.0)}
    each, _ = sensor(**kept)
    each.take(3.0, 20.0)
    other, said = sensor(**kept)
    other.resume(each.state())
    assert other.state() == each.state()
    other.take(4.0, 31.0)
    assert said == ["out of range: 31 not in 15..30: holding 20.0"]
    unseen, _ = sensor()
    assert unseen.state() == {}


def test_messages_never_flood_and_are_counted():
    said, clock = [], [0.0]
    messages = Messages(said.append, "log.csv", burst=3, rate=1.0, now=lambda: clock[0])
    for messages.line in range(1, 11):
        messages("T_degC", "bad")
    assert said == [f"log.csv:{k}: T_degC: bad" for k in (1, 2, 3)]
    clock[0] = 1.5
    messages("", "good")
    assert said[3:] == ["log.csv: 7 more messages left out", "log.csv:10: good"]
    messages("", "again")
    messages.close()
    messages.close()
    assert said[5:] == ["log.csv: 1 more messages left out"]


def test_an_interval_without_width_bounds_nothing():
    assert widened((0.0, 8.0), 1.0) == (-8.0, 16.0)
    assert widened((3.0, 3.0), 1.0) == (-math.inf, math.inf)
