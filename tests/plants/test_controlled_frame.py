"""The frame with control heaters: its modes against the mesh, its supplies against the print."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.plants.controlled_frame import (
    CONTROL_POWERS,
    HeaterSupply,
    control_pads,
    controlled_frame,
)
from thermaltool.plants.frame import OUTPUTS, FrameGeometry, build
from thermaltool.plants.thermoelastic import HeatStepper, symmetric_factor

GEOMETRY = FrameGeometry()
FULL = 250.0


@pytest.fixture(scope="module")
def mesh_plant():
    return build(GEOMETRY)


@pytest.fixture(scope="module")
def frame(mesh_plant):
    return controlled_frame(mesh_plant, GEOMETRY, FULL)


@pytest.fixture(scope="module")
def loads(mesh_plant):
    return [mesh_plant.heat, *(FULL * pad for pad in control_pads(GEOMETRY))]


def test_modes_end_where_the_mesh_does(frame, mesh_plant, loads):
    observe = np.array([mesh_plant.rows[name] for name in OUTPUTS])
    steady = observe @ symmetric_factor(mesh_plant.thermal.conduction).solve(np.array(loads).T)
    np.testing.assert_allclose(frame.step_responses(np.array([1e9]))[0], steady, rtol=1e-7)


@pytest.mark.parametrize("place", range(3))
def test_modes_follow_the_mesh_from_the_first_second(frame, mesh_plant, loads, place):
    # 0.02 % of the largest response: the time steps of the mesh, not the modes, make it.
    observe, dt = np.array([mesh_plant.rows[name] for name in OUTPUTS]), 1.0
    advance, state, answers = HeatStepper(mesh_plant.thermal, dt), np.zeros(loads[0].size), []
    for _ in range(120):
        state = advance(state, loads[place])
        answers.append(observe @ state)
    modes = frame.step_responses(dt * np.arange(1, 121))[:, :, place]
    # Deflections; the probes beside the pad are quicker than the steps of the mesh.
    error = np.abs(modes - answers)[:, -2:].max(axis=0)
    assert np.all(error < 2e-4 * np.abs(modes[:, -2:]).max())


def test_samples_of_any_length_are_exact(frame):
    one, many = frame.start(), frame.start()
    one.advance(0.7, np.zeros(2), 100.0)
    for dt in (0.3, 20.0, 29.7, 50.0):
        many.advance(0.7, np.zeros(2), dt)
    expected = 0.7 * frame.step_responses(np.array([100.0]))[0, :, 0]
    assert list(one.outputs().values()) == pytest.approx(expected, rel=1e-9)
    assert many.outputs() == pytest.approx(one.outputs(), rel=1e-9)


def test_heaters_take_what_they_have(frame):
    run = frame.start()
    delivered = [run.advance(0.0, np.array([-50.0, 900.0]), 1.0) for _ in range(60)]
    assert len(CONTROL_POWERS) == 2
    assert np.all(np.array(delivered)[:, 0] == 0.0)
    assert np.max(delivered) <= FULL
    assert delivered[-1][1] == pytest.approx(FULL, rel=0.01)


@pytest.mark.parametrize(("before", "after"), [(0.5, 0.6), (0.5, 0.7), (0.8, 0.7)])
def test_the_outer_loop_is_the_printed_one(before, after):
    supply, h = HeaterSupply(1), 0.02
    supply.advance(np.array([before]), 30.0)
    power = np.array([supply.advance(np.array([after]), h)[0] for _ in range(2000)])
    answer = (power - before) / (after - before)
    assert answer.max() - 1 == pytest.approx(0.45, abs=0.1)
    # Beyond the limit cycle, within 5 % after about 2 s.
    cycle = power[1000:]
    outside = np.abs(answer - 1) > 0.05 + np.ptp(cycle) / abs(after - before)
    assert h * np.flatnonzero(outside)[-1] == pytest.approx(2.0, abs=0.6)
    assert 0.001 < np.ptp(cycle) < 0.02
    rising = np.flatnonzero(np.diff(np.sign(cycle - cycle.mean())) > 0)
    assert h * np.diff(rising).mean() == pytest.approx(2.0, abs=0.4)
    # The mean over a control cycle is what was asked.
    assert cycle.mean() == pytest.approx(after, rel=0.002)


def test_no_place_on_the_frame_closes_its_gap_for_good_as_a_heater_opens_it(mesh_plant, loads):
    # Why heaters hold the gap for a while only: heat of the column leaves through its own surface
    # wherever it enters, and lengthens it.
    factor = symmetric_factor(mesh_plant.thermal.conduction)
    influence = factor.solve(mesh_plant.rows["d_y_um"]) * GEOMETRY.full_power
    opened = mesh_plant.rows["d_y_um"] @ factor.solve(loads[0])
    assert influence.min() == pytest.approx(-0.2 * opened, rel=0.05)
