"""What a calibration leaves open of a displacement, against variances that are written out."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.estimation.calibration_error import ActingDrive, output_changes
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational1

TIME = 30.0 * np.arange(200)
DRIVES = (Drive("Q_a_W", "zero", 0.0, (0.0, 1.0)), Drive("T_room_degC", "first", 20.0, (-5.0, 5.0)))


def of_posterior(covariance, spread=(), role="deflection"):
    """Lags of 500 s of a heat, of 2000 s of a room, and one parameter that is known."""
    kept = {
        "parameters": [["Q_a_W", "K1"]],
        "lags": [["Q_a_W", 500.0], ["T_room_degC", 2000.0]],
        "covariance": np.pad(np.array(covariance), ((1, 0), (1, 0))).tolist(),
        "spread": [list(each) for each in spread],
        "white_sigma": 1e-6,
    }
    output = Output("d_z_um", role, "first", (0.0, 10.0), fit={"discrepancy": kept})
    terms = (
        Term(
            "Q_a_W", "d_z_um", Rational1(K1=3.0, tau1=600.0), np.diag([0.04, 0.0]), ("K1", "tau1")
        ),
        Term("T_room_degC", "d_z_um", Rational1(K1=5.0, tau1=900.0)),
    )
    return Model(DRIVES, (output,), terms, 30.0), output


HEAT, ROOM = ActingDrive(np.full(200, 2.0)), ActingDrive(np.full(200, -3.0), "first", -3.0)
WARMING = 2.0 * -np.expm1(-TIME / 500)


def test_lags_of_all_drives_vary_together():
    model, output = of_posterior([[0.09, 0.02], [0.02, 0.04]])
    changes = output_changes(model, output, TIME, {"Q_a_W": HEAT, "T_room_degC": ROOM})
    # The machine has soaked in the room; the heat begins.
    expected = 0.09 * WARMING**2 + 2 * 0.02 * WARMING * -3.0 + 0.04 * 9.0
    assert np.sum(changes**2, axis=0) == pytest.approx(expected, rel=1e-6)
    alone = output_changes(model, output, TIME, {"Q_a_W": HEAT})
    assert np.sum(alone**2, axis=0) == pytest.approx(0.09 * WARMING**2, rel=1e-6)


def test_other_kinds_that_came_as_near_widen_it():
    model, output = of_posterior(np.zeros((2, 2)), [(0.2, 0.0), (0.4, 0.0)])
    changes = output_changes(model, output, TIME, {"Q_a_W": HEAT})
    assert np.sum(changes**2, axis=0) == pytest.approx(0.1 * WARMING**2, rel=1e-6)


def test_a_model_without_a_posterior_has_its_parameters_covariance():
    model, output = of_posterior(np.zeros((2, 2)), role="sensor")
    changes = output_changes(model, output, TIME, {"Q_a_W": HEAT})
    expected = (0.2 * 2.0 * -np.expm1(-TIME / 600)) ** 2
    assert np.sum(changes**2, axis=0) == pytest.approx(expected, rel=1e-6)
