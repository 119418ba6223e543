"""Dead time: an output later by the delay, whatever the sample."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from thermaltool.errors import ModelError
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.fitting.output_fit import fit_output
from thermaltool.model import Drive, simulate_response
from thermaltool.record import Record
from thermaltool.responses.delay import DelayedModes, load_modes
from thermaltool.responses.modes import Modes
from thermaltool.responses.rational import Oscillation1, Rational2

RESPONSES = [Rational2(3.0, 40.0, -1.2, 6.0, delay) for delay in (5.0, 15.0, 17.3, 2.2)]
RESPONSES += [Oscillation1(1.0, 0.3, 0.1, 0.3, -0.5, 30.0, 12.5)]
delayed = pytest.mark.parametrize("response", RESPONSES, ids=lambda r: f"{r.kind}-{r.delay:g}")
holds = pytest.mark.parametrize("hold", ["zero", "first"])


@delayed
def test_the_step_comes_later(response):
    t = np.linspace(-10, 400, 300)
    prompt = Modes(response.modes(1.0).poles, response.modes(1.0).weights)
    np.testing.assert_allclose(response.step(t), prompt.step(t - response.delay), atol=1e-12)
    np.testing.assert_allclose(response.modes(1.0).step(t), response.step(t), atol=1e-12)
    s = np.array([0.01 + 0.2j])
    expected = prompt.transfer(s) * np.exp(-s * response.delay)
    np.testing.assert_allclose(response.transfer(s), expected, rtol=1e-12)
    np.testing.assert_allclose(response.modes(1.0).transfer(s), expected, rtol=1e-12)


def fine(response, time, u, hold):
    """The same by the prompt modes on a clock so fine that the delay is a number of samples."""
    step, dense = 0.1, np.arange(0, time[-1] + 0.05, 0.1)
    row = np.clip(np.searchsorted(time, dense + 1e-9, side="right") - 1, 0, len(time) - 1)
    known = u[row] if hold == "zero" else np.interp(dense, time, u)
    prompt = Modes(response.modes(1.0).poles, response.modes(1.0).weights)
    shift = round(response.delay / step)
    y = np.concatenate([np.zeros(shift), prompt.run(dense, known, hold)])[: len(dense)]
    return y[np.round(time / step).astype(int)]


@delayed
@holds
@pytest.mark.parametrize("even", [True, False])
def test_any_input_on_any_clock(response, hold, even):
    rng = np.random.default_rng(4)
    time = 5.0 * np.arange(80) if even else np.cumsum(rng.integers(3, 90, 80)) / 10.0
    time, u = time - time[0], rng.standard_normal(80)
    u[0] = 0.0
    expected = fine(response, time, u, hold)
    np.testing.assert_allclose(simulate_response(response, time, u, hold), expected, atol=1e-10)


@delayed
@holds
def test_batch_is_stream(response, hold):
    u = np.random.default_rng(5).standard_normal((150, 1))
    u[0] = 0.0
    recursion = response.modes(5.0).discretize(5.0, hold)
    x = np.zeros(len(recursion.F))
    stream = [recursion.C @ x]
    for before, now in itertools.pairwise(u):
        x = recursion.F @ x + recursion.G0 @ before + recursion.G1 @ now
        stream.append(recursion.C @ x)
    batch = simulate_response(response, 5.0 * np.arange(150), u[:, 0], hold)
    np.testing.assert_allclose(np.array(stream)[:, 0], batch, atol=1e-11)
    np.testing.assert_allclose(
        recursion.C @ recursion.settled(np.ones(1)), [response.dc_gain()], rtol=1e-10
    )


def test_a_record_shorter_than_the_delay_stays_at_rest():
    response = Rational2(1.0, 10.0, 1.0, 20.0, 1e4)
    assert not np.any(simulate_response(response, np.arange(50.0), np.ones(50), "zero"))


@pytest.mark.parametrize("delay", [-1.0, float("nan"), float("inf")])
def test_a_bad_delay_is_named(delay):
    with pytest.raises(ModelError, match="delay"):
        Rational2(1.0, 10.0, 1.0, 20.0, delay)
    with pytest.raises(ModelError, match="delay"):
        DelayedModes(np.array([-1.0 + 0j]), np.ones(1, complex), delay=delay)


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_a_fit_takes_a_delay_as_given(hold):
    """On an irregular clock, with a delay that is no number of samples."""
    time = np.cumsum(np.random.default_rng(3).choice([3.0, 7.0, 11.0], 500))
    course = np.where(time // 500 % 2 == 1, 1.0, 0.0)
    u = course if hold == "zero" else np.convolve(course, np.ones(9) / 9, "same")
    drive = Drive("Q_main_1", hold, 0.0, (0.0, 1.0))
    prompt = Rational2(5.0, 90.0, -2.0, 400.0)
    # The response without the delay, on a clock that has the earlier moments too.
    fine = np.unique(np.concatenate([time, time[time > time[0] + 37.3] - 37.3]))
    row = np.searchsorted(time, fine, side="right") - 1
    between = u[row] if hold == "zero" else np.interp(fine, time, u)
    y = np.interp(time - 37.3, fine, simulate_response(prompt, fine, between, hold), left=0.0)
    record = Record(time, {"Q_main_1": u, "dT_a_K": y})
    found = fit_output([record], [drive], "dT_a_K", ["rational2"], {"delay": 37.3})
    assert found.rmse < 1e-5
    response = found.responses[0]
    assert response.delay == 37.3
    t = np.geomspace(1, 3000, 50)
    np.testing.assert_allclose(response.step(t + 37.3), prompt.step(t), atol=1e-3)


def test_the_file_keeps_a_delay_and_a_lag_behind_it():
    modes = RESPONSES[2].modes(1.0)
    assert isinstance(modes, DelayedModes)
    back = load_modes(modes.document())
    t = np.linspace(0, 300, 50)
    np.testing.assert_array_equal(back.step(t), modes.step(t))
    read = lagged_modes(modes, 8.0)
    s = np.array([0.02j, 0.3 + 0.1j])
    np.testing.assert_allclose(read.transfer(s), modes.transfer(s) / (1 + 8.0 * s), rtol=1e-9)
