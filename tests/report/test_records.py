from __future__ import annotations

import numpy as np
import pytest

from thermaltool.errors import LogError
from thermaltool.report.kernels import draw_inversion, draw_kernel
from thermaltool.report.noise import draw_document, draw_figure, noise_document
from thermaltool.report.pairs import (
    draw_compensation,
    draw_estimate,
    draw_simulation,
)
from thermaltool.report.records import draw_log, draw_setpoints
from thermaltool.report.residuals import draw_comparison
from thermaltool.signals.noise import estimate_noise

from .conftest import make_log


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def data(ax, label):
    return next(line for line in ax.lines if line.get_label() == label).get_ydata()


def test_one_panel_per_unit():
    time = 10.0 * np.arange(1000)
    log = make_log(
        "a/b.csv", time, T_a_degC=time, d_x_um=time, T_b_degC=np.full(1000, np.nan), Q_1=time
    )
    figure = draw_log(log)
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "temperature [°C]",
        "displacement [µm]",
        "relative value [1]",
    ]
    assert texts(figure.axes[0]) == ["T_a_degC", "T_b_degC (no values)"]
    assert figure.axes[-1].get_xlabel() == "time [min]"
    assert figure.axes[1].lines[0].get_xdata()[-1] == pytest.approx(9990 / 60)
    assert len(draw_log(log, ["Q_1"]).axes) == 1
    with pytest.raises(LogError, match=r"no channel Q_2 "):
        draw_log(log, ["Q_2"])


def test_bands_are_shaded_around_their_estimates():
    time = 10.0 * np.arange(100)
    columns = {"Q_1": time / 990, "d_x_um": time, "sigma_Q_1": np.full(100, 0.5),
               "sigma_d_x_um": np.full(100, 20.0)}  # fmt: skip
    relative, moved = draw_log(make_log("e.csv", time, **columns)).axes
    (band,) = relative.collections
    assert texts(relative) == ["Q_1, 95 %", "Q_1"]
    low, high = band.get_paths()[0].get_extents().intervaly
    assert (low, high) == pytest.approx((-0.98, 1.98), abs=1e-2)
    assert len(moved.lines) == 1
    # A stream's, about the deflection that its setpoint cancels; alone, an error is a line.
    stream = make_log("s.csv", time, offset_x_um=-time, **columns)
    first, _ = draw_setpoints(stream).axes
    low, high = first.collections[0].get_paths()[0].get_extents().intervaly
    assert (low, high) == pytest.approx((-990 - 39.2, 39.2), abs=0.1)
    assert texts(draw_log(stream, ["sigma_Q_1"]).axes[0]) == ["sigma_Q_1"]


def test_no_channels():
    with pytest.raises(LogError, match="no channels besides the clock"):
        draw_log(make_log("a.csv", np.arange(3.0)))


def test_model_on_a_log(model, log):
    figure = draw_comparison(model, log)
    pair, error, white, independent, deflection, rest, *_ = figure.axes
    assert white.get_xlabel() == "lag [s]"
    assert "lag behind the input" in independent.get_xlabel()
    assert pair.get_title() == "dT_pair1_K, from rest"
    np.testing.assert_allclose(data(error, "measured − simulated"), 0, atol=1e-9)
    assert data(deflection, "measured")[0] == 0.0  # the offset of 1000 µm is taken off
    assert "band 3 µm\nRMS 0.15 µm" in texts(rest)


def test_model_on_a_log_without_an_output(model, log):
    del log.columns["d_y_um"]
    assert len(draw_comparison(model, log).axes) == 5


def test_simulation(log):
    residual = np.zeros(len(log))
    residual[3] = -2.0
    table = make_log("s.csv", log.time, d_y_um=log.columns["d_y_um"], residual_d_y_um=residual)
    figure = draw_simulation(table)
    assert len(figure.axes) == 2
    np.testing.assert_allclose(data(figure.axes[1], "measured − simulated"), residual, atol=1e-9)
    np.testing.assert_allclose(
        data(figure.axes[0], "measured"), log.columns["d_y_um"] + residual, atol=1e-9
    )


def test_estimate_against_its_log(log):
    d, q = log.columns["d_y_um"] - 1000.0, log.columns["Q_main_W"]
    table = make_log("e.csv", log.time[::2], Q_main_W=q[::2] + 0.25, d_y_um=d[::2])
    heat, heat_error, _, rest = draw_estimate(table, log).axes
    # Heat has a true zero; a displacement counts from its first value.
    np.testing.assert_allclose(data(heat_error, "measured − estimated"), -0.25)
    np.testing.assert_allclose(data(rest, "measured − estimated"), 0.0, atol=1e-9)
    assert texts(heat) == ["measured", "estimated"]
    with pytest.raises(LogError, match=r"e\.csv: no channel dT_x_K"):
        draw_estimate(table, log, ["dT_x_K"])


def test_estimate_against_another_log(log):
    with pytest.raises(LogError, match=r"no channel in common with measured\.csv"):
        draw_estimate(make_log("e.csv", log.time, d_x_um=log.time), log)
    later = make_log("e.csv", log.time + 1e6, d_y_um=log.time)
    with pytest.raises(LogError, match=r"measured\.csv: d_y_um: no time in common"):
        draw_estimate(later, log)


def test_setpoints_over_what_they_cancel(log):
    d = log.columns["d_y_um"]
    table = make_log("c.csv", log.time, offset_y_um=-d, Q_main_W=log.time, d_y_um=d)
    setpoint, heat = draw_setpoints(table).axes
    assert texts(setpoint) == ["−d_y_um, estimated", "offset_y_um"]
    np.testing.assert_array_equal(*[line.get_ydata() for line in setpoint.lines])
    assert texts(heat) == ["Q_main_W"]


def test_what_is_left_leaves_out_the_safe_setpoint_at_the_end(log):
    d = log.columns["d_y_um"] - 1000.0
    time = np.append(log.time, log.time[-1])
    table = make_log("c.csv", time, offset_y_um=np.append(0.5 - d, 0.0))
    error = draw_compensation(table, log).axes[1]
    left = data(error, "what is left:\nmeasured + setpoint")
    assert len(left) == len(log)
    np.testing.assert_allclose(left, 0.5, atol=1e-9)
    # Nor does one at a time of its own, while the machine's log goes on.
    early = make_log("c.csv", log.time[:40], offset_y_um=np.append(0.5 - d[:39], 0.0))
    left = data(draw_compensation(early, log).axes[1], "what is left:\nmeasured + setpoint")
    np.testing.assert_allclose(left[np.isfinite(left)], 0.5, atol=1e-9)
    with pytest.raises(LogError, match=r"a\.csv: none of the deflections .*: d_y_um"):
        draw_compensation(table, make_log("a.csv", log.time, Q_1=log.time))


KERNEL = {"time_s": [0.0, 1.0, 2.0], "weight": [-1.0, -2.0, 0.5], "A0": 3.0, "A1_s": 7.0}


def test_kernel_sums_to_the_steady_state(model):
    figure = draw_kernel({**KERNEL, "steady_state_kept": 0.8}, "k.json")
    np.testing.assert_allclose(figure.axes[1].lines[0].get_ydata(), [2.0, 0.0, 0.5])
    assert "1/H(0) = 0.625" in texts(figure.axes[1])
    assert "whole window: 0.5, 80.00 % of 1/H(0)" in texts(figure.axes[1])
    figure = draw_kernel(KERNEL, "k.csv", model)
    gain = next(t for t in model.terms if t.output == "dT_pair1_K").response.dc_gain()
    assert f"1/H(0) = {1 / gain:.4g}" in texts(figure.axes[1])
    assert figure.axes[0].get_ylabel() == "weight [W/K]"
    assert len(texts(draw_kernel(KERNEL, "k.csv").axes[1])) == 2


def test_inversion_in_any_order_of_times_with_holes():
    result = {
        "time_s": [100.0, 1.0, 10.0, 1000.0],
        "value_1": [2.0, 0.0, 1.0, None],
        "error_1": [1e-9, 0.0, 1e-12, None],
    }
    figure = draw_inversion(result, "l.json")
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), [0.0, 1.0, 2.0])
    assert figure.axes[0].get_xscale() == figure.axes[1].get_yscale() == "log"
    assert figure.axes[1].get_title() == "Estimated error, at most 1.0e-09"


def test_noise_document_shows_what_the_estimate_shows():
    rng = np.random.default_rng(3)
    time = 0.5 * np.arange(4000)
    result = estimate_noise(time, 0.02 * rng.standard_normal(4000))
    units = {"dT_a_K": "K", "T_b_degC": "degC"}
    results = {"dT_a_K": result, "T_b_degC": "every reading is missing"}
    document = noise_document("a.csv", 0.5, units, results)
    _, allan, spectrum = draw_figure("a.csv", units, {"dT_a_K": result}).axes
    again, again_spectrum = draw_document(document, "n.json").axes
    for one, other in zip(allan.lines, again.lines, strict=True):
        np.testing.assert_allclose(other.get_ydata(), one.get_ydata(), rtol=1e-12)
    # The document holds the spectrum in bands, the model is evaluated anew.
    np.testing.assert_allclose(
        again_spectrum.lines[1].get_ydata()[-1], spectrum.lines[1].get_ydata()[-1], rtol=1e-3
    )
    with pytest.raises(LogError, match="no noise to draw"):
        draw_document(document, "n.json", ["T_b_degC"])
    with pytest.raises(LogError, match=r"n\.json: no channel dT_b_K"):
        draw_document(document, "n.json", ["dT_b_K"])
