"""The lumped machine: heat balance, limits known in closed form, and machines that differ."""

from dataclasses import replace

import numpy as np
import pytest
from machines.network import (
    BEARING,
    KELVIN,
    NODES,
    OUTPUTS,
    REST,
    STEFAN_BOLTZMANN,
    WALL,
    machine,
)
from scipy.integrate import solve_ivp

SEEDS = range(12)


def full_drive(network, samples, level=1.0):
    return np.tile(network.source(BEARING, level * network.power), (samples, 1))


@pytest.mark.parametrize("seed", SEEDS)
def test_heat_ends_at_the_steady_balance(seed):
    network = machine(seed)
    dt = network.slowest / 50
    reached = network.simulate(full_drive(network, 1200), dt)[-1]
    np.testing.assert_allclose(reached, network.steady(full_drive(network, 1)[0]), rtol=1e-8)


@pytest.mark.parametrize("emissivity", [0.0, 0.8])
def test_heat_that_goes_in_is_stored_or_lost(emissivity):
    network = machine(1)
    dt = network.slowest / 4000
    heat = full_drive(network, 4001, level=2.0)
    temperature = network.simulate(heat, dt, emissivity=emissivity)
    absolute = REST + KELVIN + temperature
    beyond = absolute**4 - (REST + KELVIN) ** 4 - 4 * (REST + KELVIN) ** 3 * temperature
    lost = temperature @ network.balance().sum(axis=0)
    lost += emissivity * STEFAN_BOLTZMANN * beyond @ network.area
    stored = temperature[-1] @ network.capacity
    assert stored + np.trapezoid(lost, dx=dt) == pytest.approx(heat[:-1].sum() * dt, rel=1e-6)
    assert stored < 0.8 * heat[:-1].sum() * dt


def test_only_foundation_and_air_take_heat():
    network = machine(2)
    inside = network.conductance.sum(axis=1)
    foot = [0, WALL]
    assert np.all(inside[foot] > 0.0)
    others = np.setdiff1d(np.arange(NODES), foot)
    np.testing.assert_allclose(inside[others], 0.0, atol=1e-9 * network.conductance.max())
    np.testing.assert_array_equal(network.conductance, network.conductance.T)


def test_lumps_decay_at_their_own_rate():
    # Without conduction each node is alone with its film: an exponential.
    network = machine(3)
    alone = replace(network, conductance=np.zeros_like(network.conductance))
    time = 3.0 * np.arange(200)
    course = alone.simulate(np.tile(alone.film * 7.0, (200, 1)), 3.0)
    rates = alone.film / alone.capacity
    np.testing.assert_allclose(course, 7.0 * -np.expm1(-np.outer(time, rates)), atol=1e-10)


def test_held_inputs_are_exact_at_any_step():
    network = machine(4)
    level = np.repeat(np.random.default_rng(0).random(150), 4)
    film = np.repeat(np.tile([1.0, 1.7, 1.3], 50), 4)
    air = np.repeat(np.random.default_rng(1).random(150), 4)
    heat = level[:, None] * full_drive(network, 1)
    fine = network.simulate(heat, 2.0, film, air)
    coarse = network.simulate(heat[::4], 8.0, film[::4], air[::4])
    np.testing.assert_allclose(coarse, fine[::4], atol=1e-9)


def test_radiation_is_of_second_order_and_agrees_with_an_adaptive_solver():
    network, end = machine(5), 1200.0
    errors = []
    rest = REST + KELVIN

    def rate(_, rise):
        beyond = (rest + rise) ** 4 - rest**4 - 4 * rest**3 * rise
        lost = network.balance() @ rise + 0.9 * STEFAN_BOLTZMANN * network.area * beyond
        return (full_drive(network, 1, 2.0)[0] - lost) / network.capacity

    exact = solve_ivp(rate, (0, end), np.zeros(NODES), method="BDF", rtol=1e-10, atol=1e-10)
    for samples in (60, 120, 240):
        heat = full_drive(network, samples + 1, 2.0)
        got = network.simulate(heat, end / samples, emissivity=0.9)[-1]
        errors.append(np.abs(got - exact.y[:, -1]).max())
    assert errors[0] < 2e-2
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


def test_air_warms_the_machine_as_far_as_the_foundation_lets_it():
    network = machine(6)
    loose = np.diag(network.conductance.sum(axis=1))
    free = replace(network, conductance=network.conductance - loose)
    dt = 50.0
    still = np.zeros((4000, NODES))
    np.testing.assert_allclose(free.simulate(still, dt, air=np.full(4000, 2.0))[-1], 2.0, rtol=1e-6)
    held = network.simulate(still, dt, air=np.full(4000, 2.0))[-1]
    assert np.all((held > 0.0) & (held < 2.0))


def test_a_settled_swing_is_what_the_frequency_response_says():
    network, period, dt = machine(7), 600.0, 2.0
    time = dt * np.arange(int(10 * network.slowest / dt))
    heat = network.source(WALL + 5, 10.0)
    # Held samples lag a swing by half a period of sampling.
    course = np.outer(np.sin(2 * np.pi * (time + dt / 2) / period), heat)
    expected = network.swinging(heat, period)
    swing = np.imag(np.outer(np.exp(2j * np.pi * time / period), expected))
    last = time > time[-1] - period
    got = network.simulate(course, dt)[last]
    np.testing.assert_allclose(got, swing[last], atol=2e-3 * np.abs(expected).max())


def test_uniform_warming_expands_without_bending():
    network = machine(8)
    near, far, column, x, y = network.rows @ np.ones(NODES)
    assert (near, far, column) == pytest.approx((0.0, 0.0, 1.0))
    # Arm along x, column along y: lengths in the ratio of the expansions.
    alone = network.rows.copy()
    alone[:, 2 * WALL :] = 0.0
    assert (alone @ np.ones(NODES))[3] == pytest.approx(0.0, abs=1e-9)
    assert x > 0.0
    assert y > 0.0
    bent = network.rows @ np.r_[np.ones(WALL), -np.ones(WALL), np.zeros(NODES - 2 * WALL)]
    assert bent[3] < 0.0 < bent[4]


def test_machines_are_plausible_and_differ():
    slowest = [machine(seed).slowest for seed in range(60)]
    assert 200.0 < min(slowest) < 500.0
    assert 1800.0 < max(slowest) < 3000.0
    for seed in range(60):
        network = machine(seed)
        steady = network.rows @ network.steady(full_drive(network, 1)[0])
        reached = dict(zip(OUTPUTS, np.abs(steady), strict=True))
        assert 15.0 - 1e-9 <= max(reached["dT_near_K"], reached["dT_far_K"]) <= 45.0 + 1e-9
        assert min(reached["dT_near_K"], reached["dT_far_K"]) > 8.0
        assert all(40.0 < reached[name] < 180.0 for name in ("d_x_um", "d_y_um"))
    assert machine(3) is machine(3)
