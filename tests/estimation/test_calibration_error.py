"""What a calibration leaves open of a displacement, against variances that are written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.estimation.calibration_error import (
    ActingDrive,
    deflection_variance,
    sensor_changes,
)
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational1

TIME = 30.0 * np.arange(200)
DRIVES = (Drive("Q_a_W", "zero", 0.0, (0.0, 1.0)), Drive("T_room_degC", "first", 20.0, (-5.0, 5.0)))


def of_posterior(covariance, spread=()):
    """Lags of 500 s of a heat, of 2000 s of a room, and one parameter that is known."""
    kept = {
        "parameters": [["Q_a_W", "K1"]],
        "lags": [["Q_a_W", 500.0], ["T_room_degC", 2000.0]],
        "covariance": np.pad(np.array(covariance), ((1, 0), (1, 0))).tolist(),
        "spread": [list(each) for each in spread],
        "white_sigma": 1e-6,
    }
    output = Output("d_z_um", "deflection", "first", (0.0, 10.0), fit={"discrepancy": kept})
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
    soaked = replace(ROOM, values=np.append([-3.0], np.full(199, -2.0)), hold="zero")
    found = deflection_variance(model, output, TIME, {"Q_a_W": HEAT, "T_room_degC": soaked})
    # The zero is free: the machine has soaked in the room, which then is warmer by 1 K.
    risen = -np.expm1(-np.maximum(TIME - 30.0, 0.0) / 2000)
    expected = 0.09 * WARMING**2 + 2 * 0.02 * WARMING * risen + 0.04 * risen**2
    assert found == pytest.approx(expected, rel=1e-6)
    alone = deflection_variance(model, output, TIME, {"Q_a_W": HEAT})
    assert alone == pytest.approx(0.09 * WARMING**2, rel=1e-6)


def test_other_kinds_that_came_as_near_widen_it_by_their_median():
    model, output = of_posterior(np.zeros((2, 2)), [(0.2, 0.0), (0.4, 0.0), (90.0, 0.0)])
    found = deflection_variance(model, output, TIME, {"Q_a_W": HEAT})
    assert found == pytest.approx(0.16 * WARMING**2, rel=1e-6)


def test_a_sensor_and_a_model_without_a_posterior_have_the_parameters_covariance():
    model, output = of_posterior(np.zeros((2, 2)))
    expected = (0.2 * 2.0 * -np.expm1(-TIME / 600)) ** 2
    changes = sensor_changes(model, output, TIME, {"Q_a_W": HEAT})
    assert np.sum(changes**2, axis=0) == pytest.approx(expected, rel=1e-6)
    bare = replace(output, fit={})
    found = deflection_variance(model, bare, TIME, {"Q_a_W": HEAT})
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_sensor_of_a_machine_that_has_soaked_is_unsure_of_that():
    model, output = of_posterior(np.zeros((2, 2)))
    terms = (model.terms[0], replace(model.terms[1], covariance=np.diag([0.01, 0.0]),
                                     covariance_names=("K1", "tau1")))  # fmt: skip
    found = sensor_changes(replace(model, terms=terms), output, TIME, {"T_room_degC": ROOM})
    assert np.sum(found**2, axis=0) == pytest.approx((0.1 * 3.0) ** 2, rel=1e-6)
