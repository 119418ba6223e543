"""How fast readings may change that no step response bounds: as the calibration saw it."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import thermaltool as tt
from thermaltool.effects import load_effect
from thermaltool.estimation.estimator import SensorNoise
from thermaltool.estimation.plausible_change import CHANGE_MARGIN, plausible_changes, reach_of
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational1
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings

PERIOD = 10.0


def machine(seed):
    """A temperature that drives a displacement: two lags by Euler's rule, and noise."""
    rng = np.random.default_rng(seed)
    duty = np.repeat(rng.uniform(0, 1, 40), 50)
    warm, bend = np.zeros(2000), np.zeros(2000)
    for k in range(1, 2000):
        warm[k] = warm[k - 1] + PERIOD / 900 * (20 * duty[k] - warm[k - 1])
        bend[k] = bend[k - 1] + PERIOD / 2500 * (3 * warm[k] - bend[k - 1])
    return pd.DataFrame({
        "time_s": PERIOD * np.arange(2000),
        "T_motor_degC": 22 + warm + rng.normal(0, 0.05, 2000),
        "d_z_um": bend + rng.normal(0, 0.3, 2000),
    })  # fmt: skip


@pytest.mark.parametrize("fit", ["calibrate", "identify"])
def test_a_fit_keeps_how_fast_a_temperature_has_changed(fit):
    log = machine(1)
    if fit == "calibrate":
        kinds = {"d_z_um": "rational1"}
        model = tt.calibrate(log, ["T_motor_degC"], deflections=["d_z_um"], kinds=kinds).model
    else:
        model = tt.identify(log, ["T_motor_degC"], ["d_z_um"], orders=[(1, 1, 1)]).model
    kept = model.drives[0].changes
    warm = log["T_motor_degC"].to_numpy()
    assert len(kept) == 11
    assert kept[0] == pytest.approx(np.abs(np.diff(warm)).max(), rel=1e-9)
    # Over 1024 of 2000 samples.
    assert 0.5 * np.ptp(warm) < kept[-1] <= np.ptp(warm)
    assert len(model.outputs[0].changes) == 11


def model(effects=()):
    drive = Drive("T_a_degC", "first", "first", (0.0, 20.0), None, (0.1, 0.2, 0.4))
    output = Output("T_b_degC", "sensor", 20.0, (0.0, 20.0), {}, (0.3, 0.6))
    terms = (Term("T_a_degC", "T_b_degC", Rational1(1.0, 100.0)),)
    return Model((drive,), (output,), terms, PERIOD, effects=effects)


def test_a_temperature_that_drives_may_change_as_it_has():
    reach = reach_of({"plausible_change": plausible_changes(model(), {}, (), 5.0)}, "T_a_degC")
    allowed = [reach(seconds) for seconds in (1.0, 10.0, 11.0, 40.0, 1e9)]
    assert allowed == pytest.approx([CHANGE_MARGIN * c for c in (0.1, 0.1, 0.2, 0.4, 0.4)])


def test_effects_leave_what_the_logs_have_shown():
    noise = (SensorNoise(0.01),)
    effect = load_effect(
        {"name": "sensor_lag", "channel": "T_b_degC", "parameters": {"time_constant": 30.0}}
    )
    design = plausible_changes(model((effect,)), {"T_b_degC": "T_b_degC"}, noise, PERIOD)
    reach = reach_of({"plausible_change": design}, "T_b_degC")
    assert reach(PERIOD) == pytest.approx(CHANGE_MARGIN * 0.3 + 10 * 0.01)


def test_what_no_log_has_shown_has_no_bound():
    plain = model()
    bare = replace(plain, drives=(replace(plain.drives[0], changes=()),))
    design = plausible_changes(bare, {}, (), PERIOD)
    assert reach_of({"plausible_change": design}, "T_a_degC")(1.0) == math.inf


def test_a_temperature_that_never_moved_has_no_bound():
    still = replace(model().drives[0], changes=(0.0, 0.0))
    design = plausible_changes(replace(model(), drives=(still,)), {}, (), PERIOD)
    assert reach_of({"plausible_change": design}, "T_a_degC")(1.0) == math.inf


@pytest.mark.slow
def test_a_temperature_that_jumps_moves_no_set_point():
    """From the logs to the stream, with the options that nobody gives."""
    found = tt.calibrate(machine(2), ["T_motor_degC"], deflections=["d_z_um"])
    design = tt.regularize(found.model, measured=["T_motor_degC"]).model
    process = offsets(design, Settings(), Messages([].append))
    clean = offsets(design, Settings(), Messages([].append))
    log = machine(3)
    worst = 0.0
    for k, (time, reading) in enumerate(zip(log["time_s"], log["T_motor_degC"], strict=True)):
        clean.take(Row(time, [reading], ("",)))
        process.take(Row(time, [reading + 6.0 * (k in (700, 701))], ("",)))
        assert clean.status == "ok"
        assert (process.status == "held") == (k in (700, 701))
        worst = max(worst, abs(process.values()[0] - clean.values()[0]))
    # A reading that is held for two samples of 10 s, where lag and gain are 2500 s and 3 um/K.
    assert worst <= 0.5
