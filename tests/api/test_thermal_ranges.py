"""iso230: figures of the standard, and how often their intervals hold the truth."""

import numpy as np
import pandas as pd
import pytest
from machines.nest import PROBES, displacements, readings

import thermaltool as tt
from thermaltool.api.thermal_ranges import parse_probe
from thermaltool.errors import LogError, UnitError

DT = 15.0
TIME = np.arange(0.0, 9 * 3600.0, DT)
SPEED = np.where(TIME < 1800, 0.0, np.where(TIME < 1800 + 4 * 3600, 2500.0, 5000.0))


def frame_of(time, values, **others):
    return pd.DataFrame({"time_s": time, **dict(zip(PROBES, values, strict=True)), **others})


def truth(true, quantity):
    """A displacement or tilt of the plant without noise."""
    x1, x2, y1, y2, z = true
    tilts = {"B": 10 * (x2 - x1), "A": -10 * (y2 - y1)}
    return {"X1": x1, "X2": x2, "Y1": y1, "Y2": y2, "Z": z, **tilts}[quantity]


@pytest.mark.filterwarnings("ignore::thermaltool.errors.ThermalToolWarning")
@pytest.mark.parametrize(
    "drift", [pytest.param(0.0, marks=pytest.mark.study), pytest.param(0.1, marks=pytest.mark.slow)]
)
def test_intervals_hold_the_truth_as_often_as_they_say(drift):
    inside = {}
    for log in range(20):
        rng = np.random.default_rng([log, int(10 * drift)])
        true = displacements(TIME, SPEED, rng)
        idle_time = np.arange(0.0, 16 * 3600.0, DT)
        idle = readings(np.zeros((5, len(idle_time))), DT, rng, drift)
        noise = tt.noise(frame_of(idle_time, idle), start=0.0)
        frame = frame_of(TIME, readings(true, DT, rng, drift), n_spindle_rpm=SPEED)
        result = tt.iso230(frame, probes=PROBES, noise=noise)
        for run in result.runs:
            for each in run.figures:
                end = run.start + (each.time or run.duration)
                part = (run.start <= TIME) & (end >= TIME)
                value = np.ptp(truth(true, each.quantity)[part])
                held = each.estimate.low <= value <= each.estimate.high
                inside.setdefault(each.time, []).append(held)
        room = displacements(TIME, 0 * SPEED, rng)
        frame = frame_of(TIME, readings(room, DT, rng, drift))
        for each in tt.iso230(frame, probes=PROBES, noise=noise).runs[0].figures:
            clean = truth(room, each.quantity)
            rows = len(TIME) if each.time is None else round(each.time / DT) + 1
            windows = np.lib.stride_tricks.sliding_window_view(clean, rows)
            value = np.ptp(windows, axis=1).max()
            held = each.estimate.low <= value <= each.estimate.high
            inside.setdefault(f"ETVE{each.symbol.partition(')')[2]}", []).append(held)
    shares = {key: (len(found), np.mean(found)) for key, found in inside.items()}
    every = np.concatenate([*inside.values()])
    assert 0.93 <= every.mean() <= 0.97, (every.mean(), shares)


@pytest.mark.slow
def test_figures_of_a_machine_without_noise():
    true = displacements(TIME, SPEED, np.random.default_rng(1))
    frame = frame_of(TIME, true, n_spindle_rpm=SPEED, T_air_degC=20.0)
    result = tt.iso230(frame, probes=PROBES)
    assert [run.speed for run in result.runs] == [0.0, 2500.0, 5000.0]
    assert [run.start for run in result.runs] == [0.0, 1800.0, 1800.0 + 4 * 3600.0]
    symbols = [each.symbol for each in result.runs[1].figures]
    assert symbols[:3] == ["d(X1)15", "d(X1)60", "d(X1)t"]
    assert symbols[-3:] == ["d(B)15", "d(B)60", "d(B)t"]
    for run in result.runs:
        for each in run.figures:
            end = run.start + (each.time or run.duration)
            part = (run.start <= TIME) & (end >= TIME)
            expected = np.ptp(truth(true, each.quantity)[part])
            assert each.estimate.value == pytest.approx(expected, rel=0.02, abs=0.02)
    assert "no drift of d_x1_um" in result.notes[0]
    assert len(result.frame) == sum(len(run.figures) for run in result.runs)
    text = result.table()
    assert "n_spindle_rpm 2500 rpm, 4 h from 1800 s" in text
    assert "15 min" in text
    assert len(result.plot().axes) == 4


@pytest.mark.slow
def test_an_environmental_test_and_an_axis():
    time = np.arange(0.0, 30 * 3600.0, 60.0)
    wave = 3 * np.sin(2 * np.pi * time / 86400)
    frame = pd.DataFrame({"time_s": time, "d_x_mm": wave / 1000, "n_spindle_rpm": 0.0})
    result = tt.iso230(frame, test="etve")
    assert result.ranges.speed_channel is None
    found = {each.symbol: each.estimate.value for each in result.runs[0].figures}
    assert found["ETVE(X)"] == pytest.approx(6.0, rel=0.01)
    assert found["ETVE(X) in 24 h"] == pytest.approx(6.0, rel=0.01)
    assert found["ETVE(X) in 1 h"] == pytest.approx(6 * np.sin(np.pi / 24), rel=0.02)
    frame = pd.DataFrame({"time_s": time, "d_a_um": wave, "d_b_um": 3 * wave})
    probes = {"d_a_um": "X:100mm", "d_b_um": "X:0.6m"}
    axis = tt.iso230(frame, probes=probes, test="axis").runs[0].figures[-1]
    assert (axis.symbol, axis.estimate.unit) == ("d(X2-X1)t", "um/m")
    assert axis.estimate.value == pytest.approx(6 * 2 / 0.5, rel=0.01)


def test_what_cannot_be_evaluated():
    time = np.arange(0.0, 600.0, 10.0)
    frame = pd.DataFrame({"time_s": time, "d_p_um": time, "T_a_degC": time, "d_x_um": np.nan})
    with pytest.raises(LogError, match="fewer than 10 readings"):
        tt.iso230(frame)
    with pytest.raises(LogError, match="no column d_q_um"):
        tt.iso230(frame, probes={"d_q_um": "X"})
    with pytest.raises(UnitError, match="T_a_degC: a probe measures a displacement"):
        tt.iso230(frame, probes={"T_a_degC": "X"})
    with pytest.raises(LogError, match="say where the probes are"):
        tt.iso230(frame[["time_s", "d_p_um"]])
    with pytest.raises(LogError, match="no run of 10 readings"):
        tt.iso230(frame, probes={"d_p_um": "X"}, speed="d_p_um")
    with pytest.raises(ValueError, match="no test 'x'"):
        tt.iso230(frame, probes={"d_p_um": "X"}, test="x")
    with pytest.raises(ValueError, match="more than 0 s"):
        tt.iso230(frame, average=0.0)
    with pytest.raises(ValueError, match="at most 180 s"):
        tt.iso230(frame, average=3600.0)
    with pytest.raises(ValueError, match="at the same place"):
        tt.iso230(frame, probes={"d_p_um": "X:1mm", "d_x_um": "X:1mm"})
    for place in ("W", "X:", "X:5degC", "X:inf", "X:five"):
        with pytest.raises(ValueError, match=r"d_p_um=|not a|no "):
            parse_probe("d_p_um", place)


@pytest.mark.slow
def test_labels_follow_the_order_that_was_given():
    frame = pd.DataFrame(
        {"time_s": TIME, "d_a_um": 10.0 * (TIME > 60), "d_b_um": 30.0 * (TIME > 60)}
    )
    for places in ({"d_a_um": "X:150mm", "d_b_um": "X:50mm"}, {"d_a_um": "X:50mm", "d_b_um": "X"}):
        run = tt.iso230(frame, probes=places, test="axis").runs[0]
        whole = {each.quantity: each.estimate.value for each in run.figures if each.time is None}
        assert (whole["X1"], whole["X2"]) == pytest.approx((10.0, 30.0), abs=0.1)
        assert ("X1-X2" in whole) == (places["d_b_um"] == "X:50mm")
    both = {"d_a_um": "X:150mm", "d_b_um": "X:50mm"}
    (tilted,) = tt.iso230(frame, probes=both, test="spindle").runs
    tilts = [each.estimate.value for each in tilted.figures if each.quantity == "B"]
    assert tilts[-1] == pytest.approx(200.0, rel=0.02)


def test_what_is_not_there_is_noted():
    time = TIME[:300]
    frame = pd.DataFrame({"time_s": time, "d_x1_um": 0.01 * time, "d_z_um": 0.01 * time})
    speed, _, tilt = tt.iso230(frame, test="spindle").notes
    assert speed.startswith("no column of a speed: the whole log is one run")
    assert tilt.startswith("no tilt B from X: one probe alone; two at known distances give one")
    two = frame.assign(n_a_rpm=100.0, n_b_rpm=50.0, d_x2_um=time)
    speed, _, tilt = tt.iso230(two).notes
    assert speed.startswith("speeds n_a_rpm, n_b_rpm, and none is chosen: the whole log is eval")
    assert tilt.startswith("no tilt B from X: distances are not given")
    assert len(tt.iso230(frame, test="etve", probes={"d_z_um": "Z"}).notes) == 1
