"""A recursion over blocks, and over blocks of blocks, is the one row by row."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from thermaltool.responses import recursion
from thermaltool.responses.propagation import recursion_of
from thermaltool.responses.recursion import Recursion


@pytest.mark.parametrize("states", [1, 4, 40])
@pytest.mark.parametrize("first", [False, True], ids=["zero hold", "first hold"])
@pytest.mark.parametrize("rows", [1, 65, 2049, 2500])
def test_it_is_the_recursion_row_by_row(states, first, rows, monkeypatch):
    monkeypatch.setattr(recursion, "MIN_BLOCKS", 20)
    generator = np.random.default_rng(states + rows)
    F = np.diag(np.linspace(0.3, 0.9995, states)) + 0.01 * np.eye(states, k=-1)
    G0, G1, C = (
        generator.standard_normal(shape) for shape in ((states, 2), (states, 2), (3, states))
    )
    G1 = G1 * first
    u, x = generator.standard_normal((rows, 2)), generator.standard_normal(states)
    y, last = Recursion(F, G0, G1, C).run(u, x)
    expected = [C @ x]
    for before, now in itertools.pairwise(u):
        x = F @ x + G0 @ before + G1 @ now
        expected.append(C @ x)
    size = np.max(np.abs(expected))
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(last, x, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("shape", [(0, 5), (1, 0), (1, 1), (3, 200)])
@pytest.mark.parametrize("imaginary", [0.0, 0.3])
@pytest.mark.parametrize("even", [True, False])
def test_recursions_at_once_are_those_of_a_loop(shape, imaginary, even):
    generator = np.random.default_rng(7)
    factor = generator.uniform(0.5, 0.999, shape) * np.exp(1j * imaginary)
    factor = factor if imaginary else factor.real
    factor = np.repeat(factor[:, :1], shape[1], axis=1) if even and shape[1] else factor
    added = generator.standard_normal(shape)
    expected = np.zeros((shape[0], shape[1] + 1), factor.dtype)
    for k in range(shape[1]):
        expected[:, k + 1] = factor[:, k] * expected[:, k] + added[:, k]
    found = recursion_of(factor, added)
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
