"""Lags that fall together: as near as their gains do not cancel without end."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.record import Record
from thermaltool.responses.parameters import MIN_RATIO
from thermaltool.signals.intervals import standard_error

HEAT, NEAR = "P_heater_W", "T_near_degC"
TIME = 2.0 * np.arange(1200)
TAU, GAIN, SIGMA = 120.0, 0.4, 0.005


def chain() -> Record:
    """Three equal lags behind each other, heated in steps, by their exact step response."""
    generator = np.random.default_rng(11)
    heat = np.repeat(generator.choice([0.0, 30.0, 60.0], 12), 100)
    past = np.maximum(TIME[:, None] - TIME[None, ::100], 0.0) / TAU
    step = 1 - np.exp(-past) * (1 + past + past**2 / 2)
    rise = GAIN * step @ np.diff(heat[::100], prepend=0.0)
    read = 20.0 + rise + SIGMA * generator.standard_normal(len(TIME))
    return Record(TIME, {HEAT: heat, NEAR: read}, name="chain.csv", digest="chain")


@pytest.mark.slow
def test_a_chain_of_equal_lags_has_lags_apart_that_are_as_good() -> None:
    model = calibrate([chain()], CalibrationPlan((HEAT,), (NEAR,), kinds={NEAR: "rational3"}))
    (term,) = model.terms
    values = np.array([getattr(term.response, f"tau{k}") for k in (1, 2, 3)])
    ratios = [slow / fast for fast, slow in pairwise(sorted(values))]
    assert min(ratios) > MIN_RATIO - 0.01
    assert np.exp(np.mean(np.log(values))) == pytest.approx(TAU, rel=0.02)
    assert model.outputs[0].fit["rmse"] < 1.05 * SIGMA
    # The steady gain is as sure as the data are, whatever the gains of the lags.
    gains = [0.0] * 3 + [1.0] * 3
    assert standard_error(np.array(gains), term.covariance) < 0.002
    assert term.response.dc_gain() == pytest.approx(GAIN, rel=0.005)
