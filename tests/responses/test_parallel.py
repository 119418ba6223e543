"""Responses side by side in one recursion add up as they do apart."""

from __future__ import annotations

import numpy as np

from thermaltool.responses.deflection import Deflection
from thermaltool.responses.parallel import parallel
from thermaltool.responses.rational import Oscillation1, Rational2

DT = 5.0
A = Deflection(-60.0, 1 / 500, 20.0, 1 / 90, 0.1, 1 / 40)
B, C = Rational2(3.0, 40.0, -1.0, 700.0, 17.0), Oscillation1(2.0, 0.5, 0.02, 0.4, 1.0, 200.0)
PATHS = [
    (0, 0, A.modes(DT)),
    (1, 0, B.modes(DT)),
    (1, 1, C.modes(DT)),
    (0, 1, 0.25),
    (1, 1, A.modes(DT)),
]


def test_outputs_are_the_sums_of_their_paths():
    u = np.random.default_rng(1).standard_normal((300, 2))
    together, _ = parallel(PATHS, ("zero", "first"), 3, DT).run(u)
    apart = np.zeros((300, 3))
    time = DT * np.arange(300)
    for to, source, response in PATHS:
        if isinstance(response, float):
            # A gain at once; nothing acts at the first row.
            apart[1:, to] += response * u[1:, source]
        else:
            apart[:, to] += response.run(time, u[:, source], ("zero", "first")[source])
    np.testing.assert_allclose(together, apart, atol=1e-10)


def test_nothing_side_by_side_is_nothing():
    y, x = parallel([], ("zero",), 2, DT).run(np.ones((4, 1)))
    assert not y.any()
    assert y.shape == (4, 2)
    assert len(x) == 0
