"""Tubes: free expansion, bending, conduction."""

import numpy as np
import pytest

from thermaltool.plants.tubes import SECTORS, Chain, Metal, Tube

METAL = Metal()
FRAME = [
    Tube((0.25, 0.0), (0.0, 0.0), 0.1, 0.02, 5, square=True),
    Tube((0.0, 0.0), (0.1, 0.5), 0.1, 0.02, 9),
    Tube((0.1, 0.5), (0.4, 0.6), 0.12, 0.03, 4, square=True),
]


def test_an_even_rise_scales_the_whole_frame():
    chain = Chain(FRAME, METAL, 0.1)
    point = (0.4, 0.6)
    moved = chain.motion(point) @ np.full(chain.pieces, 3.0)
    grown = 3.0 * METAL.expansion * 1e6 * np.subtract(point, FRAME[0].start)
    np.testing.assert_allclose(moved[:2], grown, rtol=1e-12)
    assert abs(moved[2]) < 1e-9


@pytest.mark.parametrize("square", [False, True])
def test_a_gradient_across_bends_to_a_circle(square):
    tube = Tube((0.0, 0.0), (0.0, 0.4), 0.2, 0.01, 50, square)
    chain = Chain([tube], METAL, 1.0)
    gradient = 20.0  # [K/m], warmer to the left of the axis, which is -x
    rise = np.tile(gradient * tube.offsets(), tube.segments)
    x, z, turn = chain.motion((0.0, 0.4)) @ rise
    bent = 1e6 * METAL.expansion * gradient
    assert turn == pytest.approx(bent * 0.4, rel=1e-12)
    assert x == pytest.approx(bent * 0.4**2 / 2, rel=1e-3)
    assert z == pytest.approx(0.0, abs=1e-9)


def test_two_points_of_a_rigid_tool_tell_the_turn():
    chain = Chain(FRAME, METAL, 0.1)
    rise = np.random.default_rng(4).uniform(0, 10, chain.pieces)
    near, far = (chain.motion((0.4, z)) @ rise for z in (0.5, 0.3))
    assert (far[0] - near[0]) / -0.2 == pytest.approx(near[2])
    assert near[1] == pytest.approx(far[1])


def test_a_joint_conducts_as_the_metal_beside_it():
    whole = Chain([Tube((0.0, 0.0), (0.0, 1.0), 0.1, 0.01, 10)], METAL, 1.0)
    halves = Chain(
        [Tube((0.0, 0.0), (0.0, 0.5), 0.1, 0.01, 5), Tube((0.0, 0.5), (0.0, 1.0), 0.1, 0.01, 5)],
        METAL,
        1.0,
    )
    np.testing.assert_allclose(halves.conductance(), whole.conductance(), rtol=1e-12)
    np.testing.assert_allclose(halves.capacity(), whole.capacity(), rtol=1e-12)


def test_heat_along_a_rod_falls_in_a_straight_line():
    """q = k A ΔT/L between the foot and an evenly heated end."""
    tube = Tube((0.0, 0.0), (0.0, 1.0), 0.1, 0.01, 10)
    chain = Chain([tube], METAL, 1.0)
    heat = np.zeros(chain.pieces)
    heat[-SECTORS:] = 8.0 / SECTORS
    rise = np.linalg.solve(chain.conductance(), heat)
    slope = 8.0 / (METAL.conductivity * tube.girth * tube.wall)
    np.testing.assert_allclose(rise[::SECTORS], slope * tube.middles()[:, 1], rtol=1e-9)
