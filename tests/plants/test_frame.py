"""The frame: what it conserves, its symmetries, its size, its accuracy and its reduction."""

import numpy as np
import pytest
from machines.reduction import reduce_frame
from scipy import linalg
from scipy.sparse.linalg import spsolve

from thermaltool.plants.frame import (
    OUTPUTS,
    PROBE_PAIRS,
    FrameGeometry,
    Material,
    build,
    frame_mesh,
    outer_facets,
    pad_facets,
)
from thermaltool.plants.thermoelastic import HeatStepper, surface_heat, symmetric_factor

GEOMETRY = FrameGeometry()


@pytest.fixture(scope="module")
def plant():
    return build(GEOMETRY)


@pytest.fixture(scope="module")
def steady(plant):
    """Nodal temperature rises at Q = 1 [K]."""
    return symmetric_factor(plant.thermal.conduction).solve(plant.heat)


def simulate(plant, heat, air=20.0, dt=0.5, substeps=1):
    return plant.simulate(heat, np.full(len(heat), air), dt, substeps)


def test_surface_and_volume_are_those_of_the_drawing(plant):
    tube, wall, length, height = (
        getattr(GEOMETRY, name) for name in ("tube", "wall", "length", "height")
    )

    def outline(inset):
        width = tube - 2 * inset
        area = (height - 2 * inset) * width + 2 * (length - tube) * width
        return area, 2 * (height - 2 * inset) + 4 * length - 2 * tube - 4 * inset, width

    area, girth, width = outline(0.0)
    surface = 2 * area + girth * width
    assert plant.thermal.film.sum() == pytest.approx(GEOMETRY.film_coefficient * surface)
    hole, _, inner = outline(wall)
    steel = GEOMETRY.material.density * GEOMETRY.material.specific_heat
    assert plant.thermal.capacity.sum() == pytest.approx(steel * (area * width - hole * inner))


def test_heat_in_is_heat_stored_and_convected(plant):
    # The stored heat follows from the state; the convected heat is summed by the trapezoidal rule.
    dt, steps = 2.0, 300
    advance = HeatStepper(plant.thermal, dt)
    states = [np.zeros_like(plant.heat)]
    for _ in range(steps):
        states.append(advance(states[-1], plant.heat))
    stored = (plant.thermal.capacity @ states[-1]).sum()
    convected = np.trapezoid([plant.thermal.film @ state for state in states], dx=dt)
    assert stored + convected == pytest.approx(GEOMETRY.full_power * dt * steps, rel=1e-5)
    assert 0.1 < convected / stored < 1.0


def test_steady_heat_leaves_by_convection(plant, steady):
    assert plant.thermal.film @ steady == pytest.approx(GEOMETRY.full_power, rel=1e-9)


def test_uniform_air_is_an_equilibrium(plant):
    ones = np.ones_like(plant.heat)
    np.testing.assert_allclose(plant.thermal.conduction @ ones, plant.thermal.film, atol=1e-9)


def test_a_uniform_rise_opens_the_gap_and_nothing_else(plant):
    gap = GEOMETRY.height - 2 * GEOMETRY.tube
    expected = dict.fromkeys(plant.rows, 0.0) | {
        "T_column_degC": 1.0,
        "d_y_um": 1e6 * GEOMETRY.material.expansion * gap,
    }
    rises = {name: row.sum() for name, row in plant.rows.items()}
    assert rises == pytest.approx(expected, abs=1e-7)


def test_symmetric_heat_does_not_move_the_tool_out_of_plane(plant, steady):
    assert abs(plant.rows["d_z_um"] @ steady) < 1e-6
    mesh = frame_mesh(GEOMETRY)
    pads = pad_facets(mesh, outer_facets(mesh, GEOMETRY), GEOMETRY)
    front = pads[mesh.p[2][mesh.facets[:, pads]].mean(axis=0) > 0]
    one_side = spsolve(plant.thermal.conduction, surface_heat(mesh, front))
    assert abs(plant.rows["d_z_um"] @ one_side) > 0.1


def test_conduction_is_reciprocal(plant):
    factor = symmetric_factor(plant.thermal.conduction)
    here, there = np.zeros((2, plant.heat.size))
    here[5] = there[-7] = 1.0
    assert factor.solve(here)[-7] == pytest.approx(factor.solve(there)[5], rel=1e-9)


def test_size_is_that_of_the_source(plant, steady):
    outputs = {name: row @ steady for name, row in plant.rows.items()}
    assert steady.max() == pytest.approx(58.0, abs=1.0)
    assert abs(outputs["d_x_um"]) == pytest.approx(77.6, abs=2.0)
    assert outputs["d_y_um"] == pytest.approx(242.4, abs=4.0)
    assert [outputs[name] for name in PROBE_PAIRS] == pytest.approx([6.7, 6.2, 4.1], abs=0.1)


def test_a_conductive_frame_warms_as_one_lump():
    plant = build(FrameGeometry(material=Material(conductivity=1e6)))
    capacity, film = plant.thermal.capacity.sum(), plant.thermal.film.sum()
    time = 20.0 * np.arange(150)
    heat = np.ones_like(time)
    rise = plant.heat.sum() / film * -np.expm1(-time * film / capacity)
    columns = simulate(plant, heat, dt=20.0)
    np.testing.assert_allclose(columns["T_column_degC"] - 20.0, rise, atol=2e-3 * rise[-1])
    air = np.where(time < 20.0, 20.0, 25.0)
    columns = plant.simulate(0.0 * heat, air, 20.0)
    decay = np.exp(-np.maximum(time - 20.0, 0.0) * film / capacity)
    np.testing.assert_allclose(columns["T_column_degC"], 25.0 - 5.0 * decay, atol=2e-3)


def test_half_a_second_is_short_enough_for_the_onset_of_heat(plant):
    heat = np.ones(60)
    coarse, fine = simulate(plant, heat), simulate(plant, heat, substeps=8)
    for name in OUTPUTS:
        limit = 0.001 if name.endswith("_um") else 0.002
        assert np.abs(coarse[name] - fine[name]).max() < limit


@pytest.mark.slow
def test_the_mesh_is_fine_enough(plant, steady):
    finer = build(FrameGeometry(refinement=2))
    better = symmetric_factor(finer.thermal.conduction).solve(finer.heat)
    for name in OUTPUTS:
        assert plant.rows[name] @ steady == pytest.approx(finer.rows[name] @ better, rel=0.01)


def test_heat_acts_after_its_row(plant):
    heat = np.array([0.0, 0.0, 1.0, 1.0])
    columns = simulate(plant, heat, air=31.0)
    np.testing.assert_array_equal(columns["T_column_degC"][:3], 31.0)
    np.testing.assert_array_equal(columns["d_y_um"][:3], 0.0)
    assert columns["d_y_um"][3] > 0.1


def test_far_probes_wait_for_the_heat(plant):
    # Too coarse a mesh lets a pair dip before it rises.
    columns = simulate(plant, np.ones(120))
    for name in PROBE_PAIRS:
        assert columns[name].min() > -0.003
    rise = {name: np.argmax(columns[name] > 0.05) for name in PROBE_PAIRS}
    assert rise["dT_pair3_K"] < rise["dT_pair2_K"] < rise["dT_pair1_K"]


def test_outputs_are_linear_in_the_heat(plant):
    heat = np.linspace(0.0, 1.0, 50) ** 2
    full, quarter = simulate(plant, heat), simulate(plant, 0.25 * heat)
    for name in (*PROBE_PAIRS, "d_x_um", "d_y_um"):
        np.testing.assert_allclose(quarter[name], 0.25 * full[name], atol=1e-9)


@pytest.mark.slow
def test_reduced_plant_repeats_the_full_one(plant):
    reduced = reduce_frame(plant, 20)
    dt, n = 0.5, 800
    block = np.zeros((21, 21))
    block[:20, :20], block[:20, 20:] = reduced.A, reduced.B
    step = linalg.expm(dt * block)
    heat = (np.arange(n) % 400 < 250).astype(float)
    state, outputs = np.zeros(20), np.empty((n, len(reduced.names)))
    for k in range(n):
        outputs[k] = reduced.C @ state
        state = step[:20, :20] @ state + step[:20, 20] * heat[k]
    full = simulate(plant, heat, substeps=2)
    for name, column in zip(reduced.names, outputs.T, strict=True):
        assert np.abs(column - full[name]).max() < 1e-3


@pytest.mark.slow
def test_stated_error_of_the_reduction_is_that_against_the_full_model(plant):
    s = 1j * np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0])
    observe = np.array([plant.rows[name] for name in (*PROBE_PAIRS, "d_x_um", "d_y_um")])
    capacity, conduction = plant.thermal.capacity, plant.thermal.conduction
    full = np.column_stack([observe @ spsolve(conduction + p * capacity, plant.heat) for p in s])
    previous = np.full(len(observe), np.inf)
    for order in (6, 14, 26):
        reduced = reduce_frame(plant, order)
        assert linalg.eigvals(reduced.A).real.max() < 0.0
        deviation = np.abs(reduced.transfer(s) - full).max(axis=1)
        assert np.all(deviation <= reduced.error + 1e-8)
        assert np.all(reduced.error < 0.3 * previous)
        previous = reduced.error


@pytest.mark.parametrize("order", [0, 1000])
def test_an_order_that_cannot_be_is_refused(plant, order):
    with pytest.raises(ValueError, match=f"order {order} is not between 1 and"):
        reduce_frame(plant, order)
