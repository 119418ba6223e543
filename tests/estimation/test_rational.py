"""Inverse transfer functions as model files: identified on the C-frame, inverted, simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.training import fitted, sampled

from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.curve import DriveCurve
from thermaltool.errors import ModelError
from thermaltool.estimation.rational import inverse_model
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.document import model_document
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.transfer.continuous_term import continuous_term
from thermaltool.model import Drive, Term, dumps, loads
from thermaltool.model.combine import scheduled
from thermaltool.plants import build
from thermaltool.plants.duties import HOUR, air, settings
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational1, Rational2

HEATER, ANGLE, DT = "Q_stabilization_W", "phi_x_urad", 60.0


@pytest.fixture(scope="module")
def c_frame():
    """γ2 of the C-frame, from a step of the stabilization heater as in the source."""
    plant = build("c-frame")
    clock = DT * np.arange(round(12 * HOUR / DT) + 1)
    given = settings("step", (False, True), plant.regulators[1].full, clock - 1800.0, 2)
    read = plant.simulate(given, air(clock, 20.0, 0.0, 2), DT)
    angle = 1e3 * (read["d_x2_um"] - read["d_x1_um"]) / plant.distance
    angle = angle + 0.5 * np.random.default_rng(2).standard_normal(len(clock))
    record = sampled((HEATER,), given[:, 1:].T, (ANGLE,), angle, DT)
    data = TrainingData((record,), (HEATER,), (ANGLE,), DT).from_rest()
    found = fitted(data, "oe", (2,), 2, (1,), real=True)
    fit = Fit(found, (continuous_term(found, 0),), found.fit(data), data)
    return model_document([fit], None, {})


def test_inverse_times_response_is_the_filter_on_the_c_frame(c_frame):
    found = inverse_model(c_frame, 600.0)
    s = 1j * np.geomspace(1e-6, 0.1, 30)
    product = found.model.terms[0].response.transfer(s) * c_frame.terms[0].response.transfer(s)
    wanted = np.prod([1 / (lag * s + 1) for lag in found.inverse.filter_lags], axis=0)
    np.testing.assert_allclose(product, wanted, rtol=1e-8)


def test_the_power_comes_back_behind_the_filter(c_frame):
    """Forward in one simulation, backward in another: the power, late by the filter's lags."""
    time = DT * np.arange(1500)
    power = np.repeat(np.random.default_rng(3).uniform(0, 60, 15), 100)
    power[:100] = 0.0
    inverse = loads(dumps(inverse_model(c_frame, 300.0).model))
    angle = c_frame.simulate(Record(time, {HEATER: power}))[ANGLE]
    found = inverse.simulate(Record(time, {ANGLE: angle}))[HEATER]
    # 300 s and 150 s: what is left of a step of 60 W after 99 rows is nothing.
    settled = np.arange(199, 1500, 100)
    np.testing.assert_allclose(found[settled], power[settled], atol=0.05)
    assert np.max(np.abs(found[1:] - power[1:])) > 5


def test_ways_are_chosen_and_what_cannot_be_inverted_is_named(c_frame):
    term, warm = c_frame.terms[0], Drive("Q_causal_W", "zero", 0.0, (0.0, 60.0))
    both = replace(
        c_frame,
        drives=(*c_frame.drives, warm),
        terms=(term, Term("Q_causal_W", ANGLE, Rational1(3.0, 900.0))),
    )
    with pytest.raises(ModelError, match=r"several ways: Q_stab.* → phi_x_urad, Q_causal_W →"):
        inverse_model(both, 60.0)
    assert inverse_model(both, 60.0, drive="Q_causal_W").model.outputs[0].channel == "Q_causal_W"
    with pytest.raises(ModelError, match="no such way"):
        inverse_model(both, 60.0, output="d_z_um")
    refused = {
        "a schedule": replace(
            c_frame, terms=(replace(term, band=ScheduleBand(HEATER, (0.0, 9.0), 0)),)
        ),
        r"^Q_stab\S* → phi_x_urad: a schedule has no inverse": scheduled(
            [c_frame, replace(c_frame, terms=(replace(term, response=Rational1(3.0, 900.0)),))],
            HEATER,
            [20.0, 60.0],
        ),
        "2 responses in sum": replace(
            c_frame, terms=(term, replace(term, response=Rational1(3.0, 900.0)))
        ),
        "drive_curve": replace(c_frame, effects=(DriveCurve(HEATER, {"level": 1.0, "c1": 1.0}),)),
        "deflection is none of the rational kinds": replace(
            c_frame,
            terms=(Term(HEATER, ANGLE, Deflection(10.5, 5.9e-4, 67.1, 9.1e-4, -0.041, 0.0044)),),
        ),
        f"{HEATER} → {ANGLE}: the inverse is unstable: zeros at 0.006": replace(
            c_frame, terms=(Term(HEATER, ANGLE, Rational2(1.0, 300.0, -0.4, 20.0)),)
        ),
    }
    for message, model in refused.items():
        with pytest.raises(ModelError, match=message):
            inverse_model(model, 60.0)
