"""A reduced body against the mesh: steady state, slow drift, and the error over its band."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from thermaltool.errors import ModelError
from thermaltool.placement import sparse_solver
from thermaltool.placement.finite_elements import FiniteElements
from thermaltool.placement.reduction import reduced_model, reduced_terms
from thermaltool.placement.thermal_modes import thermal_modes
from thermaltool.record import Record


def test_a_reduced_rod_follows_the_mesh(rod, load):
    body = load(rod)
    modes = thermal_modes(FiniteElements(body).equations())
    model = reduced_model(modes, body, {})
    # The mesh itself, by the matrix exponential, under a duty of 20 and 15 min.
    e, dt = modes.equations, 60.0
    rates = -np.linalg.solve(e.capacity.toarray(), e.conduction.toarray())
    step = expm(rates * dt)
    held = np.linalg.solve(rates, (step - np.eye(len(rates)))) @ np.linalg.solve(
        e.capacity.toarray(), e.loads[:, 0]
    )
    heat = np.where(np.arange(240) % 35 < 20, 200.0, 0.0)
    states = np.zeros((240, len(rates)))
    for k in range(239):
        states[k + 1] = step @ states[k] + held * heat[k]
    exact = {"T_1_degC": states @ e.readings.toarray()[0],
             "T_5_degC": states @ e.readings.toarray()[4],
             "d_tip_um": 1e6 * states @ e.deflections[0]}  # fmt: skip
    found = model.simulate(Record(dt * np.arange(240.0), {"Q_motor_W": heat}))
    for name, values in exact.items():
        error = np.max(np.abs(found[name] - found[name][0] - values))
        assert error < 0.005 * np.ptp(values), name


def test_the_error_over_the_band_is_that_of_few_modes(block, load, monkeypatch):
    body = load(block)
    modes = thermal_modes(FiniteElements(body).equations(), 20)
    terms = reduced_terms(modes)
    assert {place: term.error < 0.02 for place, term in terms.items()} == dict.fromkeys(terms, True)
    for (k, h), term in terms.items():
        assert term.gains.sum() == pytest.approx(modes.gains[k, h], rel=1e-9)
        assert np.all(term.taus > 0)
    monkeypatch.setattr(sparse_solver, "MAX_FACTORIZED", 10)
    for place, term in reduced_terms(modes).items():
        assert term.error == pytest.approx(terms[place].error, abs=1e-4)


def test_a_body_without_points_has_no_model(rod, load):
    rod["points"], rod["deflections"] = {}, {}
    body = load(rod)
    modes = thermal_modes(FiniteElements(body).equations())
    with pytest.raises(ModelError, match="there are none"):
        reduced_model(modes, body, {})
