from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.errors import LogError, ModelError
from thermaltool.model import Term
from thermaltool.report.models import (
    draw_model,
    draw_trade_off,
    settling_time,
    step_sigma,
    time_constants,
)
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection

DEFLECTION = Deflection(A=50.0, a=0.005, B=20.0, b=0.002, D=-0.02, d=0.004)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_band_of_gains_is_exact():
    # The step is linear in A and B: variance = Σ C_ij f_i f_j, f = 1 − e^(−at).
    time = np.linspace(0, 2000, 50)
    C = np.array([[0.5, -0.2], [-0.2, 0.3]])
    f = np.stack([-np.expm1(-0.005 * time), -np.expm1(-0.002 * time)])
    expected = np.sqrt(np.einsum("in,ij,jn->n", f, C, f))
    got = step_sigma(Term("Q_W", "d_um", DEFLECTION, C, ("A", "B")), time)
    np.testing.assert_allclose(got, expected, atol=1e-8)


def test_band_of_a_rate_against_the_derivative():
    time = np.linspace(0, 2000, 50)
    got = step_sigma(Term("Q_W", "d_um", DEFLECTION, np.array([[1e-8]]), ("a",)), time)
    np.testing.assert_allclose(got, 1e-4 * 50.0 * time * np.exp(-0.005 * time), atol=1e-7)


def test_band_of_parameters_that_are_known_only_together():
    # K and r trade off: a perfect anticorrelation along which the steady state stays.
    response = Conduction(K=3.5, a=0.3, alpha=0.004, r=0.7)
    up = replace(response, r=0.7 * (1 + 1e-5))
    slope = (up.dc_gain() / response.dc_gain() - 1) / (0.7e-5)
    direction = np.array([1.0, -slope * 3.5])  # (dr, dK)
    term = Term("Q_W", "dT_K", response, 0.01 * np.outer(direction, direction), ("r", "K"))
    time = np.array([100.0, 1e6])
    sigma = step_sigma(term, time)
    assert sigma[1] < 1e-3 * sigma[0]


@pytest.mark.parametrize("response", [DEFLECTION, Conduction(K=3.5, a=0.3, alpha=0.004, r=0.7)])
def test_settled_means_within_two_percent(response):
    t = settling_time(response)
    step = response.step(np.geomspace(t, 100 * t, 300))
    assert np.max(np.abs(step - response.dc_gain())) < 0.02 * abs(response.dc_gain())
    assert abs(response.step(np.array([t / 2]))[0] / response.dc_gain() - 1) > 0.02


def test_time_constants():
    assert time_constants(DEFLECTION) == pytest.approx([500, 250, 200])
    assert time_constants(Conduction(K=1, a=0.5, alpha=0.01, r=1)) == pytest.approx([200])


def test_model_figure(model):
    figure = draw_model(model, "m.json")
    top, bottom = figure.axes
    assert top.get_ylabel() == "temperature difference [K/W]"
    assert bottom.get_ylabel() == "displacement [µm/W]"
    assert bottom.get_title() == "Q_main_W → d_y_um  (deflection)"
    assert not any("95 %" in text for text in texts(top))  # no covariance
    assert any(text.startswith("95 % of the fit, ± ") for text in texts(bottom))
    assert "time constants\n500 s, 250 s, 200 s" in texts(bottom)
    assert "steady 70 µm/W" in texts(bottom)
    assert len(draw_model(model, "m.json", ["d_y_um"]).axes) == 1
    with pytest.raises(LogError, match=r"m\.json: no channel d_z_um \(near: d_y_um\)"):
        draw_model(model, "m.json", ["d_z_um"])


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
