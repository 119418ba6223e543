"""A response through a lag, and the designs of known columns."""

from __future__ import annotations

import numpy as np
import pytest
from reference import fraser1997 as fraser

from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import DOUBLE_POLE_TOLERANCE as NEAR
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.estimator import load_estimator
from thermaltool.estimation.known_inputs import Feedforward, KnownInput, KnownInputEstimator
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection, JointDeflection
from thermaltool.responses.modes import Modes

TAU = 90.0
RESPONSES = {
    "simple": Modes(np.array([-0.03, -0.4], complex), np.array([0.15, 0.8], complex)),
    "complex": Modes(np.array([-0.02 + 0.1j, -0.3]), np.array([0.2 - 0.7j, -0.1])),
    "double": Deflection(**fraser.LINEAR_X).modes(1.0),
    "two double": JointDeflection(0.787, 9.71e-3, 1.2, 4.41e-3, -0.0145, 8.49e-3, 0.01, 0.0191)
    .modes(1.0),
    "conduction": Conduction(**fraser.PAIR).modes(1.0),
}  # fmt: skip


@pytest.mark.parametrize("name", RESPONSES)
def test_transfer_is_the_product(name):
    modes, s = RESPONSES[name], 1j * np.geomspace(1e-5, 10, 60)
    got = lagged_modes(modes, TAU).transfer(s)
    expected = modes.transfer(s) / (1 + s * TAU)
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", ["simple", "double", "conduction"])
@pytest.mark.parametrize(
    "off",
    [
        0.0,
        1e-12,
        1e-6,
        0.9 * NEAR,
        1.1 * NEAR,
        -0.5 * NEAR,
    ],
)
def test_a_lag_beside_a_pole(name, off):
    modes = RESPONSES[name]
    for pole in modes.poles.real:
        time_constant = -(1 + off) / pole
        lagged, t = lagged_modes(modes, time_constant), np.geomspace(0.01, 1e5, 400)
        # By the exact recursion of the lag alone, fed with small steps of the response.
        late = Modes(np.array([-1 / time_constant], complex), np.array([1 / time_constant + 0j]))
        s = 1j * np.geomspace(1e-5, 10, 60)
        expected = modes.transfer(s) * late.transfer(s)
        size = np.max(np.abs(expected))
        # A triple pole has no place: its lag is off by a thousandth.
        tolerance = 1e-3 if name == "double" else 1e-6
        assert np.max(np.abs(lagged.transfer(s) - expected)) < tolerance * size
        assert lagged.dc_gain() == pytest.approx(modes.dc_gain(), rel=1e-6)
        assert np.max(np.abs(lagged.step(t))) <= 1.01 * np.max(np.abs(modes.step(t)))


def test_a_chain_of_lags_is_another_form_of_the_same():
    once = lagged_modes(lagged_modes(RESPONSES["simple"], 40.0), 40.0)
    s = 1j * np.geomspace(1e-4, 1, 30)
    expected = RESPONSES["simple"].transfer(s) / (1 + 40 * s) ** 2
    np.testing.assert_allclose(once.transfer(s), expected, atol=1e-9)


# ---------------------------------------------------------------- documents


def estimator():
    known = (KnownInput("Q_a_1", "zero", "drive"), KnownInput("T_b_degC", "first", "source"))
    ways = ((0, 0, RESPONSES["simple"]), (0, 1, 2.5))
    return KnownInputEstimator(Feedforward(("d_x_um",)), known, (), ways)


def test_document_round_trip():
    document = estimator().document()
    again = load_estimator(document)
    assert again.document() == document
    assert again.sensors == ("Q_a_1", "T_b_degC")
    u = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_array_equal(
        again.recursion(0.5).run(u)[0], estimator().recursion(0.5).run(u)[0]
    )


@pytest.mark.parametrize(
    ("part", "damage"),
    [
        ("to_outputs", [{"to": 1, "from": 0, "gain": 1.0}]),
        ("to_outputs", [{"to": 0, "from": -1, "gain": 1.0}]),
        ("to_outputs", [{"to": False, "from": 0, "gain": 1.0}]),
        ("to_outputs", [{"to": 0, "from": 0.0, "gain": 1.0}]),
        ("to_outputs", [{"to": 0, "from": 0, "gain": float("nan")}]),
        ("to_outputs", [{"to": 0, "from": 0}]),
        ("to_sensors", [{"to": 0, "from": 0, "gain": 1.0}]),
        ("columns", [{"channel": "Q_a_1", "hold": "second", "role": "drive"}]),
        ("columns", [{"channel": "Q_a_1", "hold": "zero", "role": "guess"}]),
        ("columns", 7),
    ],
)
def test_known_columns_that_are_not_sound_are_told(part, damage):
    document = estimator().document()
    with pytest.raises(ModelError, match="reads no column"):
        load_estimator({key: value for key, value in document.items() if key != "known"})
    with pytest.raises(ModelError, match="run thermaltool regularize again"):
        load_estimator({**document, "known": {**document["known"], part: damage}})
