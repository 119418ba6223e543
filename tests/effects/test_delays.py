"""A delay is exact on any clock: sums of step responses, without a recursion."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
from effects.machine import HEAT, RESPONSES, X, model

from thermaltool.effects import effect_class
from thermaltool.effects.dynamics import lagged
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.responses.rational import Rational2

RNG = np.random.default_rng(31)
EVEN = 5.0 * np.arange(300)
# Jitter, dropped rows, and a pause of half an hour.
UNEVEN = np.round(np.cumsum(RNG.choice([0.3, 4.1, 5.0, 9.7], 300, p=[0.1, 0.3, 0.5, 0.1])), 3)
UNEVEN[100:] += 1800.0
clocks = pytest.mark.parametrize("time", [EVEN, UNEVEN], ids=["even", "uneven"])
delays = pytest.mark.parametrize("delay", [0.7, 5.0, 13.0, 50.0, 900.0])


def delayed(delay, hold="zero"):
    return model(effect_class("transport_delay")(HEAT, {"delay": delay}), hold=hold)


def levels():
    u = np.repeat(RNG.choice([0.0, 0.3, 1.0], 60), 5)
    u[:5] = 0.0
    return u


def steps(response, time, u, delay):
    """What held levels do that act `delay` later: one step response for each change."""
    return sum(
        change * response.step(time - at - delay)
        for at, change in zip(time, np.diff(u, prepend=0.0), strict=True)
        if change
    )


def ramps(response, time, u, delay):
    """What lines do: as many small steps."""
    pieces = [np.linspace(a, b, 400) for a, b in itertools.pairwise(time)]
    dense = np.unique(np.concatenate(pieces))
    course = np.interp(dense, time, u)
    middle, change = (dense[1:] + dense[:-1]) / 2, np.diff(course)
    moved = change != 0
    since = time[:, None] - middle[moved] - delay
    return response.step(since) @ change[moved]


def rows(machine, record):
    recursion = machine.recursion("", float(np.min(np.diff(record.time))))
    found = []
    for k, t in enumerate(record.time):
        row = {HEAT: float(record.columns[HEAT][k])}
        found.append(recursion.step(float(t), row) if k else recursion.start(float(t), row))
    return {o: np.array([each[o] for each in found]) for o in found[0]}


@clocks
@delays
def test_held_levels_switch_between_samples(time, delay):
    record = Record(time, {HEAT: levels()})
    batch = delayed(delay).simulate(record)
    stream = rows(delayed(delay), record)
    for output, response in RESPONSES.items():
        expected = steps(response, time, record.columns[HEAT], delay)
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(batch[output], expected, rtol=0, atol=1e-7 * size)
        np.testing.assert_allclose(stream[output], expected, rtol=0, atol=1e-7 * size)


@clocks
def test_lines_come_later_too(time):
    time = time[:60]
    u = np.append(0.0, np.cumsum(RNG.standard_normal(59)))
    record = Record(time, {HEAT: u})
    batch, stream = delayed(13.0, "first").simulate(record), rows(delayed(13.0, "first"), record)
    expected = ramps(RESPONSES[X], time, u, 13.0)
    np.testing.assert_allclose(batch[X], expected, rtol=0, atol=1e-5 * np.ptp(expected))
    np.testing.assert_allclose(stream[X], batch[X], rtol=0, atol=1e-9 * np.ptp(expected))


def test_a_delay_of_the_drive_and_one_of_the_response_add_up():
    late = Rational2(8.0, 300.0, -3.0, 1200.0, delay=17.3)
    terms = tuple(replace(t, response=late) for t in delayed(33.1).terms if t.output == X)
    record = Record(UNEVEN, {HEAT: levels()})
    got = replace(delayed(33.1), terms=terms).simulate(record)[X]
    expected = steps(late, UNEVEN, record.columns[HEAT], 33.1)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-7 * np.max(np.abs(expected)))


def test_a_mean_stamped_at_the_end_of_its_sample_acts_a_sample_earlier():
    u = levels()
    early, record = delayed(-5.0), Record(EVEN, {HEAT: u})
    batch, stream = early.simulate(record), rows(early, record)
    moved = model().simulate(Record(EVEN, {HEAT: np.append(u[1:], u[-1])}))
    for output, expected in moved.items():
        np.testing.assert_allclose(batch[output][1:-1], expected[1:-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(stream[output], batch[output], rtol=0, atol=1e-9)


def test_a_line_that_acts_before_its_row_is_refused_by_name():
    with pytest.raises(ModelError, match=f"{HEAT} acts 5 s before its row"):
        delayed(-5.0, "first").recursion()
    recursion = delayed(20.0).recursion()
    recursion.start(0.0, {HEAT: 0.0})
    with pytest.raises(ModelError, match="transport_delay"):
        recursion.ahead({HEAT: 1.0})


@pytest.mark.parametrize("jitter", [0.0, 2.0])
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_a_lag_row_by_row_is_that_of_the_whole_and_needs_no_scipy(monkeypatch, hold, jitter):
    """To rounding; a stream has numpy alone."""
    u = levels()
    time = EVEN + jitter * np.random.default_rng(2).uniform(-1, 1, len(EVEN))
    whole = lagged(time, u, 37.0, hold)
    monkeypatch.setitem(sys.modules, "scipy.linalg.lapack", None)
    memory, rows = {}, range(len(time))
    by_row = [lagged(time[k : k + 1], u[k : k + 1], 37.0, hold, 0.0, memory) for k in rows]
    off = 1e-14 * np.ptp(whole)
    np.testing.assert_allclose(np.concatenate(by_row), whole, rtol=0, atol=off)
