"""The zero of a sensor that several logs have calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.lumped import Chain

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import agreements, dumps, loads
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_table

DRIVE, SENSOR = "Q_main_W", "T_motor_degC"
CHAIN = Chain((400.0, 900.0), (2.0, 1.5), diffusion=0.0, noise=0.03)
TIME = 10.0 * np.arange(900)
PLAN = CalibrationPlan((DRIVE,), (SENSOR,), kinds={SENSOR: "rational2"})


def log(seed, skipped=0, room=20.0, machine=CHAIN):
    """Heat at random from 300 s on; rows before `skipped` are not logged: it begins warm."""
    rng = np.random.default_rng(seed)
    time = 10.0 * np.arange(900 + skipped)
    heat = np.where(time < 300, 0.0, 40.0 * (rng.random(len(time) // 60 + 1) < 0.5).repeat(60)[
        : len(time)])  # fmt: skip
    readings = machine.run(time, heat, np.full(len(time), room), rng)
    table = {DRIVE: heat[skipped:], SENSOR: readings[skipped:]}
    name = f"{'warm' if skipped else 'cold'}{seed}.csv"
    return Record(TIME, table, name=name, digest=name)


@pytest.fixture(scope="module")
def pulled():
    records = [log(1), log(2, skipped=150)]
    return calibrate(records, PLAN), records


def test_a_log_that_begins_warm_does_not_pull(pulled):
    """From rest, as it is fitted, the warm log has a zero of its own, some kelvin off."""
    output = pulled[0].outputs[0]
    assert max(output.fit["offsets"]) > 21.0
    assert output.offset == pytest.approx(20.0, abs=0.05)


def test_how_far_the_zeros_differ_is_told(pulled):
    model, records = pulled
    shown = model.outputs[0].fit["zeros_shown"]
    (line,) = (each for each in calibration_table(model).splitlines()
               if each.startswith(SENSOR) and "cold1.csv" in each)  # fmt: skip
    assert f"{max(shown) - min(shown):.3g}" in line
    assert "cold1.csv (100 %)" in line
    # What is told of the fit is what `simulate` makes of these logs with that zero.
    found = agreements(model, records)[SENSOR]
    assert model.outputs[0].fit["rmse"] == pytest.approx(found.rmse)


def test_logs_at_rest_that_differ_share_the_zero():
    """One room is a kelvin warmer, and nobody logged it: as likely as the other."""
    model = calibrate([log(3), log(4, room=21.0)], PLAN)
    assert model.outputs[0].offset == pytest.approx(20.5, abs=0.1)
    assert model.outputs[0].fit["zero_weights"] == pytest.approx([0.5, 0.5], abs=0.05)


def test_a_single_log_keeps_its_own():
    model = calibrate([log(5)], replace(PLAN, starts=2))
    assert "zeros_shown" not in model.outputs[0].fit
    assert model.outputs[0].offset == model.outputs[0].fit["offsets"][0]


def test_logs_without_noise_share_their_zero():
    still = Chain(CHAIN.capacity, CHAIN.conductance, diffusion=0.0, noise=0.0)
    model = calibrate([log(6, machine=still), log(7, machine=still)], PLAN)
    assert model.outputs[0].offset == pytest.approx(20.0, abs=1e-3)


def test_a_log_without_the_sensor_has_no_say():
    silent = log(8)
    silent.columns[SENSOR][:] = np.nan
    model = calibrate([log(9), silent], PLAN)
    assert model.outputs[0].offset == pytest.approx(20.0, abs=0.05)
    assert model.outputs[0].fit["zero_weights"] == [1.0, 0.0]
    (line,) = (each for each in calibration_table(model).splitlines() if "cold9.csv" in each)
    assert " 0 " in line  # the one zero that there is
    assert loads(dumps(model)).outputs[0].offset == model.outputs[0].offset
