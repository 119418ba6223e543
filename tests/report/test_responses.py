from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.effects.convection_state import ConvectionState
from thermaltool.errors import LogError
from thermaltool.model import (
    Drive,
    Model,
    Output,
    Term,
    at_operating_points,
    characteristics,
    deviations,
)
from thermaltool.report.presentation import with_interval
from thermaltool.report.responses import (
    draw_model,
    draw_step_responses,
    poles_and_zeros,
    settling_time,
)
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import rational_kind
from thermaltool.signals.intervals import Estimate

DEFLECTION = Deflection(A=50.0, a=0.005, B=20.0, b=0.002, D=-0.02, d=0.004)
CONDUCTION = Conduction(K=3.5, a=0.3, alpha=0.004, r=0.7)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def step_sigma(term, time):
    return np.linalg.norm(deviations(term, lambda response: response.step(time)), axis=-1)


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
    up = replace(CONDUCTION, r=0.7 * (1 + 1e-5))
    slope = (up.dc_gain() / CONDUCTION.dc_gain() - 1) / (0.7e-5)
    direction = np.array([1.0, -slope * 3.5])  # (dr, dK)
    term = Term("Q_W", "dT_K", CONDUCTION, 0.01 * np.outer(direction, direction), ("r", "K"))
    sigma = step_sigma(term, np.array([100.0, 1e6]))
    assert sigma[1] < 1e-3 * sigma[0]


def test_band_of_a_magnitude_against_draws_of_the_parameters():
    """The band of a lag: 95 % of draws of its parameters lie in it, at every frequency."""
    lag = rational_kind(1, 0)(K1=2.0, tau1=300.0)
    covariance = np.array([[0.02**2, 0.5 * 0.02 * 6.0], [0.5 * 0.02 * 6.0, 6.0**2]])
    s = 2j * np.pi * np.array([1e-5, 5e-4, 1e-2])
    value = lag.transfer(s)
    term = Term("Q_W", "d_um", lag, covariance, ("K1", "tau1"))
    relative = deviations(term, lambda each: each.transfer(s) / value)
    drawn = np.random.default_rng().multivariate_normal([2.0, 300.0], covariance, 4000)
    found = drawn[:, :1] / (1 + s * drawn[:, 1:]) / value
    for part, spread in (("log", np.log(np.abs(found))), ("angle", np.angle(found))):
        sigma = np.linalg.norm(relative.real if part == "log" else relative.imag, axis=-1)
        np.testing.assert_allclose(spread.std(axis=0), sigma, rtol=0.08, err_msg=part)


def test_a_parameter_at_the_end_of_its_range_has_a_one_sided_derivative():
    lag = rational_kind(1, 0)(K1=2.0, tau1=300.0, delay=0.0)
    term = Term("Q_W", "d_um", lag, np.array([[4.0]]), ("delay",))
    sigma = step_sigma(term, np.array([100.0]))
    assert sigma[0] == pytest.approx(2 * 2 / 300 * np.exp(-1 / 3), rel=1e-3)
    assert characteristics(term).delay.high == pytest.approx(2 * 1.96, rel=1e-3)


@pytest.mark.parametrize("response", [DEFLECTION, CONDUCTION])
def test_settled_means_within_two_percent(response):
    t = settling_time(response)
    step = response.step(np.geomspace(t, 100 * t, 300))
    assert np.max(np.abs(step - response.dc_gain())) < 0.02 * abs(response.dc_gain())
    assert abs(response.step(np.array([t / 2]))[0] / response.dc_gain() - 1) > 0.02


def test_poles_and_zeros_make_the_transfer_function():
    """H(s) = H(0) Π (1 − s/z) / Π (1 − s/p), double poles and oscillations as well."""
    oscillating = rational_kind(1, 1)(K=3.0, D=0.4, omega=0.02, zeta=0.3, K1=-1.0, tau1=200.0)
    direct = rational_kind(2, 0, True)(K1=1.0, tau1=50.0, K2=2.0, tau2=400.0, K0=0.5)
    s = np.array([1e-3j, 0.01 + 0.02j, 1.0j])
    for response in (DEFLECTION, oscillating, direct):
        poles, zeros = poles_and_zeros(response)
        value = np.full(len(s), response.dc_gain(), complex)
        for z in zeros:
            value *= 1 - s / z
        for p in poles:
            value /= 1 - s / p
        np.testing.assert_allclose(value, response.transfer(s), rtol=1e-6)
    assert poles_and_zeros(CONDUCTION) is None


def test_characteristics_of_an_oscillation():
    response = rational_kind(1, 1)(K=3.0, D=0.4, omega=0.02, zeta=0.3, K1=-1.0, tau1=200.0)
    names = ("omega", "zeta", "tau1")
    found = characteristics(Term("Q_W", "d_um", response, np.diag([1e-6, 1e-4, 4.0]), names))
    assert [t.value for t in found.time_constants] == [200.0]
    (mode,) = found.oscillations
    assert mode.period.value == pytest.approx(2 * np.pi / 0.02)
    # dT = T dω/ω
    assert mode.period.high == pytest.approx(mode.period.value * np.exp(1.96 * 0.05), rel=1e-3)
    assert (mode.damping.low, mode.damping.high) == pytest.approx((0.2804, 0.3196), abs=1e-4)


def test_model_figure(model):
    figure = draw_model(model, "m.json")
    step, magnitude, phase, poles, second, *_ = figure.axes
    assert step.get_ylabel() == "dT_pair1_K [K/W]"
    assert magnitude.get_ylabel() == "magnitude [K/W]"
    assert phase.get_ylabel() == "phase [°]"
    assert "no finite number of poles" in poles.texts[0].get_text()
    assert second.get_ylabel() == "d_y_um [µm/W]"
    assert not any("95 %" in text for text in texts(step))  # no covariance
    assert any(text.startswith("95 %, ± ") for text in texts(second))
    # At low frequency the magnitude is the gain.
    assert magnitude.lines[-1].get_ydata()[0] == pytest.approx(CONDUCTION.dc_gain(), rel=1e-2)
    assert len(draw_model(model, "m.json", ["d_y_um"]).axes) == 4
    with pytest.raises(LogError, match=r"m\.json: no channel d_z_um \(near: d_y_um\)"):
        draw_model(model, "m.json", ["d_z_um"])


def test_many_terms_are_drawn_together():
    names = [f"T_{k}_degC" for k in range(1, 9)]
    lag = rational_kind(1, 0)
    model = Model(
        tuple(Drive(name, "first", "first", (-1.0, 4.0 * k)) for k, name in enumerate(names, 1)),
        (Output("d_z_um", "deflection", "first", (0.0, 9.0)),),
        tuple(Term(name, "d_z_um", lag(K1=1.0, tau1=100.0)) for name in names),
        10.0,
    )
    (ax,) = draw_model(model, "many.json").axes
    # The largest first, each as large as it was seen.
    assert texts(ax)[:2] == ["T_8_degC, +32 °C", "T_7_degC, +28 °C"]
    assert ax.lines[0].get_ydata()[-1] == pytest.approx(32.0, rel=0.02)


def test_step_responses_of_two_models(model):
    half = replace(model, terms=(replace(model.terms[1], response=replace(DEFLECTION, A=20.0)),))
    first, second = draw_step_responses({"a.json": model, "b.json": half}).axes
    assert len(texts(first)) == 1
    assert [text.split("\n")[0] for text in texts(second)] == ["a.json", "b.json"]
    assert second.get_ylabel() == "d_y_um [µm/W]"


def test_steps_at_the_levels_of_a_loss_rate():
    """x' = -(1/100 + r) x + u/100 has the step response 1/(1 + 100 r) with 1/(1/100 + r)."""
    table = {"level0": 0.0, "rate0": 0.0, "level1": 8000.0, "rate1": 0.03}
    names = [f"Q_{k}_W" for k in range(1, 8)]
    lag = rational_kind(1, 0)
    model = Model(
        tuple(Drive(name, "zero", 0.0, (0.0, 1.0)) for name in names),
        (Output("d_z_um", "deflection", "first", (0.0, 9.0)),),
        tuple(Term(name, "d_z_um", lag(K1=1.0, tau1=100.0)) for name in names),
        10.0,
        effects=(ConvectionState("n_spindle_rpm", table),),
    )
    one = replace(model, drives=model.drives[:1], terms=model.terms[:1])
    axes = draw_model(one, "m.json").axes[0]
    (both,) = draw_step_responses({"m.json": one}).axes
    (many,) = draw_model(model, "many.json").axes
    for ax in (axes, both, many):
        slow, fast = (line.get_ydata() for line in ax.lines[:2])
        assert slow[-1] == pytest.approx(1.0, rel=0.02)
        time = np.linspace(0.0, settling_time(one.terms[0].response), 600)
        assert fast == pytest.approx(-np.expm1(-0.04 * time) / 4, abs=1e-3)
        assert any("at 8000 rpm of n_spindle_rpm" in text for text in texts(ax))


def test_bands_are_drawn_where_intervals_are_told():
    """At a level at which a rate acts that the term was not fitted with nothing tells the band."""
    term = Term("Q_1_W", "d_z_um", rational_kind(1, 0)(K1=1.0, tau1=100.0),
                np.diag([0.01, 25.0]), ("K1", "tau1"))  # fmt: skip
    heights = {}
    for rate in (0.0, 0.03):
        table = {"level0": 0.0, "rate0": 0.01, "level1": 8000.0, "rate1": rate}
        model = Model(
            (Drive("Q_1_W", "zero", 0.0, (0.0, 1.0)),),
            (Output("d_z_um", "deflection", "first", (0.0, 9.0)),),
            (term,),
            10.0,
            effects=(ConvectionState("n_spindle_rpm", table),),
        )
        (ax,) = draw_step_responses({"m.json": model}).axes
        told = [each.gain.low < each.gain.high for _, _, each in at_operating_points(model)]
        bands = [each.get_paths()[0].vertices for each in ax.collections]
        lines = [line.get_ydata() for line in ax.lines[: len(bands)]]
        heights[rate] = [
            bool(np.max(band[:, 1]) > np.max(line) + 1e-9)
            for band, line in zip(bands, lines, strict=True)
        ]
        assert heights[rate] == told
    assert heights == {0.0: [False, True], 0.03: [False, False]}


def test_a_narrow_interval_has_two_ends():
    narrow = Estimate(240.03, 239.9, 240.1, "s")
    assert with_interval(narrow) == "4 min (3.998 min to 4.002 min)"
    assert with_interval(Estimate(150.0, 100.0, 240.0, "s")) == "2.5 min (100 s to 4 min)"
