"""Commands that switch between the rows of a log, on a plant that is computed at every instant."""

from __future__ import annotations

import numpy as np
import pytest

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import characteristics
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_warnings

HEAT, OUTPUT = "Q_main_W", "dT_a_K"
LAGS = ((0.06, 90.0), (0.1, 1100.0))  # gain [K/W], time constant [s]


def log_of(seed, between, digest):
    """Two lags under steps at instants of their own or of the rows, on a clock that jitters."""
    generator = np.random.default_rng(seed)
    time = 15.0 * np.arange(1200) + generator.uniform(0, 5.0, 1200)
    at = np.sort(generator.uniform(200.0, time[-1], 40))
    if not between:
        at = time[np.unique(np.searchsorted(time, at))]
    level = generator.choice([0.0, 50.0, 100.0], len(at))
    change = np.diff(level, prepend=0.0)
    since = time[:, None] - at
    on = np.where(since >= 0, since, np.nan)
    y = sum(np.nansum(change * gain * -np.expm1(-on / tau), axis=1) for gain, tau in LAGS)
    noise = 0.01 * generator.standard_normal(len(time))
    return Record(time, {HEAT: np.nansum(change * (on >= 0), axis=1), OUTPUT: y + noise},
                  digest=digest)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("between", "hold"), [pytest.param(True, "first", marks=pytest.mark.slow), (False, "zero")]
)
def test_commands_between_rows_go_along_lines(between, hold):
    logs = [log_of(20261122 + k, between, f"log {k}") for k in range(3)]
    model = calibrate(logs[:2], CalibrationPlan((HEAT,), (OUTPUT,), choose=True))
    assert model.drives[0].hold == hold
    assert any("switches between" in each for each in calibration_warnings(model)) is between
    unseen = logs[2]
    error = unseen.columns[OUTPUT] - model.simulate(unseen)[OUTPUT]
    held = CalibrationPlan((HEAT,), (OUTPUT,), hold="zero", choose=True)
    usual = unseen.columns[OUTPUT] - calibrate(logs[:2], held).simulate(unseen)[OUTPUT]
    assert np.std(error) <= (0.8 if between else 1.001) * np.std(usual)


@pytest.mark.slow
def test_what_is_told_to_be_held_is_held():
    plan = CalibrationPlan((HEAT,), (OUTPUT,), hold="zero", choose=True)
    assert calibrate([log_of(1, True, "one")], plan).drives[0].hold == "zero"


TWO_LAGS = CalibrationPlan(
    (HEAT,), (OUTPUT,), kinds={OUTPUT: "rational2"}, choose=True, linear=True
)


def test_the_instants_are_a_part_of_the_fit():
    model = calibrate([log_of(20261125, True, "log")], TWO_LAGS)
    found = characteristics(model.terms[0]).time_constants
    for each, (_, tau) in zip(sorted(found, key=lambda each: each.value), LAGS, strict=True):
        # Twice the interval, which one log in twenty leaves.
        assert abs(each.value - tau) < each.high - each.low < 0.1 * tau
    own = model.outputs[0].fit["instants"]
    # The noise of a reading is 0.01 K.
    assert own["rmse"] < 0.012 < own["rmse_without"]
    assert any("instants of" in each for each in calibration_warnings(model))


def test_commands_on_the_rows_have_no_instants():
    assert "instants" not in calibrate([log_of(20261125, False, "log")], TWO_LAGS).outputs[0].fit
