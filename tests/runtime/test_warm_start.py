"""A stream on a machine that a temperature drives, warm when the stream begins."""

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt

PERIOD, REST, GAIN = 10.0, 20.0, (1.0, 0.65)
TIMES = np.array([600.0, 2400.0])


def deflections(temperatures, warm=None):
    """Two lags of a motor's temperature [µm], by a hundred small steps a row; settled at `warm`."""
    state = np.zeros(2) if warm is None else np.array(GAIN) * (warm - REST)
    found = []
    for temperature in temperatures:
        found.append(state.sum())
        for _ in range(100):
            state = state + PERIOD / 100 * (np.array(GAIN) * (temperature - REST) - state) / TIMES
    return np.array(found)


@pytest.fixture(scope="module")
def model():
    time = PERIOD * np.arange(1500)
    heated = np.where(time > 300, 1 - np.exp(-(time - 300) / 900), 0.0)
    motor = REST + 20 * heated * np.where(time < 9000, 1.0, np.exp(-(time - 9000) / 900))
    frame = pd.DataFrame({"time_s": time, "T_motor_degC": motor, "d_z_um": deflections(motor)})
    kinds = {"d_z_um": "rational2"}
    return tt.regularize(tt.calibrate(frame, ["T_motor_degC"], deflections=["d_z_um"], kinds=kinds))


@pytest.mark.slow
@pytest.mark.parametrize("initial", ["rest", "settled"])
def test_a_warm_machine_gets_its_offset(model, initial):
    motor = np.where(np.arange(3000) < 1500, 40.0, 20 + 20 * np.exp(-np.arange(3000) / 90))
    frame = pd.DataFrame({"time_s": PERIOD * np.arange(3000), "T_motor_degC": motor})
    said = []
    stream = tt.Compensator(model, step=0.0, slew=1e3, initial=initial, warn=said.append)
    left = stream.run(frame)["offset_z_um"].to_numpy() + deflections(motor, warm=40.0)
    # A machine at rest is in equilibrium with what is measured; no sensor tells whether it is.
    assert np.abs(left).max() < 0.5
    assert any("taken to have stood for long" in each for each in said) == (initial == "rest")


def test_a_batch_counts_as_the_stream_does(model):
    frame = pd.DataFrame({"time_s": PERIOD * np.arange(200), "T_motor_degC": 40.0})
    for initial in ("settled", "rest"):
        said = []
        found = tt.estimate(model, frame, initial=initial, warn=said.append).frame["d_z_um"]
        assert found.iloc[[0, -1]].to_numpy() == pytest.approx(33.0, abs=0.5)
        assert any("taken to have stood for long" in e for e in said) == (initial == "rest")


def test_identify_keeps_where_its_log_began():
    time = PERIOD * np.arange(1200)
    motor = 23 + 10 * np.sin(time / 900) * (time > 100)
    rows = {"time_s": time, "T_motor_degC": motor, "d_z_um": deflections(motor, warm=23.0)}
    frame = pd.DataFrame(rows)
    found = tt.identify(frame, inputs=["T_motor_degC"], outputs=["d_z_um"], orders=[(2, 2, 1)])
    (drive,) = found.model.drives
    assert drive.rest == pytest.approx(23.0, abs=0.01)


@pytest.fixture(scope="module")
def model_in_mm():
    time = PERIOD * np.arange(900)
    motor = REST + 20 * np.where(time > 300, 1 - np.exp(-(time - 300) / 900), 0.0)
    rows = {"time_s": time, "T_motor_degC": motor, "d_z_mm": deflections(motor) / 1e3}
    kinds = {"d_z_mm": "rational2"}
    data = pd.DataFrame(rows)
    return tt.regularize(tt.calibrate(data, ["T_motor_degC"], deflections=["d_z_mm"], kinds=kinds))


def test_a_deflection_in_mm_is_stepped_and_slewed_in_um(model_in_mm):
    frame = pd.DataFrame({"time_s": np.arange(30.0), "T_motor_degC": 40.0})
    stream = tt.Compensator(model_in_mm, initial="settled", max_gap=1.0, period=1.0)
    moves = stream.run(frame)["offset_z_mm"].to_numpy()
    assert moves[-1] == pytest.approx(-0.033, abs=0.0005)
    assert np.abs(moves / 0.0005 - np.round(moves / 0.0005)).max() < 1e-6
    assert np.abs(np.diff(moves)).max() <= 0.010 + 1.25 * 0.0005
    coarse = {"step": "2um", "slew": "1mm/s", "max_gap": 1.0, "period": 1.0}
    other = tt.Compensator(model_in_mm, initial="settled", **coarse)
    assert other.run(frame)["offset_z_mm"].iloc[2] == pytest.approx(-0.034, abs=1e-9)


@pytest.mark.parametrize(
    ("step", "fault"), [(0.5, "has moved by 0.0"), ("0.5mm", "--step 0.5um"), ("2K", "quantity")]
)
def test_a_step_beyond_the_calibration_is_refused(model_in_mm, step, fault):
    with pytest.raises(ValueError, match=fault):
        tt.Compensator(model_in_mm, step=step)
