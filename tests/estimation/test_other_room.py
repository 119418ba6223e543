"""A machine that has soaked in a room of another temperature than the calibration's is at rest."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

PERIOD, SUBSTEPS, ROOM = 60.0, 10, 20.0
# Two parts that share a heat and stand in the same air: time constants [s], rises [K/W], growth.
TIMES, RISES = np.array([600.0, 2400.0]), np.array([0.18, 0.05])
GROWTH = np.array([1.5, 5.0])
SENSORS = ["T_nose_degC", "T_column_degC"]


def log(heat, room, first=None, noise=0.02, seed=1):
    """Explicit Euler over substeps of parts in air; soaked in it at first, or all at `first`."""
    generator = np.random.default_rng(seed)
    part = np.full(2, room[0] if first is None else first)
    rows = []
    for q, air in zip(heat, room, strict=True):
        rows.append(part)
        for _ in range(SUBSTEPS):
            part = part + PERIOD / SUBSTEPS * (air + RISES * q - part) / TIMES
    table = np.array(rows)
    read = table + noise * generator.normal(size=table.shape)
    frame = pd.DataFrame({"time_s": PERIOD * np.arange(len(heat)), "Q_spindle_W": heat})
    frame["T_room_degC"] = room + noise * generator.normal(size=len(room))
    frame[SENSORS] = read
    frame["d_z_um"] = (table - ROOM) @ GROWTH + 0.2 * generator.normal(size=len(table))
    return frame


def duty(seed, rows):
    levels = np.random.default_rng(seed).choice([0.0, 60.0, 120.0, 200.0], rows // 30)
    return np.where(np.arange(rows) < 15, 0.0, np.repeat(levels, 30))


def day(rows):
    at = np.arange(rows) * PERIOD
    return 3 * (1 - np.cos(at / 5000)) + 0.8 * np.sin(at / 1300)


@pytest.fixture(scope="module")
def design():
    fit = tt.calibrate(log(duty(1, 480), ROOM + day(480)), ["Q_spindle_W", "T_room_degC"],
                       sensors=SENSORS, deflections=["d_z_um"], linear=True, starts=1,
                       kinds={**dict.fromkeys(SENSORS, "rational1"), "d_z_um": "rational2"},
                       initial="rest", warn=str)  # fmt: skip
    still = tt.noise(log(np.zeros(400), np.full(400, ROOM), seed=2), warn=str)
    return tt.regularize(fit, still, measured=["T_room_degC"], form="kalman", warn=str)


@pytest.mark.slow
@pytest.mark.parametrize("colder", [0.44, 3.0])
@pytest.mark.parametrize("how", [{}, {"smooth": True}, {"bands": True, "lag": 120.0}])
def test_a_soaked_machine_has_no_heat(design, colder, how):
    usual, found = (
        tt.estimate(
            design, log(np.zeros(120), np.full(120, ROOM - each), seed=3), warn=str, **how
        ).found.estimates
        for each in (0.0, colder)
    )
    # As in the calibration's room, with the same noise; 3 K that were taken for heat are 30 W.
    assert np.abs(found["Q_spindle_W"] - usual["Q_spindle_W"]).max() < 0.5
    moved = found["d_z_um"] - usual["d_z_um"] + colder * GROWTH.sum()
    assert np.abs(moved).max() < 0.3


@pytest.mark.slow
def test_the_stream_begins_as_the_batch_does(design):
    frame = log(duty(5, 240), ROOM - 3 + day(240), seed=4).drop(columns=["Q_spindle_W", "d_z_um"])
    said = []
    stream = tt.Compensator(design, step=0.0, slew=1e9, limits=(-1e9, 1e9), warn=said.append)
    offsets = stream.run(frame)["offset_z_um"].to_numpy()
    found = tt.estimate(design, frame, warn=str).found.estimates["d_z_um"]
    assert -offsets == pytest.approx(found, abs=1e-9)
    assert not any("at the start" in each for each in said)


def test_a_cold_machine_that_has_not_followed_is_told_by_its_sensors(design):
    # The door was opened: the air is colder by 6 K, the machine as it was.
    air = np.full(240, ROOM - 6.0)
    frame = log(np.zeros(240), air, first=ROOM, seed=6)
    found = tt.estimate(design, frame.drop(columns="Q_spindle_W"), warn=str).found
    assert not found.not_at_rest
    assert np.abs(found.estimates["Q_spindle_W"]).max() < 10.0
    left = found.estimates["d_z_um"] - frame["d_z_um"].to_numpy()
    assert np.abs(left).max() < 2.0


@pytest.mark.slow
def test_a_warm_start_frees_the_smoother(design):
    whole = log(np.repeat([200.0, 80.0], [300, 200]), np.full(500, ROOM - 3), seed=7)
    frame = whole.iloc[250:].drop(columns="Q_spindle_W")
    said = []
    found = tt.estimate(design, frame, smooth=True, warn=said.append).found
    assert found.initial == "free"
    assert any("the state there is estimated" in each for each in said)
    off = found.estimates["Q_spindle_W"] - whole["Q_spindle_W"].to_numpy()[250:]
    assert np.sqrt(np.mean(off**2)) < 15.0


@pytest.mark.slow
def test_what_a_measured_drive_does_is_as_unsure_as_its_response(design):
    rows = 240
    room = ROOM + 6.0 * (np.arange(rows) > 20)
    frame = log(np.zeros(rows), room, seed=8).drop(columns=["Q_spindle_W", "d_z_um"])
    found = tt.estimate(design, frame, smooth=True, bands=True, warn=str).found
    (term,) = (t for t in design.model.terms if (t.drive, t.output) == ("T_room_degC", "d_z_um"))
    gains = [k for k, name in enumerate(term.covariance_names) if name.startswith("K")]
    error = np.sqrt(np.sum(term.covariance[np.ix_(gains, gains)]))
    assert found.sigma["d_z_um"][-1] > 0.5 * 6.0 * error
