"""Foster and Cauer networks are the same impedance."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from machines.foster import EIGHT_DECADES, THREE_DECADES, Foster

from thermaltool.errors import FitError
from thermaltool.fitting.spectrum.ladder import cauer_ladder, foster_capacities


def impedance(resistances: np.ndarray, capacities: np.ndarray, s: complex) -> complex:
    """Of a ladder, from ambient to the node."""
    z = 0j
    for r, c in zip(resistances[::-1], capacities[::-1], strict=True):
        z = 1 / (s * c + 1 / (r + z))
    return z


def test_two_cells_by_hand() -> None:
    """1/(C1 s + 1/(R1 + 1/(C2 s + 1/R2))), its coefficients compared with those of two lags."""
    a, b, p, q = Fraction(3), Fraction(5), Fraction(2), Fraction(7)  # R, R, tau, tau
    z0, z1 = a + b, a * q + b * p  # Z = (z1 s + z0)/(p q s² + (p + q) s + 1)
    c1 = p * q / z1
    rest = (p + q) - c1 * z0
    r1 = z1 / rest
    r2 = z0 - r1
    c2 = rest / r2
    ladder = cauer_ladder(np.array([2.0, 7.0]), np.array([3.0, 5.0]))
    np.testing.assert_allclose(ladder.capacities, [float(c1), float(c2)], rtol=1e-15)
    np.testing.assert_allclose(ladder.resistances, [float(r1), float(r2)], rtol=1e-15)


@pytest.mark.parametrize("plant", [THREE_DECADES, EIGHT_DECADES])
def test_the_ladder_has_the_impedance_of_the_cells(plant: Foster) -> None:
    ladder = cauer_ladder(plant.taus, plant.resistances)
    assert np.all(ladder.resistances > 0)
    assert np.all(ladder.capacities > 0)
    for rate in np.geomspace(1e-6, 1e6, 25):
        cells = np.sum(plant.resistances / (1 + 1j * rate * plant.taus))
        found = impedance(ladder.resistances, ladder.capacities, 1j * rate)
        assert found == pytest.approx(cells, rel=1e-12)
    resistance, capacity = ladder.cumulative()
    assert resistance[-1] == pytest.approx(plant.resistances.sum(), rel=1e-13)
    assert capacity[0] == pytest.approx(1 / np.sum(plant.resistances / plant.taus), rel=1e-13)


def test_a_hundred_cells_keep_their_digits() -> None:
    rng = np.random.default_rng(3)
    taus, resistances = np.geomspace(1e-6, 1e4, 120), rng.uniform(1e-6, 1.0, 120)
    ladder = cauer_ladder(taus, resistances)
    for rate in (1e-5, 1.0, 1e5):
        cells = np.sum(resistances / (1 + 1j * rate * taus))
        found = impedance(ladder.resistances, ladder.capacities, 1j * rate)
        assert found == pytest.approx(cells, rel=1e-12)


def test_capacities_of_cells() -> None:
    assert foster_capacities(np.array([6.0]), np.array([3.0])).tolist() == [2.0]


def test_equal_time_constants_have_no_ladder() -> None:
    with pytest.raises(FitError, match="too near"):
        cauer_ladder(np.array([2.0, 2.0]), np.array([1.0, 1.0]))
