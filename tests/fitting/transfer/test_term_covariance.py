"""Intervals of a term in continuous time: those of the discrete model, by another way."""

from __future__ import annotations

import numpy as np
import pytest

import thermaltool as tt
from thermaltool.model import characteristics


def log(oscillating: bool = False) -> dict[str, np.ndarray]:
    """An output of two lags, or of a damped pair, stepped through by hand; white noise on it."""
    rng = np.random.default_rng()
    time, states = 10.0 * np.arange(900), np.zeros(2)
    heat = np.repeat(rng.uniform(0, 100, 45), 20)
    a, b = (np.exp(-10.0 / 80.0), np.exp(-10.0 / 600.0))
    if oscillating:
        s = 0.02 * (-0.3 + 1j * np.sqrt(1 - 0.09))
        turn = np.exp(10.0 * s)
    y = np.empty(900)
    pair = 0j
    for k in range(900):
        if oscillating:
            y[k] = 2 * pair.real
            pair = turn * pair + heat[k] * (turn - 1) * (-0.05j)
        else:
            y[k] = 0.1 * states[0] + 0.3 * states[1]
            states = np.array([a, b]) * states + (1 - np.array([a, b])) * heat[k]
    return {"time_s": time, "Q_main_W": heat, "d_z_um": y + 0.05 * rng.standard_normal(900)}


@pytest.mark.parametrize("continuous", [False, True])
def test_intervals_are_those_of_the_discrete_model(continuous: bool) -> None:
    import pandas as pd

    found = tt.identify(pd.DataFrame(log()), ["Q_main_W"], ["d_z_um"], structure="oe",
                        orders=[(2, 2, 1)], continuous=continuous)  # fmt: skip
    (fit,) = found.fits
    each = characteristics(found.model.terms[0])
    gain = fit.model.gain(0)
    assert (each.gain.low, each.gain.high) == pytest.approx((gain.low, gain.high), rel=1e-3)
    for own, of_pole in zip(each.time_constants, fit.model.time_constants(0), strict=True):
        assert own.low == pytest.approx(of_pole.low, rel=2e-3)
        assert own.high == pytest.approx(of_pole.high, rel=2e-3)


def test_a_damped_pair_has_intervals() -> None:
    import pandas as pd

    found = tt.identify(pd.DataFrame(log(True)), ["Q_main_W"], ["d_z_um"], structure="oe",
                        orders=[(2, 2, 1)])  # fmt: skip
    (mode,) = characteristics(found.model.terms[0]).oscillations
    assert mode.period.low < mode.period.value < mode.period.high
    assert mode.period.value == pytest.approx(2 * np.pi / 0.02, rel=0.02)
    assert mode.damping.value == pytest.approx(0.3, abs=0.02)
