"""The regularized inverse: singular weights, kernel, modes."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from reference import fraser1997 as fraser
from scipy.signal import fftconvolve

from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.kernel import Regularization, invert_modes, kernel_table
from thermaltool.responses.conduction import Conduction
from thermaltool.responses.deflection import Deflection

PAIR, MAIN = Conduction(**fraser.PAIR), Conduction(**fraser.MAIN)
SHAPE = Regularization(**fraser.PAIR_REGULARIZATION)
PRINTED_MAIN = Regularization(**fraser.MAIN_REGULARIZATION)
OWN_MAIN = Regularization(0.02, 2e-4, 0.05)
both = pytest.mark.parametrize(("source", "shape"), [(PAIR, SHAPE), (MAIN, OWN_MAIN)])


@both
def test_singular_weights_are_the_limits_of_the_inverse(source, shape):
    """G(s) = A1 s + A0 + O(1/s), with 60 digits and the printed formula of H."""
    with mpmath.workdps(60):
        A, B, c, K, a, alpha, r, r0 = map(
            mpmath.mpf,
            (shape.A, shape.B, shape.c, source.K, source.a, source.alpha, source.r, source.r0),
        )

        def G(s):
            lam = mpmath.sqrt(a + s / alpha)
            H = K * mpmath.besseli(0, r0 * lam) * mpmath.besselk(0, r * lam)
            return 1 / (H + A * s / (s + c) ** 2 + 2 * B * s / (s + c) ** 3)

        s = mpmath.mpf(10) ** 14
        slope = G(2 * s) - G(s)
        A1 = float(slope / s)
        A0 = float(2 * G(s) - G(2 * s))
    assert shape.singular_weights() == pytest.approx((A0, A1), rel=1e-9)


@both
def test_the_added_transfer_is_the_laplace_transform_of_the_added_step(source, shape):
    with mpmath.workdps(30):
        for s in (0.3 * shape.c, shape.c * (1 + 2j)):
            whole = mpmath.quad(
                lambda t, s=s: (shape.A * t + shape.B * t**2) * mpmath.exp(-(shape.c + s) * t),
                [0, 5 / shape.c, 40 / shape.c, 100 / shape.c],
            )
            expected = complex(s * whole)
            got = shape.transfer(np.array([s]))[0]
            assert abs(got - expected) < 1e-12 * abs(expected)
    s, h = np.array([0.02 + 0.1j]), 1e-5
    slope = (shape.transfer(s + h) - shape.transfer(s - h)) / (2 * h)
    np.testing.assert_allclose(shape.slope(s), slope, rtol=1e-6)


@pytest.fixture(scope="module")
def table():
    return kernel_table(PAIR.transfer, SHAPE, fraser.PERIOD, 20_000)


def test_printed_weights(table):
    assert pytest.approx(fraser.PAIR_A0, abs=0.005) == table.A0
    assert table.weight.sum() == pytest.approx(fraser.PAIR_KERNEL_INTEGRAL, abs=0.005)
    assert (table.weight.sum() + table.A0) * PAIR.dc_gain() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(("window", "left"), fraser.TRUNCATION.items())
def test_truncation_leaves_what_the_reference_page_says(table, window, left):
    kept = table.weight[: int(window / fraser.PERIOD)].sum() + table.A0
    assert kept * PAIR.dc_gain() - 1 == pytest.approx(left, abs=0.02 if left < 0 else 0.001)


def recovered(table, step):
    """Q̂ for a temperature that follows `step` [K], sampled, a straight line between samples."""
    rise = np.diff(step, prepend=0.0)
    return fftconvolve(table.weight, step)[: len(step)] + table.A0 * step + table.A1 * rise / 0.5


def test_kernel_recovers_the_heat(table):
    t = table.time
    own = PAIR.step(t) + (SHAPE.A * t + SHAPE.B * t**2) * np.exp(-SHAPE.c * t)
    heat = recovered(table, own)
    assert np.max(np.abs(heat[t > 60] - 1)) < 2e-3
    assert np.max(np.abs(heat[t > 3000] - 1)) < 1e-6
    heat = recovered(table, PAIR.step(t))
    assert np.max(np.abs(heat[t > 3000] - 1)) < 1e-6


def test_the_transient_is_of_first_order_in_the_sample():
    """A1 takes the slope over the last sample, half a sample late."""
    errors = []
    for dt in (1.0, 0.5):
        table = kernel_table(PAIR.transfer, SHAPE, dt, int(300 / dt))
        t = table.time
        own = PAIR.step(t) + (SHAPE.A * t + SHAPE.B * t**2) * np.exp(-SHAPE.c * t)
        rise = np.diff(own, prepend=0.0) / dt
        heat = fftconvolve(table.weight, own)[: len(t)] + table.A0 * own + table.A1 * rise
        errors.append(np.max(np.abs(heat[t > 20] - 1)))
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.05)


def test_kernel_estimates_its_error():
    coarse = kernel_table(PAIR.transfer, SHAPE, 0.5, 400, tol=1e-4)
    fine = kernel_table(PAIR.transfer, SHAPE, 0.5, 400, tol=1e-11)
    assert np.max(np.abs(coarse.weight - fine.weight)) <= coarse.error + fine.error


@both
def test_inverse_is_the_reciprocal_on_the_imaginary_axis(source, shape):
    inverse = invert_modes(source.modes(0.5), shape)
    s = 1j * np.concatenate([[0], np.geomspace(1e-6, 30, 200)])
    exact = 1 / (source.transfer(s) + shape.transfer(s))
    np.testing.assert_allclose(inverse.transfer(s), exact, rtol=1e-3)
    own = 1 / (source.modes(0.5).transfer(s) + shape.transfer(s))
    np.testing.assert_allclose(inverse.transfer(s), own, rtol=1e-6)
    assert pytest.approx(shape.singular_weights(), rel=1e-3) == (inverse.A0, inverse.A1)


def test_filtered_inverse():
    inverse = invert_modes(PAIR.modes(0.5), SHAPE)
    s = 1j * np.geomspace(1e-5, 10, 100)
    omega = 2 * np.pi * 0.06
    butterworth = omega**3 / ((s + omega) * (s**2 + omega * s + omega**2))
    np.testing.assert_allclose(
        inverse.filtered(0.06).transfer(s), inverse.transfer(s) * butterworth, rtol=1e-8, atol=1e-9
    )


def test_the_printed_regularization_rings():
    assert invert_modes(PAIR.modes(0.5), SHAPE).damping == pytest.approx(0.235, abs=0.005)


def winding(source, shape):
    """Zeros of H_R in the right half-plane, by the argument principle on its own formula."""
    omega = np.concatenate([[0], np.geomspace(1e-7, 1e4, 200_000)])
    # Times (s + c), which adds a zero on the left and keeps the value at infinity finite.
    curve = (source.transfer(1j * omega) + shape.transfer(1j * omega)) * (1j * omega + shape.c)
    turned = np.unwrap(np.angle(curve))
    return round(-(turned[-1] - turned[0]) / np.pi)


def test_the_printed_regularization_of_the_main_source_is_unstable():
    assert winding(PAIR, SHAPE) == 0
    assert winding(MAIN, OWN_MAIN) == 0
    assert winding(MAIN, PRINTED_MAIN) == 2
    with pytest.raises(FitError, match="unstable: a zero lies in the right half-plane"):
        invert_modes(MAIN.modes(0.5), PRINTED_MAIN)


def test_unstable_inverses_are_refused():
    shape = Regularization(-SHAPE.A, SHAPE.B, SHAPE.c)
    with pytest.raises(FitError, match="unstable: a zero lies in the right half-plane"):
        invert_modes(PAIR.modes(0.5), shape)


@pytest.mark.parametrize("values", [(0, 1, 1), (1, 1, 0), (1, 1, -1), (np.nan, 1, 1)])
def test_regularizations_without_an_inverse(values):
    with pytest.raises(ModelError, match="A other than 0 and c above 0"):
        Regularization(*values)


def test_a_response_without_delay_has_other_singular_weights():
    deflection = Deflection(**fraser.LINEAR_X)
    with pytest.raises(FitError, match="zero slope"):
        kernel_table(deflection.transfer, SHAPE, 0.5, 10)
    with pytest.raises(FitError, match="simple real modes"):
        invert_modes(deflection.modes(0.5), SHAPE)


def test_a_kernel_whose_first_singular_weight_is_zero():
    shape = Regularization(2**-7, 2**-11, 2**-4)
    assert shape.singular_weights()[0] == 0
    kernel = kernel_table(PAIR.transfer, shape, 0.5, 50)
    assert np.all(np.isfinite(kernel.weight))
    assert kernel.error < 1e-6 * np.max(np.abs(kernel.weight))
