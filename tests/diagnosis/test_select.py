"""Which candidates of a scan are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.select import Ranking
from thermaltool.diagnosis.shortlist import plain_forms_first, shortlist
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.rational import Rational1

PRESENT, FREED = frozenset({"tight"}), frozenset({"released"})


def candidate(name, evidence, assumptions, channel="dT_a_K"):
    cls = effect_class(name)
    effect = cls(channel, dict.fromkeys(cls.known, 1.0))
    return CauseCandidate(effect, evidence, 0.0, assumptions, {})


def test_a_cause_that_needs_no_change_of_the_model_is_fitted():
    names = ["sensor_gain", "sensor_drift", "sensor_offset_step", "sensor_conversion"]
    names += ["sensor_self_heating", "radiation", "joint_contact", "backlash", "hysteresis"]
    free = [candidate(name, 680.0 - k, FREED) for k, name in enumerate(names)]
    lag = candidate("sensor_lag", 650.0, PRESENT)
    found = shortlist([*free, lag], {PRESENT: 0.0, FREED: 616.0})
    assert found[0] is lag
    assert len(found) == 8
    assert all(each in found for each in free[:5])


def test_a_trial_that_is_there_twice_takes_one_place():
    names = ["sensor_gain", "sensor_drift", "sensor_offset_step", "sensor_conversion"]
    names += ["sensor_self_heating", "radiation", "joint_contact", "backlash", "hysteresis"]
    free = [candidate(name, 680.0 - k, FREED) for k, name in enumerate(names)]
    twins = [candidate(name, 100.0 - k, PRESENT) for k, name in enumerate(names)]
    found = shortlist([*free, *twins], {PRESENT: 0.0, FREED: 616.0})
    assert found == [*twins[:3], *free[3:8]]


def test_few_of_one_name_and_none_without_evidence():
    gains = [candidate("sensor_gain", 100.0 - k, PRESENT, f"dT_{k}_K") for k in range(4)]
    found = shortlist([*gains, candidate("sensor_lag", -11.0, PRESENT)], {PRESENT: 0.0})
    assert [each.effect.channel for each in found] == ["dT_0_K", "dT_1_K"]


def in_form(evidence, channel, *names):
    effect = effect_class("second_source")(channel, dict.fromkeys(names, 1.0))
    return CauseCandidate(effect, evidence, 0.0, PRESENT, {})


ONE_LAG = ("gain[dT_a_K]", "time_constant")
TWO_LAGS = (*ONE_LAG, "slow_gain[dT_a_K]", "slow_time_constant")


def test_forms_of_one_place_leave_room_for_another_place():
    other = in_form(90.0, "x_fan_1", *ONE_LAG)
    forms = [in_form(100.0, "x_pump_1", *TWO_LAGS), in_form(99.0, "x_pump_1", *ONE_LAG)]
    assert shortlist([*forms, other], {PRESENT: 0.0}) == [*forms, other]


def test_of_forms_that_a_log_hardly_tells_apart_the_plain_one_comes_first():
    many, few = in_form(100.0, "x_pump_1", *TWO_LAGS), in_form(95.0, "x_pump_1", *ONE_LAG)
    assert plain_forms_first([many, few]) == [few, many]
    clear = in_form(120.0, "x_pump_1", *TWO_LAGS)
    assert plain_forms_first([clear, few]) == [clear, few]


def test_a_start_sets_nothing_else_free():
    started = PRESENT | {"initial"}
    alone = {PRESENT: 0.0, started: 357.0, FREED: 500.0}
    assert Ranking([], [], 0.0, alone).own_start(PRESENT) == started
    # Beside one that is there already the model's own parameters stay with their calibration.
    alone = {started: 0.0, FREED | {"initial"}: 300.0}
    assert Ranking([], [], 0.0, alone).own_start(started) is None
    assert Ranking([], [], 0.0, {PRESENT: 0.0, started: 4.0}).own_start(PRESENT) is None


def test_a_cause_beside_a_plainer_start_comes_before_any_start():
    modes, any_start = (PRESENT | {way} for way in ("modes", "initial"))
    alone = {PRESENT: 0.0, modes: 90.0, any_start: 100.0}

    def better(evidence, assumptions):
        cause = replace(in_form(evidence, "x_pump_1", *ONE_LAG), assumptions=assumptions)
        return Ranking([], [cause], 0.0, alone | {FREED: 95.0}).better_assumptions()

    assert better(115.0, modes) is None
    assert better(105.0, modes) == any_start
    # Beside a model that is free, or a start that is less plain, every cause looks strong.
    assert better(115.0, FREED) == any_start
    assert better(115.0, any_start) == any_start
    assert better(115.0, PRESENT) is None


# ---------------------------------------------------------------- a thermostat's fan

HEAT, GAINS, LAGS = "Q_main_W", np.array([0.4, 0.3]), np.array([600.0, 1500.0])
SENSORS = ("T_a_degC", "T_b_degC")


def known_model():
    """Two masses that a calibration knows to a part in a thousand."""
    terms = [
        Term(HEAT, name, Rational1(K1=k, tau1=tau), np.diag([tau, k]) ** 2 * 1e-6, ("tau1", "K1"))
        for name, k, tau in zip(SENSORS, GAINS.tolist(), LAGS.tolist(), strict=True)
    ]
    outputs = [Output(name, "sensor", 20.0, (0.0, 40.0), {}) for name in SENSORS]
    return Model((Drive(HEAT, "zero", 0.0, (0.0, 100.0)),), tuple(outputs), tuple(terms), 10.0)


def fan_log(seed, rate, on=40.0, off=36.0, rows=1500):
    """The same by steps of a second, with a fan that comes on and goes off by T_a."""
    generator = np.random.default_rng([20261123, seed])
    heat = np.repeat(generator.choice([0.0, 40.0, 70.0, 100.0], rows // 50), 50)
    heat[:50] = 0.0
    rise, blows, read = np.zeros(2), False, []
    for u in heat:
        read.append(20.0 + rise + 0.02 * generator.standard_normal(2))
        for _ in range(10):
            blows = 20.0 + rise[0] > (off if blows else on)
            rise = rise + (GAINS * u - rise) / LAGS - rate * blows * rise
    columns = {HEAT: heat, **dict(zip(SENSORS, np.array(read).T, strict=True))}
    return Record(10.0 * np.arange(rows), columns, digest=f"fan {seed}")


@pytest.mark.slow
def test_a_fan_is_told_with_the_temperatures_that_switch_it():
    found = diagnose(known_model(), [fan_log(1, 8e-5)], [fan_log(2, 8e-5)])
    assert [(c.effect.name, c.effect.channel) for c in found.causes] == [
        ("switching_loss", "T_a_degC")
    ]
    told = found.causes[0].effect.parameters
    assert told["rate"] == pytest.approx(8e-5, rel=0.05)
    assert (told["on"], told["off"]) == pytest.approx((40.0, 36.0), abs=0.5)


def heated(seed, sensor=0.0):
    """A bed under a random duty, 21 degC of it around; its sensor answers so much later [s]."""
    generator = np.random.default_rng(seed)
    power = 100.0 * np.repeat(generator.integers(0, 2, 50), 30)
    power[:30] = 0.0
    seconds = np.repeat(power, 60)
    bed = sum(
        gain * lfilter([0.0, 1 - decay], [1.0, -decay], seconds)
        for gain, decay in zip(
            (0.2, 0.07, -0.03), np.exp(-1 / np.array([2400.0, 470.0, 150.0])), strict=True
        )
    )
    decay = np.exp(-1 / sensor) if sensor else 0.0
    read = 21.0 + lfilter([1 - decay], [1.0, -decay], bed)[::60]
    read += 0.03 * generator.standard_normal(1500)
    columns = {"Q_bed_W": power, "T_bed_degC": read}
    return Record(60.0 * np.arange(1500), columns, digest=f"{seed}")


@pytest.mark.slow
def test_a_cause_between_two_trials_comes_before_a_changed_machine():
    """Free parameters of the model explain more than the nearest trial, and less than a fit."""
    kinds = {"T_bed_degC": "rational3"}
    model = calibrate([heated(1)], CalibrationPlan(("Q_bed_W",), ["T_bed_degC"], [], kinds))
    (cause,) = diagnose(model, [heated(2, 430.0)]).causes
    assert cause.effect.name == "sensor_lag"
    assert cause.effect.parameters["time_constant"] == pytest.approx(430.0, rel=0.01)
