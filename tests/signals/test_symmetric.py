"""Symmetric matrices for which divide and conquer fails."""

import numpy as np
import pytest

from thermaltool.signals.symmetric import eigh, pseudo_inverse


@pytest.fixture
def no_divide_and_conquer(monkeypatch):
    def fails(*given, **options):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    for name in ("eigh", "pinv"):
        monkeypatch.setattr(np.linalg, name, fails)


def spread():
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((6, 6)))[0]
    values = np.array([1e-14, 1e-3, 0.1, 1.0, 2.0, 5.0])
    return values, turn, turn @ np.diag(values) @ turn.T


def test_another_way_has_the_same_result(no_divide_and_conquer):
    values, turn, matrix = spread()
    found, vectors = eigh(matrix)
    np.testing.assert_allclose(found, values, atol=1e-13)
    np.testing.assert_allclose(vectors @ np.diag(found) @ vectors.T, matrix, atol=1e-13)
    inverse = (turn[:, 1:] / values[1:]) @ turn[:, 1:].T
    np.testing.assert_allclose(pseudo_inverse(matrix, 1e-10), inverse, rtol=1e-9, atol=1e-9)
    several = pseudo_inverse(np.array([matrix, 2 * matrix]), 1e-10)
    np.testing.assert_allclose(several, [inverse, inverse / 2], rtol=1e-9, atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        eigh(np.full((2, 2), np.nan))


def test_without_need_it_is_the_usual_one():
    matrix = spread()[2]
    usual = np.linalg.pinv(matrix, rcond=1e-10, hermitian=True)
    np.testing.assert_array_equal(pseudo_inverse(matrix, 1e-10), usual)
