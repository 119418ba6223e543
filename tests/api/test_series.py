"""Orders, fits and forecasts through the Python API: frames, records and files alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.errors import LogError, ThermalToolWarning


@pytest.fixture
def x() -> np.ndarray:
    noise = np.random.default_rng(3).standard_normal(700)
    return np.asarray(lfilter([1.0, 0.4], [1.0, -1.2, 0.5], noise)[100:])


def test_file_frame_and_record_give_one_model(x: np.ndarray, tmp_path: Path) -> None:
    time = 0.5 * np.arange(x.size)
    frame = pd.DataFrame({"time_s": time, "d_z_um": x})
    path = tmp_path / "x.csv"
    frame.to_csv(path, index=False)
    record = tt.Record(time, {"d_z_um": x})
    inputs = (path, frame, frame.set_index("time_s"), record)
    fits = [tt.fit(data, "d_z_um", (2, 1)) for data in inputs]
    for found in fits[1:]:
        np.testing.assert_allclose(found.model.ar, fits[0].model.ar, rtol=1e-6)
        assert found.model.period_s == pytest.approx(0.5)
    assert fits[0].whiteness.p_value > 0.01
    assert fits[0].whiteness.dof == fits[0].whiteness.lags - 3
    assert str(fits[0]).startswith("ARMA(2,1) of d_z_um, 600 samples at 0.5 s, ml")
    assert len(fits[0].plot().axes) == 2  # spectrum and roots


def test_a_model_that_is_too_small_leaves_coloured_innovations(x: np.ndarray) -> None:
    frame = pd.DataFrame({"time_s": np.arange(x.size), "d_z_um": x})
    assert tt.fit(frame, "d_z_um", (1, 0)).whiteness.p_value < 1e-6


def test_missing_rows_and_a_forecast_from_a_file_of_fit(x: np.ndarray, tmp_path: Path) -> None:
    frame = pd.DataFrame({"time_s": np.arange(x.size), "y": x}).drop(index=[50, 51, 300, 302])
    with pytest.warns(ThermalToolWarning, match="3 gaps"):
        found = tt.fit(frame, "y", (2, 1))
    path = tmp_path / "arma.json"
    from thermaltool.documents import write_json

    write_json(found.document(), str(path))
    ahead = tt.forecast(path, frame, steps=4)
    assert ahead.time.tolist() == [600.0, 601.0, 602.0, 603.0]
    np.testing.assert_array_equal(ahead.value, tt.forecast(found, frame, steps=4).value)
    assert np.all((ahead.low < ahead.value) & (ahead.value < ahead.high))
    assert ahead.frame.index.name == "time_s"
    assert len(ahead.plot().axes) == 1
    with pytest.raises(LogError, match="the model has a period of 1 s, the log 2 s"):
        tt.forecast(found, frame.assign(time_s=2 * frame["time_s"]), steps=1)


def test_the_order_of_a_frame(x: np.ndarray) -> None:
    frame = pd.DataFrame({"time_s": np.arange(x.size), "y": x})
    found = tt.order(frame, "y", max_p=4, max_q=3, criteria=["bic"])
    assert found.best() == (2, 1)
    assert found.frame.shape == (20, 6)
    assert len(found.plot().axes) == 1
    with pytest.raises(ValueError, match="no criterion"):
        tt.order(frame, "y", criteria=["cic"])
