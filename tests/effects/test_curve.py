"""Curves of `correct`: interpolation, inverse, model file, in front and behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effects.machine import HEAT, X, columns, model
from scipy.interpolate import PchipInterpolator

from thermaltool.effects import load_effect
from thermaltool.effects.curve import DriveCurve, OutputCurve, Spline
from thermaltool.errors import ModelError
from thermaltool.model import dumps, loads
from thermaltool.record import Record

QUADRATIC = {"level": 70.0, "c1": 0.3, "c2": 0.7}
KNOTS = {"x0": -1.0, "y0": -0.5, "x1": 0.0, "y1": 0.0, "x2": 0.5, "y2": 0.1, "x3": 1.0, "y3": 0.9}


@pytest.mark.parametrize("seed", range(5))
def test_the_spline_is_that_of_fritsch_and_butland(seed):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-3, 8, 7))
    y = np.cumsum(rng.exponential(size=7)) if seed else rng.standard_normal(7)
    y[4] = y[3]
    u = np.linspace(x[0], x[-1], 1001)
    np.testing.assert_allclose(Spline(x, y).at(u), PchipInterpolator(x, y)(u), atol=1e-12)


def test_beyond_its_knots_it_goes_straight_on():
    spline = Spline(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 3.0]))
    np.testing.assert_allclose(spline.at(np.array([-2.0, 5.0])), [-4.0, 4.0])
    line = Spline(np.array([0.0, 2.0]), np.array([0.0, 1.0]))
    np.testing.assert_allclose(line.at(np.array([-1.0, 0.5, 4.0])), [-0.5, 0.25, 2.0])


def test_a_polynomial_counts_in_shares_of_its_level():
    curve = DriveCurve("Q_a_W", QUADRATIC)
    np.testing.assert_allclose(curve.bent(np.array([0.0, 35.0, 70.0])), [0.0, 22.75, 70.0])


@pytest.mark.parametrize(
    ("parameters", "low"), [(QUADRATIC, -14.9), (KNOTS, -3.0), ({"level": 2.0, "c1": 1.0}, -7.0)]
)
def test_what_is_bent_can_be_taken_back(parameters, low):
    curve = DriveCurve("Q_a_W", parameters)
    u = np.linspace(low, 3.0, 300)
    np.testing.assert_allclose(curve.undone(curve.bent(u)), u, atol=1e-9)


def test_what_no_drive_gives_is_none():
    curve = DriveCurve("Q_a_W", QUADRATIC)  # turns at -15, at -2.25
    assert np.isnan(curve.undone(np.array(-2.3)))


def test_in_front_of_the_responses():
    time, given = columns(bipolar=False, frozen=False)
    curve = DriveCurve(HEAT, {"level": 1.0, "c1": 0.25, "c2": 0.75})
    bent = {**given, HEAT: 0.25 * given[HEAT] + 0.75 * given[HEAT] ** 2}
    got, expected = model(curve).simulate(Record(time, given)), model().simulate(Record(time, bent))
    for name, values in expected.items():
        np.testing.assert_allclose(got[name], values, atol=1e-12)


def test_behind_the_responses():
    time, given = columns(bipolar=False, frozen=False)
    got = model(OutputCurve(X, {"level": 60.0, "c1": 0.25, "c2": 0.75})).simulate(
        Record(time, given)
    )
    plain = model().simulate(Record(time, given))
    for name, y in plain.items():
        bent = 60 * (0.25 * y / 60 + 0.75 * (y / 60) ** 2) if name == X else y
        np.testing.assert_allclose(got[name], bent, atol=1e-12)


@pytest.mark.parametrize("cls", [DriveCurve, OutputCurve])
@pytest.mark.parametrize("parameters", [QUADRATIC, KNOTS])
def test_it_travels_in_the_model_file(cls, parameters):
    kept = model(cls(HEAT if cls is DriveCurve else X, parameters))
    text = dumps(kept)
    back = loads(text)
    assert back.effects == kept.effects
    assert dumps(back) == text
    assert back.parameters_digest() != model().parameters_digest()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"level": 0.0}, "level above 0"),
        ({"c2": None, "c3": 1.0}, "without its c2"),
        ({"wrong": 1.0}, "no parameter wrong"),
        ({"level": None, "c1": None, "c2": None, "x0": 1.0, "y0": 0.0}, "two or more knots"),
    ],
)
def test_unsound_curves_are_named(change, message):
    document = DriveCurve(HEAT, QUADRATIC).document()
    values = {k: v for k, v in (QUADRATIC | change).items() if v is not None}
    with pytest.raises(ModelError, match=message):
        load_effect({**document, "parameters": values, "covariance_names": list(values)})


def test_knots_that_fall_back_are_refused():
    with pytest.raises(ModelError, match="rising order"):
        DriveCurve(HEAT, {**KNOTS, "x2": -0.5})
    with pytest.raises(ModelError, match="drive_curve"):
        load_effect({**replace(DriveCurve(HEAT, QUADRATIC)).document(), "name": "bend"})
