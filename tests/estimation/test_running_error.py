"""Standard errors of a filter along its way, beside the errors of drawn machines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.errors import FitError
from thermaltool.estimation.estimator import KalmanEstimator, SensorNoise
from thermaltool.estimation.running_error import RunningError, running_errors
from thermaltool.responses.modes import Modes
from thermaltool.responses.sample_clock import CLOCK_STEP

DT, LEVEL = 2.0, 50.0


def estimator(rates=(-1 / 300.0, -1 / 40.0)):
    """One heat of two time constants, read by one sensor, and a deflection behind it."""
    poles = np.array(rates, complex)
    sensed, followed = Modes(poles, np.array([3e-4, 1e-3]) + 0j), Modes(poles, np.array([1e-2, 0j]))
    noise = (SensorNoise(0.02, 0.01, 600.0),)
    return KalmanEstimator(
        ("dT_K",), ("Q_W",), ("d_um",), ((0, 0, sensed),), ((0, 0, followed),), (2.0,), noise
    )


@pytest.mark.parametrize("initial", ["rest", "settled", "free"])
def test_errors_of_drawn_machines_are_as_large_as_told(initial):
    """Machines of the state space itself, whose heat wanders twice as fast as the design has it."""
    generator, rows, draws = np.random.default_rng(71), 60, 4000
    own = estimator()
    true = replace(own, walk=(4.0,))
    space, start = true.state_space(DT), true.start_covariance(DT, [LEVEL], initial)
    recursion = own.recursion(DT)

    def drawn(P):
        size, vectors = np.linalg.eigh(P)
        return (generator.normal(size=(draws, len(P))) * np.sqrt(np.maximum(size, 0))) @ vectors.T

    def read(x):
        return x @ space.H.T + np.sqrt(space.R[0, 0]) * generator.normal(size=(draws, 1))

    x = drawn(start)
    found = np.zeros_like(x)
    if initial == "settled":
        found = read(x) @ own.start(DT, np.ones(1), True)[None, :]
    rms = [np.sqrt(np.mean(((found - x) @ space.C.T) ** 2, axis=0))]
    for _ in range(rows - 1):
        x = x @ space.F.T + drawn(space.Q)
        found = found @ recursion.F.T + read(x) @ recursion.G1.T
        rms.append(np.sqrt(np.mean(((found - x) @ space.C.T) ** 2, axis=0)))
    told = running_errors(RunningError(own, DT, [LEVEL], true), DT * np.arange(rows), initial)
    # Of 4000 draws a root mean square is sure to 1.1 %.
    np.testing.assert_allclose(told, rms, rtol=0.06, atol=1e-9)
    assert (told[0, 0] > 3 * told[-1, 0]) == (initial != "settled")


def test_in_a_pause_it_grows_and_comes_back():
    error = RunningError(estimator(), DT, [LEVEL])
    steady = error.sigma.copy()
    error.start("rest")
    assert error.sigma[0] == pytest.approx(LEVEL)
    for _ in range(3000):
        error.step(round(DT / CLOCK_STEP))
    np.testing.assert_allclose(error.sigma, steady, rtol=1e-5)
    error.step(round(300 * DT / CLOCK_STEP))
    assert error.sigma[0] > 1.2 * steady[0]
    kept = error.state()
    for _ in range(3000):
        error.step(round(DT / CLOCK_STEP))
    np.testing.assert_allclose(error.sigma, steady, rtol=1e-5)
    error.resume(kept)
    assert error.sigma[0] > 1.2 * steady[0]


def test_a_response_that_does_not_decay_has_standard_errors_too():
    lasting = estimator((0.0, -1 / 40.0))
    with pytest.raises(FitError, match="does not decay"):
        lasting.start_covariance(DT, [LEVEL], "free")
    found = running_errors(RunningError(lasting, DT, [LEVEL]), DT * np.arange(50), "free")
    assert np.all(np.isfinite(found))


def test_states_of_others_are_refused():
    error = RunningError(estimator(), DT, [LEVEL])
    for state in ([69, [], [[1.0]]], [69, [3], None]):
        with pytest.raises(ValueError, match="not a state"):
            error.resume(state)
