"""Held-out rows: a parameter of several outputs is fitted to all of them."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.diagnosis.held_out import _NormalEquations

SHARED = [(0, "limit")]
# Precision of the shared parameter about zero.
PRIOR = 60.0


def equations(draw, count):
    """Least squares of one output: its own columns, and last the shared one."""
    columns, values = draw.standard_normal((40, count)), draw.standard_normal(40)
    prior = np.append(np.zeros(count - 1), PRIOR)
    matrix = columns.T @ columns + np.diag(prior)
    normal = _NormalEquations(matrix, columns.T @ values, {SHARED[0]: count - 1}, prior)
    return columns, values, normal


def test_shared_moves_are_those_of_one_fit_to_all_outputs():
    draw = np.random.default_rng(4)
    one, other = equations(draw, 3), equations(draw, 4)
    moves = one[2].beside(SHARED, [other[2].of(SHARED)])
    # Both in one: own columns of one, those of the other, the shared one; its prior once.
    table = np.zeros((81, 6))
    table[:40, :2], table[40:80, 2:5] = one[0][:, :2], other[0][:, :3]
    table[:, 5] = np.concatenate([one[0][:, 2], other[0][:, 3], [PRIOR**0.5]])
    joint = np.linalg.lstsq(table, np.concatenate([one[1], other[1], [0.0]]), rcond=None)[0]
    assert moves == pytest.approx(joint[[0, 1, 5]], abs=1e-9)
