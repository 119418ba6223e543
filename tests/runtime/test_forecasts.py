"""Forecasts as a stream: what comes out, and what a stream may do wrong."""

import json
import math
import os
import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.errors import LogError
from thermaltool.runtime.forecasts import GATE, Forecasts
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.settings import Settings
from thermaltool.runtime.stream import open_stream
from thermaltool.timeseries.recursive.arma import RecursiveArma

PHI = 0.9
KNOWN = SimpleNamespace(ar=[PHI], ma=[], mean=0.0, sigma2=1.0)
HEADER = "time_s,e_tool_um\n"


def forecasting(source, sink, emit, p=1, q=0, intercept=False, forgetting=1.0, start=None,
                fitted=100, steps=1, level=0.95, **chosen):  # fmt: skip
    """The stream of a model that learns, or goes on from `start`."""
    settings, messages = Settings(**chosen), Messages(emit)
    model = RecursiveArma(p, q, intercept, forgetting, GATE)
    if start is not None:
        model.begin(start, fitted)
    process = Forecasts("e_tool_um", model, settings, messages, steps, level)
    return open_stream(process, settings, source, sink, messages)


def forecasts(tmp_path, text, **kept):
    """Rows (time, forecast, low, high) and messages for the lines of a stream."""
    source, sink = tmp_path / "in", tmp_path / "out"
    source.write_bytes(text if isinstance(text, bytes) else text.encode())
    messages = []
    with open(source, "rb") as lines, open(sink, "wb") as out:
        number = forecasting(lines.fileno(), out.fileno(), messages.append, **kept).run()
    assert number == 0
    return sink.read_text().splitlines(), messages


def rows(lines):
    assert lines[0] == "time_s,forecast_e_tool_um,low_e_tool_um,high_e_tool_um"
    return np.array([[float(field) for field in line.split(",")] for line in lines[1:]])


def csv_of(values, times=None):
    times = range(len(values)) if times is None else times
    return HEADER + "".join(f"{t},{x}\n" for t, x in zip(times, values, strict=True))


def known(**kept):
    return {"start": KNOWN, "fitted": 10**9, "period": 1.0} | kept


def test_a_known_model_gives_its_forecasts(tmp_path):
    lines, messages = forecasts(tmp_path, csv_of([1, 2, -3]), **known(steps=3))
    got = rows(lines)
    np.testing.assert_array_equal(got[:, 0], [3, 4, 5])
    np.testing.assert_allclose(got[:, 1], PHI**3 * np.array([1, 2, -3]), rtol=1e-6)
    half = 1.959964 * math.sqrt(1 + PHI**2 + PHI**4)
    np.testing.assert_allclose(got[:, 3] - got[:, 1], half, rtol=1e-6)
    np.testing.assert_allclose(got[:, 1] - got[:, 2], half, rtol=1e-6)
    assert messages == []


def test_learns_and_its_intervals_hold(tmp_path):
    a = np.random.default_rng(7).standard_normal(6000)
    x = 30 + lfilter([1, 0.5], [1, -1.2, 0.6], a)
    text = csv_of([f"{v:.6f}" for v in x], [f"{0.0005 * k:.4f}" for k in range(6000)])
    lines, messages = forecasts(tmp_path, text, p=2, q=1, intercept=True, forgetting=0.999)
    got = rows(lines)
    assert messages == []
    assert len(got) > 5950
    at = np.rint(got[:, 0] / 0.0005).astype(int)
    assert np.all(np.diff(at) == 1)
    later = at < 6000
    truth, got = x[at[later]], got[later]
    error = (truth - got[:, 1])[1000:]
    assert np.std(error) < 1.02 * np.std(a[-len(error) :])
    inside = (got[:, 2] <= truth) & (truth <= got[:, 3])
    assert np.mean(inside[1000:]) == pytest.approx(0.95, abs=0.015)


def test_ndjson(tmp_path):
    text = '{"time_s": 0, "e_tool_um": 1}\n{"time_s": 1, "e_tool_um": null}\n'
    lines, messages = forecasts(tmp_path, text, **known(from_format="ndjson", to_format="ndjson"))
    answers = [json.loads(line, parse_constant=pytest.fail) for line in lines]
    assert [answer["time_s"] for answer in answers] == [1.0, 2.0]
    assert answers[1]["forecast_e_tool_um"] == pytest.approx(PHI**2)
    assert messages == ["<stdin>:2: e_tool_um: empty: its forecast stands in"]


def test_a_stream_without_a_clock(tmp_path):
    lines, _ = forecasts(tmp_path, "e_tool_um\n1\n2\n", **known(period=0.5, clock="count"))
    np.testing.assert_array_equal(rows(lines)[:, 0], [0.5, 1.0])


@pytest.mark.parametrize("bad", ["nan", "", "inf", "--", "1e300"])
def test_a_bad_reading_is_bridged_by_its_forecast(tmp_path, bad):
    lines, messages = forecasts(tmp_path, csv_of([1, 2, bad, bad, 4]), **known())
    np.testing.assert_allclose(
        rows(lines)[:, 1], [PHI, 2 * PHI, 2 * PHI**2, 2 * PHI**3, 4 * PHI], rtol=1e-6
    )
    assert len(messages) == 2
    assert messages[0].endswith("its forecast stands in")
    assert messages[1] == "<stdin>:6: e_tool_um: good again"


def test_long_without_readings_gives_no_forecast(tmp_path):
    lines, messages = forecasts(tmp_path, csv_of([1, *["nan"] * 5, 3]), **known(hold=2))
    np.testing.assert_array_equal(rows(lines)[:, 0], [1, 2, 3, 7])
    assert [m.split(": ")[-1] for m in messages] == [
        "its forecast stands in",
        "lags forgotten",
        "good again",
    ]


def test_lacking_samples_are_bridged_and_a_long_pause_forgets(tmp_path):
    text = csv_of([1, 2, 3, 4], [0, 1, 4, 100])
    lines, messages = forecasts(tmp_path, text, **known(p=2, start=SimpleNamespace(
        ar=[PHI, 0.0], ma=[], mean=0.0, sigma2=1.0)))  # fmt: skip
    # two lags are needed: after the pause the one line gives no forecast
    np.testing.assert_array_equal(rows(lines)[:, 0], [2, 5])
    assert messages == ["<stdin>:5: a pause of 96 s: lags forgotten"]


def test_a_time_that_repeats_or_goes_back_is_refused_then_followed(tmp_path):
    times = [10, 11, 11, 10.5, 12, *range(3, 10)]
    lines, messages = forecasts(tmp_path, csv_of([1.0] * 12, times), **known(hold=3))
    np.testing.assert_array_equal(rows(lines)[:, 0], [11, 12, 13, 7, 8, 9, 10])
    assert messages == [
        "<stdin>:4: time 11 s after 11 s: line ignored",
        "<stdin>:7: time 3 s after 12 s: line ignored",
        "<stdin>:10: the clock was set from 12 s to 6 s: followed",
    ]


def test_an_outlier_is_told_and_kept_out(tmp_path):
    lines, messages = forecasts(tmp_path, csv_of([0.5, 1e9, 0.5]), **known())
    np.testing.assert_allclose(rows(lines)[:, 1], [0.45, 0.405, 0.45], rtol=1e-6)
    assert "taken for an outlier" in messages[0]


def test_lines_that_are_none(tmp_path):
    text = b"\xef\xbb\xbf" + HEADER.encode() + b"# note\r\n\r\n0,1\r\nx,2\n1,3,4\n2,5\n3,7"
    lines, messages = forecasts(tmp_path, text, **known())
    # The last line of a file counts without its end, too.
    np.testing.assert_array_equal(rows(lines)[:, 0], [1, 3, 4])
    assert messages == [
        "<stdin>:5: no time on this line: ignored",
        "<stdin>:6: 3 fields instead of 2: ignored",
    ]


def test_random_bytes_never_give_what_is_no_number(tmp_path):
    rng = np.random.default_rng(9)
    words = ["nan", "inf", "1e308", "-1e308", "", "0", "1", "-2.5", "x", "1_0", "9" * 400]
    body = "".join(f"{t},{rng.choice(words)}\n" for t in range(3000))
    lines, _ = forecasts(tmp_path, HEADER + body, p=3, q=2, intercept=True, forgetting=0.95)
    assert np.all(np.isfinite(rows(lines)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("time_s,d_z_um\n0,1\n", "no column e_tool_um"),
        ("e_tool_um\n1\n", "no clock"),
    ],
)
def test_what_cannot_be_read(tmp_path, text, message):
    with pytest.raises(LogError, match=message):
        forecasts(tmp_path, text)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"level": 1.0}, "level"), ({"steps": 0}, "steps"), ({"p": 0}, "order"),
     ({"start": KNOWN, "p": 2}, "model of order 1,0")],
)  # fmt: skip
def test_settings_out_of_range(tmp_path, wrong, message):
    with pytest.raises(ValueError, match=message):
        forecasts(tmp_path, HEADER, **wrong)


def test_silence_is_told_once_and_a_signal_ends_it(tmp_path):
    source, feed = os.pipe()
    messages = []
    timer = threading.Timer(0.4, os.kill, (os.getpid(), signal.SIGTERM))
    with open(tmp_path / "out", "wb") as out:
        os.write(feed, csv_of([1, 2]).encode())
        timer.start()
        stream = forecasting(source, out.fileno(), messages.append, **known(timeout=0.05))
        assert stream.run() == signal.SIGTERM
    timer.join()
    os.close(source)
    os.close(feed)
    assert messages == ["<stdin>:3: no line for 0.05 s"]
    assert len((tmp_path / "out").read_text().splitlines()) == 3


@pytest.mark.parametrize("period", [0.5, 2.0])
def test_lines_of_another_period_than_the_model_are_refused(tmp_path, period):
    with pytest.raises(LogError, match=f"each 1 s, the period is {period:g} s"):
        forecasts(tmp_path, csv_of([0.1] * 60), **known(period=period))
