from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.report.trade_off import draw_trade_off


def choice(lag, band, delay):
    prediction = {"lag": lag, "band": [band], "lag_error": [lag / 10], "noise_sigma": [0.1]}
    return {"predicted": prediction, "settings": {"delay_s": delay, "walk_per_sqrt_s": 1.0}}


def trade_off():
    kalman = [choice(100.0, 9.0, 0), choice(10.0, 4.0, 0), choice(5.0, 8.0, 0)]
    kernel = [choice(3.0, 5.0, 0.0), choice(3.0, 4.5, 2.0)]
    return {
        "chosen": "kalman",
        "forms": {
            "kalman": {**kalman[1], "trade_off": kalman},
            "kernel": {**kernel[1], "trade_off": kernel},
        },
    }


def test_trade_off_shows_band_against_lag_and_delay(model):
    figure = draw_trade_off(trade_off(), "t.json", model)
    kalman, kernel = figure.axes
    assert kalman.get_ylabel() == "d_y_um [µm]"
    np.testing.assert_array_equal(kalman.lines[0].get_xydata(), [[5, 8], [10, 4], [100, 9]])
    np.testing.assert_array_equal(kernel.lines[0].get_xydata(), [[0, 5], [2, 4.5]])
    np.testing.assert_allclose(kalman.lines[2].get_ydata(), 0.6)  # ±3 σ
    np.testing.assert_array_equal(kalman.lines[3].get_xydata(), [[10, 4]])
    assert draw_trade_off(trade_off(), "t.json").axes[0].get_ylabel().startswith("deflection 1")


def test_trade_off_of_another_model(model):
    report = trade_off()
    report["forms"]["kalman"]["predicted"]["band"].append(1.0)
    with pytest.raises(ModelError, match="about 2 deflections, the model has 1"):
        draw_trade_off(report, "t.json", model)
