"""The post does what physics says, whatever the clock."""

import numpy as np
import pytest
from machines.post import DRIVE, MASSES, Course, Post, duty, even, logged, read, uneven

POST = Post(3)


def test_rest_stays_rest_and_the_steady_state_balances():
    still = POST.simulate(even(50), Course(np.zeros(0), np.zeros(0)))
    assert not still.any()
    late = np.array([0.0, 40.0 * POST.slowest])
    warm = POST.simulate(late, Course(np.zeros(1), np.ones(1)))[-1]
    conductance = POST._in_modes.T @ np.diag(POST.rates) @ POST._in_modes
    assert (conductance @ warm).sum() == pytest.approx(POST.power)
    assert (warm > 0).all()


def test_the_energy_balances_on_the_way():
    time = even(2000, 1.0)
    course = duty(1, time)
    temperature = POST.simulate(time, course)
    conductance = POST._in_modes.T @ np.diag(POST.rates) @ POST._in_modes
    middle = (temperature[1:] + temperature[:-1]) / 2
    lost = np.sum(middle @ conductance.sum(axis=0))
    gained = POST.power * np.sum(logged(course, time)[:-1])
    assert temperature[-1] @ POST.capacity == pytest.approx(gained - lost, rel=1e-4)


def test_the_clock_is_no_matter():
    fine, coarse = even(1201, 5.0), even(101, 60.0)
    course = Course(np.array([33.3, 2000.7]), np.array([1.0, 0.2]))
    every = POST.simulate(fine, course)
    np.testing.assert_allclose(POST.simulate(coarse, course), every[::12], atol=1e-10)
    short = POST.simulate(fine, course, beside=lambda t, T: np.zeros(MASSES))
    np.testing.assert_allclose(short, every, atol=1e-10)


def test_it_goes_on_from_where_it_stood():
    time = even(400)
    course = duty(2, time)
    whole = POST.simulate(time, course)
    rest = POST.simulate(time[150:], course, start=whole[150])
    np.testing.assert_allclose(rest, whole[150:], atol=1e-10)


def test_clocks_and_noise_are_seeded():
    np.testing.assert_array_equal(uneven(4), uneven(4))
    assert np.min(np.diff(uneven(4))) > 0
    assert np.max(np.diff(uneven(4))) > 100
    one, other = (read({"d_z_um": np.zeros(500)}, seed)["d_z_um"] for seed in (1, 2))
    assert np.std(one) == pytest.approx(0.1, rel=0.2)
    assert not np.array_equal(one, other)
    assert DRIVE.startswith("Q_")
