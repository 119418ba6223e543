"""Modes of a rod and of blocks against closed forms and against the published figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from thermaltool.errors import ModelError
from thermaltool.placement import sparse_solver, thermal_modes
from thermaltool.placement.finite_elements import FiniteElements, Thermoelasticity

# Zhu, Ni, Shih 2008, Fig. 2, recomputed from Table 1 [min].
PUBLISHED = [141.0, 56.5, 20.1, 9.6]


def modes_of(body, count=None):
    return thermal_modes.thermal_modes(FiniteElements(body).equations(), count)


def test_the_rod_has_its_published_time_constants(rod, load):
    found = modes_of(load(rod)).time_constants / 60
    np.testing.assert_allclose(found[:4], PUBLISHED, atol=0.05)


def test_the_rod_converges_to_the_closed_form(rod, load):
    rod["mesh"]["rod"]["elements"] = 400
    rates = 1 / modes_of(load(rod)).time_constants[:6]
    perimeter, area, heat = 2 * np.sqrt(np.pi * 0.0314), 0.0314, 7800 * 434
    wave = np.arange(6) * np.pi
    exact = (20 * perimeter / area + 60.5 * wave**2) / heat
    np.testing.assert_allclose(rates, exact, rtol=3e-4)


def test_weights_of_the_rod_heated_at_its_end(rod, load):
    parts = modes_of(load(rod)).relative_weights[:, 0]
    # The print says more than 90 %. Of all 23 modes three have 84.5 %; of the first six 90.2 %.
    assert parts[:3].sum() == pytest.approx(0.845, abs=0.001)
    assert parts[:3].sum() / parts[:6].sum() == pytest.approx(0.902, abs=0.001)
    # Closed form of a finer mesh: |ξτ| ∝ τ, and √2 times that for all but the first.
    rod["mesh"]["rod"]["elements"] = 300
    found = modes_of(load(rod))
    ratio = found.weights[:6, 0] / found.weights[0, 0]
    taus = found.time_constants[:6] / found.time_constants[0]
    np.testing.assert_allclose(ratio, taus * [1, *[np.sqrt(2)] * 5], rtol=1e-3)


def test_shapes_are_normal_to_the_capacity(block, load):
    found = modes_of(load(block))
    capacity, conduction = (found.equations.capacity, found.equations.conduction)
    np.testing.assert_allclose(found.shapes.T @ (capacity @ found.shapes),
                               np.eye(len(found.time_constants)), atol=1e-9)  # fmt: skip
    rates = found.shapes.T @ (conduction @ found.shapes)
    np.testing.assert_allclose(np.diag(rates) * found.time_constants, 1.0, rtol=1e-8)


def test_contributions_of_all_modes_make_the_steady_state(block, load):
    found = modes_of(load(block))
    assert found.is_complete
    np.testing.assert_allclose(found.contributions.sum(axis=1), found.gains, rtol=1e-8)
    # All heat leaves by the face that convects.
    film, area = 900.0, 0.1 * 0.08
    cold = found.steady_states[np.isclose(load(block).mesh.p[0], 0)]
    np.testing.assert_allclose(cold.mean(axis=0), 1 / (film * area), rtol=0.02)


def test_a_block_has_separable_modes(block, load):
    rates = []
    for finer in (1, 2):
        block["mesh"]["block"]["divisions"] = [8 * finer, 4 * finer, 4 * finer]
        rates.append(1 / modes_of(load(block), 8).time_constants)
    # Linear elements: the error falls with the square of their size.
    extrapolated = (4 * rates[1] - rates[0]) / 3
    # Convection on one face: β tan β = h L / k along x; cosines across.
    length, width, height = 0.2, 0.1, 0.08
    biot, diffusivity = 900.0 * length / 60.5, 60.5 / (7800 * 434)
    along = [
        brentq(lambda b: b * np.sin(b) - biot * np.cos(b), k * np.pi, (k + 0.5) * np.pi) / length
        for k in range(6)
    ]
    exact = sorted(
        diffusivity * (x**2 + (m * np.pi / width) ** 2 + (n * np.pi / height) ** 2)
        for x in along for m in range(4) for n in range(4)
    )  # fmt: skip
    np.testing.assert_allclose(extrapolated, exact[:8], rtol=0.004)


def test_lanczos_agrees_with_all_modes_and_gradients_with_the_factor(block, load, monkeypatch):
    body = load(block)
    every = modes_of(body)
    monkeypatch.setattr(thermal_modes, "MAX_COMPLETE", 10)
    factored = modes_of(body, 6)
    monkeypatch.setattr(sparse_solver, "MAX_FACTORIZED", 10)
    iterated = modes_of(body, 6)
    for few in (factored, iterated):
        assert not few.is_complete
        np.testing.assert_allclose(few.time_constants, every.time_constants[:6], rtol=1e-7)
        np.testing.assert_allclose(few.weights[:3], every.weights[:3], rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(few.gains, every.gains, rtol=1e-6)


def test_a_deflection_is_that_of_the_displacements(block, load):
    elements = FiniteElements(load(block))
    row = elements.equations().deflections[0]
    temperatures = np.random.default_rng(1).uniform(0, 5, len(row))
    moved = Thermoelasticity(elements).displacements(temperatures)
    corner = np.argmin(np.sum((elements.body.mesh.p.T - [0.2, 0.0, 0.08]) ** 2, axis=1))
    assert row @ temperatures == pytest.approx(moved[0, corner], rel=1e-8)


def test_a_bar_that_is_held_loosely_expands_freely(block, load):
    # The clamped end of a long bar matters little.
    block["mesh"]["block"] = {"size": [2.0, 0.05, 0.05], "divisions": [80, 2, 2]}
    block["deflections"] = {"d_tip_um": {"at": [2.0, 0.025, 0.025], "direction": "x"}}
    block["points"] = {}
    row = FiniteElements(load(block)).equations().deflections[0]
    assert row.sum() == pytest.approx(10.8e-6 * 2.0, rel=0.01)


@pytest.mark.parametrize(("end", "sign"), [("left", 1), ("right", -1)])
def test_a_rod_expands_by_the_integral_of_its_temperature(rod, load, end, sign):
    rod["supports"]["fixed"] = [end]
    rod["deflections"] = {"d_a_um": {"at": 0.33, "direction": "x"},
                          "d_b_um": {"at": 0.33, "direction": "x", "against": 0.9}}  # fmt: skip
    body = load(rod)
    at_point, between = FiniteElements(body).equations().deflections
    x = body.mesh.p[0]
    length = 0.33 if end == "left" else 0.67
    assert at_point.sum() == pytest.approx(sign * 10.8e-6 * length)
    # ∫ x dx, whatever end is held.
    assert between @ x == pytest.approx(-10.8e-6 * (0.9**2 - 0.33**2) / 2)


def test_the_deflection_shape_of_the_slowest_mode_is_a_straight_line(rod, load):
    elements = FiniteElements(load(rod))
    found = thermal_modes.thermal_modes(elements.equations())
    moved = Thermoelasticity(elements).displacements(found.unit_shapes[:, 0])[0]
    np.testing.assert_allclose(moved, 10.8e-6 * elements.body.mesh.p[0], rtol=1e-8, atol=1e-15)
    # The others return to nothing at the tip: cosines that have no mean.
    assert np.max(np.abs(found.contributions[-1, 1:, 0])) < 1e-9 * found.gains[-1, 0]


@pytest.mark.slow
def test_a_hundred_thousand_nodes(block, load):
    block["mesh"]["block"] = {"size": [0.3, 0.3, 0.3], "divisions": [46, 46, 46]}
    del block["deflections"]
    found = modes_of(load(block), 12)
    assert found.shapes.shape == (47**3, 12)
    left = found.equations.conduction @ found.shapes
    right = (found.equations.capacity @ found.shapes) / found.time_constants
    assert np.max(np.abs(left - right)) < 1e-6 * np.max(np.abs(right))


@pytest.mark.parametrize("at", [-0.2, 5.0])
def test_a_point_off_a_rod_is_named(rod, load, at):
    for table, entry in (("points", {"T_a_degC": {"at": at}}),
                         ("deflections", {"d_a_um": {"at": at, "direction": "x"}})):  # fmt: skip
        with pytest.raises(ModelError, match="m from the body"):
            FiniteElements(load({**rod, table: entry})).equations()
