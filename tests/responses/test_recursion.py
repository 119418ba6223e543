"""A recursion over blocks, and over blocks of blocks, is the one row by row."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from thermaltool.responses import recursion
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
