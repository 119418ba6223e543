from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermaltool.errors import LogError, OutputError
from thermaltool.report.clock_axis import time_unit
from thermaltool.report.style import (
    choose,
    envelope,
    figure_format,
    new_figure,
    render,
    shortened,
    trace,
    visible,
)


@settings(deadline=None)
@given(st.integers(0, 3000), st.integers(1, 40), st.integers(0, 2), st.integers(0, 2**32))
def test_envelope_keeps_order_ends_and_extremes(n, bins, levels, seed):
    time = np.arange(n, dtype=float)
    values = np.random.default_rng(seed).integers(0, 10**levels, n)
    t, v = envelope(time, values, bins)
    assert len(t) <= max(4 * bins, 2 * bins + 2 + n // bins)
    assert np.all(np.diff(t) > 0)
    np.testing.assert_array_equal(v, values[t.astype(int)])
    if n:
        assert (v.min(), v.max()) == (values.min(), values.max())
        assert (t[0], t[-1]) == (0, n - 1)


def test_a_single_spike_in_a_million_is_drawn():
    values = np.zeros(10**6)
    values[777_777] = 5.0
    t, v = visible(np.arange(10**6, dtype=float), values)
    assert len(t) < 6000
    assert t[np.argmax(v)] == 777_777


def test_a_line_breaks_over_an_outage_and_between_segments():
    time = np.arange(100.0)
    values = np.ones(100)
    values[40:60] = np.nan  # an outage of 20 periods
    values[80] = np.nan  # one reading
    t, _ = visible(time, values, [slice(0, 10), slice(10, 100)])
    breaks = np.flatnonzero(np.isnan(t))
    assert [(t[k - 1], t[k + 1]) for k in breaks] == [(9.0, 10.0), (39.0, 60.0)]


def test_a_slow_channel_in_a_fast_log_is_one_line():
    time = np.arange(2000.0)
    values = np.where(time % 100 == 0, time, np.nan)
    t, v = visible(time, values)
    np.testing.assert_array_equal(t, np.arange(0, 2000, 100))
    np.testing.assert_array_equal(v, t)


def test_nothing_to_see():
    t, v = visible(np.arange(3.0), np.full(3, np.nan))
    assert len(t) == len(v) == 0


@pytest.mark.parametrize(
    ("span", "unit", "length"), [(0, "s", 1), (600, "s", 1), (9060, "min", 60), (1e5, "h", 3600)]
)
def test_time_unit(span, unit, length):
    assert time_unit(span) == (unit, length)


def test_a_long_name_keeps_both_ends():
    assert shortened("T_column front side 12_degC", 15) == "T_colum…12_degC"
    assert shortened("T_a_degC", 15) == "T_a_degC"


def test_choose():
    assert choose(["T_a_K", "T_b_K"], [], "x") == ["T_a_K", "T_b_K"]
    assert choose(["T_a_K", "T_b_K"], ["T_b_K", "T_b_K"], "x") == ["T_b_K"]
    with pytest.raises(LogError, match=r"x: no channel T_c_K \(near: T_b_K, T_a_K\)"):
        choose(["T_a_K", "T_b_K"], ["T_c_K"], "x")


def test_format_by_suffix():
    assert figure_format("a/b.PDF") == "pdf"
    with pytest.raises(OutputError, match=r"b\.bmp: .*\.png, \.svg or \.pdf"):
        figure_format("b.bmp")


def simple():
    figure = new_figure("costs $5 and $6_", 4.0, 3.0)
    trace(figure.subplots(), np.arange(50.0), np.arange(50.0), label="T_$a$b^")
    return figure


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_bytes_are_the_same_every_time_and_settings_are_left_alone(kind):
    import matplotlib

    before = dict(matplotlib.rcParams)
    first = render(simple, kind)
    assert first == render(simple, kind)
    assert first.startswith({"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[kind])
    assert b"CreationDate" not in first
    assert b"dc:date" not in first
    assert dict(matplotlib.rcParams) == before
