"""The damped Gauss-Newton loop and its scaled normal equations, on problems with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.signals.gauss_newton import minimize, solve


def rosenbrock(start, max_iterations=200, **more):
    """10²(y − x²)² + (1 − x)², a curved valley: least squares in two residuals."""

    def residual(p):
        return np.array([10 * (p[1] - p[0] ** 2), 1 - p[0]])

    def normal_equations(p):
        J = np.array([[20 * p[0], -10.0], [1.0, 0.0]])
        return J.T @ J, J.T @ residual(p)

    return minimize(
        np.array(start),
        lambda p: float(residual(p) @ residual(p)),
        normal_equations,
        lambda p, step: p + step,
        lambda p: 1e-18,
        max_iterations,
        **more,
    )


def test_a_curved_valley_is_followed_to_its_end():
    end = rosenbrock([-1.2, 1.0])
    assert end.converged
    assert end.value < 1e-16
    np.testing.assert_allclose(end.point, [1.0, 1.0], atol=1e-7)


def test_too_few_iterations_and_a_search_given_up_do_not_count_as_converged():
    assert not rosenbrock([-1.2, 1.0], 3).converged
    given_up = rosenbrock([-1.2, 1.0], abandoned=lambda p: p[0] > -1.0)
    assert not given_up.converged
    assert -1.0 < given_up.point[0] < 0.9


def test_a_point_without_a_value_is_no_step():
    """The minimum lies at 1, everything above 0.5 is out of bounds."""
    end = minimize(
        0.0,
        lambda x: (x - 1) ** 2 if x <= 0.5 else float("inf"),
        lambda x: (np.ones((1, 1)), np.array([1 - x])),
        lambda x, step: x + float(step[0]),
        lambda x: 1e-12,
        200,
    )
    assert end.point == pytest.approx(0.5, abs=1e-4)
    assert end.value == pytest.approx(0.25, abs=1e-4)


def test_no_step_is_tried_where_none_is_promised():
    linearized, tried = [], []

    def normal_equations(x):
        linearized.append(x)
        return np.eye(1), -x

    def moved(x, step):
        tried.append(step)
        return x + step

    end = minimize(np.zeros(1), lambda x: float(x @ x), normal_equations, moved, lambda x: 1e-9, 10)
    assert end.converged
    assert end.value == 0.0
    assert (len(linearized), tried) == (1, [])


def test_normal_equations_are_solved_across_scales_and_without_support():
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((40, 3)) * [1e-9, 1.0, 1e9]
    matrix = rows.T @ rows
    wanted = np.array([1e9, -2.0, 3e-9])
    np.testing.assert_allclose(solve(matrix, matrix @ wanted), wanted, rtol=1e-9)
    padded = np.zeros((4, 4))
    padded[:3, :3] = matrix
    found = solve(padded, np.append(matrix @ wanted, 0.0))
    np.testing.assert_allclose(found[:3], wanted, rtol=1e-9)
    assert found[3] == 0.0
