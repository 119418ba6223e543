"""The alarm of a log that begins warm where rest was expected: its start is no contradiction."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings

PERIOD, NOISE = 20.0, 0.02
LAGS, RISES = np.array([300.0, 900.0, 2500.0]), np.array([5.0, 4.0, 3.0])
SENSORS = ["T_a_degC", "T_b_degC", "T_c_degC"]


def log(heat, generator, loss=0.0):
    """Three lags in air of 20 degC; `loss` adds to each rate [1/s]."""
    rates = 1 / LAGS + loss
    stays, last = np.exp(-rates * PERIOD), RISES / LAGS / rates
    rise = np.zeros((len(heat), len(LAGS)))
    for k, q in enumerate(heat[:-1]):
        rise[k + 1] = stays * rise[k] + (1 - stays) * last * q
    read = 20.0 + rise + NOISE * generator.normal(size=rise.shape)
    table = pd.DataFrame({"time_s": PERIOD * np.arange(len(heat)), "Q_main_1": heat})
    table["d_z_um"] = 6.0 * rise[:, 1] + 0.1 * generator.normal(size=len(rise))
    return table.assign(**dict(zip(SENSORS, read.T, strict=True)))


@pytest.fixture(scope="module")
def design():
    generator = np.random.default_rng(11)
    heat = np.repeat([0.0, 1.0, 0.0, 0.6, 0.2], [20, 180, 120, 100, 80])
    fit = tt.calibrate(log(heat, generator), ["Q_main_1"], sensors=SENSORS, initial="rest",
                       deflections=["d_z_um"], linear=True, starts=1, warn=str,
                       kinds=dict.fromkeys([*SENSORS, "d_z_um"], "rational1"))  # fmt: skip
    still = log(0 * heat, generator).drop(columns="d_z_um")
    return tt.regularize(fit, tt.noise(still, warn=str), form="kalman", warn=str)


def alarm(design, how, loss=0.0):
    """Of a log whose machine has stood warm before its first row."""
    heat = np.repeat([0.8, 0.8, 0.1, 0.9], [150, 40, 100, 60])
    whole = log(heat, np.random.default_rng(12), loss).drop(columns="Q_main_1")
    found = tt.estimate(design, whole.iloc[150:], warn=str, **how).found
    assert found.not_at_rest
    return found.alarm.word


@pytest.mark.parametrize("how", [{"smooth": True}, {"bands": True}, {"lag": 60.0, "bands": True}])
def test_a_warm_start_is_no_alarm(design, how):
    assert alarm(design, how) == "quiet"


@pytest.mark.slow
def test_a_warm_machine_that_loses_more_heat_has_one(design):
    assert alarm(design, {"smooth": True}, loss=0.5 / LAGS[-1]) == "parted"


def stream(design, rows, kept=None):
    """Alarms of a stream, line by line, and the state that it leaves."""
    settings = Settings(bands=True, status=True, step=0.0)
    process = offsets(design.model, settings, Messages(str, "rows"))
    if kept is not None:
        process.resume(kept)
    words = []
    for time, *readings in rows[["time_s", *SENSORS]].to_numpy().tolist():
        reply = process.take(Row(time, readings, [""] * len(SENSORS)))
        words.append(reply[1][process.names.index("alarm")])
    return words, process.state()


@pytest.mark.slow
def test_a_stream_that_begins_warm_has_none_either(design):
    heat = np.repeat([0.8, 0.8, 0.1, 0.9], [150, 40, 100, 60])
    rows = log(heat, np.random.default_rng(12)).iloc[150:]
    words, _ = stream(design, rows)
    assert "parted" not in words
    assert words.count("quiet") > 0.9 * len(words)
    worse = log(heat, np.random.default_rng(12), 0.5 / LAGS[-1]).iloc[150:]
    assert "parted" in stream(design, worse)[0]
    # A restart while the start is hardly known goes on as if there were none.
    first, kept = stream(design, rows.iloc[:3])
    again, end = stream(design, rows.iloc[3:], json.loads(json.dumps(kept)))
    assert first + again == words
    assert end["monitor"] == stream(design, rows)[1]["monitor"]


@pytest.mark.slow
def test_a_stream_that_was_blind_while_the_heat_changed_has_none(design):
    for seed in range(3):
        generator = np.random.default_rng(seed)
        heat = np.repeat(generator.uniform(0, 1, 6), [150, 60, 90, 120, 80, 100])
        rows = log(np.append(np.zeros(20), heat), generator)
        words, _ = stream(design, pd.concat([rows.iloc[:200], rows.iloc[330:]]))
        assert "parted" not in words


@pytest.mark.slow
@pytest.mark.parametrize("dead", [slice(0, 120), slice(150, 330)])
def test_a_sensor_that_is_dead_for_a_while_is_no_alarm_and_no_noise(design, dead):
    generator = np.random.default_rng(15)
    heat = np.repeat([0.0, 0.7, 0.2, 0.9, 0.4, 0.8], [20, 120, 90, 100, 120, 100])
    rows = log(heat, generator).drop(columns=["Q_main_1", "d_z_um"])
    rows.loc[rows.index[dead], "T_b_degC"] = np.nan
    found = tt.estimate(design, rows, smooth=True, nan_policy="hold", warn=str).found
    assert found.alarm.word == "quiet"
    assert [each.white for each in found.sizes.noise] == pytest.approx([NOISE] * 3, rel=0.3)
    assert "parted" not in stream(design, rows)[0]


@pytest.mark.slow
def test_a_machine_that_is_a_little_warm_has_none(design):
    heat = np.repeat([0.08, 0.08, 0.9], [150, 60, 120])
    rows = log(heat, np.random.default_rng(14)).drop(columns="Q_main_1").iloc[150:]
    found = tt.estimate(design, rows, smooth=True, initial="rest", warn=str).found
    assert not found.not_at_rest
    assert found.alarm.word == "quiet"


@pytest.mark.slow
def test_a_start_that_is_a_little_warm_is_estimated(design):
    # 0.25 K and less where the calibration has seen 5 K, and noise is 0.02 K.
    heat = np.repeat([0.05, 0.05, 0.7, 0.3], [500, 40, 100, 60])
    rows = log(heat, np.random.default_rng(21)).iloc[500:]
    told = []
    found = tt.estimate(design, rows, smooth=True, warn=told.append)
    early = found.columns["Q_main_1"][2:30] - 0.05
    assert np.sqrt(np.mean(early**2)) < 0.01
    assert any("at the start is not rest: the state there is estimated" in each for each in told)
    # Rest is rest.
    cold = log(np.repeat([0.0, 0.7], [40, 60]), np.random.default_rng(22))
    assert tt.estimate(design, cold, smooth=True, warn=str).found.initial == "rest"
