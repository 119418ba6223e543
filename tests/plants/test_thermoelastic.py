"""The assembly and the time stepping on bars, against analytic solutions."""

import numpy as np
import pytest
from scipy import linalg
from scipy.optimize import brentq
from skfem import MeshHex

from thermaltool.plants.thermoelastic import (
    HeatStepper,
    Material,
    deflection_rows,
    nearest_node,
    surface_heat,
    temperature_row,
    thermal_system,
)

LENGTH, WIDTH, FILM = 0.2, 0.01, 200.0
STEEL = Material()


def bar(elements, across=1):
    side = np.linspace(0.0, WIDTH, across + 1)
    return MeshHex.init_tensor(np.linspace(0.0, LENGTH, elements + 1), side, side)


def end(mesh, x):
    return mesh.facets_satisfying(lambda p: np.abs(p[0] - x) < 1e-9, boundaries_only=True)


def cooled_at_the_end(elements):
    mesh = bar(elements)
    return mesh, thermal_system(mesh, STEEL, FILM, end(mesh, LENGTH))


def order(errors):
    return np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))


def test_slowest_decay_rate_converges_with_second_order_in_the_mesh():
    # Insulated at one end, convecting at the other: rate α(x/L)² with x tan x = h L / k.
    biot = FILM * LENGTH / STEEL.conductivity
    root = brentq(lambda x: x * np.tan(x) - biot, 1e-6, np.pi / 2 - 1e-9)
    diffusivity = STEEL.conductivity / (STEEL.density * STEEL.specific_heat)
    exact = diffusivity * (root / LENGTH) ** 2
    rates = []
    for elements in (2, 4, 8, 16):
        _, system = cooled_at_the_end(elements)
        rates.append(
            linalg.eigh(system.conduction.toarray(), system.capacity.toarray(), eigvals_only=True)[
                0
            ]
        )
    errors = np.array(rates) / exact - 1.0
    assert abs(errors[-1]) < 1e-3
    np.testing.assert_allclose(order(errors), 2.0, atol=0.1)


def test_steady_bar_has_the_gradient_of_its_heat():
    mesh, system = cooled_at_the_end(5)
    load = surface_heat(mesh, end(mesh, 0.0))
    theta = linalg.solve(system.conduction.toarray(), load)
    area = WIDTH**2
    hot, cold = temperature_row(mesh, (0.0, 0.004, 0.007)), temperature_row(mesh, (LENGTH, 0, 0))
    assert cold @ theta == pytest.approx(1.0 / (FILM * area))
    assert (hot - cold) @ theta == pytest.approx(LENGTH / (STEEL.conductivity * area))


def test_time_stepping_is_second_order():
    mesh, system = cooled_at_the_end(10)
    load = surface_heat(mesh, end(mesh, 0.0))
    rates, shapes = linalg.eigh(system.conduction.toarray(), system.capacity.toarray())
    duration = 800.0
    exact = shapes @ ((shapes.T @ load) * -np.expm1(-rates * duration) / rates)
    errors = []
    for steps in (16, 32, 64, 128):
        advance = HeatStepper(system, duration / steps)
        state = np.zeros_like(load)
        for _ in range(steps):
            state = advance(state, load)
        errors.append(np.abs(state - exact).max())
    np.testing.assert_allclose(order(np.array(errors)), 2.0, atol=0.15)


def test_a_very_long_step_lands_on_the_steady_state():
    mesh, system = cooled_at_the_end(10)
    load = surface_heat(mesh, end(mesh, 0.0))
    state = HeatStepper(system, 1e9)(np.zeros_like(load), load)
    np.testing.assert_allclose(system.conduction @ state, load, atol=1e-4)


def held_bar(elements, across):
    """Mesh, its end nodes, and supports that hold it without straining it."""
    mesh = bar(elements, across)
    root, above = nearest_node(mesh, (0, 0, 0)), nearest_node(mesh, (0, WIDTH, 0))
    tip = nearest_node(mesh, (LENGTH, 0, 0))
    supports = [(root, 0), (root, 1), (root, 2), (above, 0), (above, 2), (tip, 2)]
    return mesh, root, tip, supports


def test_a_uniform_rise_expands_freely():
    mesh, root, tip, supports = held_bar(4, 2)
    rows = deflection_rows(mesh, STEEL, [(tip, root, axis) for axis in range(3)], supports)
    np.testing.assert_allclose(
        rows.sum(axis=1), [1e6 * STEEL.expansion * LENGTH, 0.0, 0.0], atol=1e-9
    )


@pytest.mark.slow
def test_a_transverse_gradient_bends_with_second_order_in_the_mesh():
    # T = g y leaves a free bar without stress; its axis bends to u_y = -expansion g x² / 2.
    # Trilinear elements are too stiff in bending by 1 + c h²: the order shows in exact/computed.
    exact = -1e6 * STEEL.expansion * LENGTH**2 / 2.0
    errors = []
    for across in (2, 4, 8):
        mesh, root, tip, supports = held_bar(10 * across, across)
        (row,) = deflection_rows(mesh, STEEL, [(tip, root, 1)], supports)
        errors.append(exact / (row @ mesh.p[1]) - 1.0)
    assert abs(errors[-1]) < 0.02
    np.testing.assert_allclose(order(np.array(errors)), 2.0, atol=0.2)
