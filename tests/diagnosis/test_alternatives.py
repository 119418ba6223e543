from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.hidden import hide
from reference.measured import MAPS, whole_log

from thermaltool.diagnosis.alternatives import (
    LOG_AGAIN,
    MIN_ANGLE_OF_ANOTHER,
    indistinguishable,
    invisible,
    suspected,
)
from thermaltool.diagnosis.correction import corrected
from thermaltool.diagnosis.fit import CauseCandidate
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.information import InformationMatrix, angle, detectable, eliminated
from thermaltool.diagnosis.inputs import duration_text, levels_of, library
from thermaltool.diagnosis.limits import UNLIMITED
from thermaltool.diagnosis.select import fit_candidate
from thermaltool.diagnosis.state import RELEASED, WITHIN_CALIBRATION
from thermaltool.effects import effect_class
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.logs import read_log
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection

HEAT, NEAR, FAR, X, Y = "Q_main_1", "dT_near_K", "dT_far_K", "d_x_um", "d_y_um"
BEARING, PUMP, ROOM = "Q_bearing_1", "Q_pump_1", "T_ambient_degC"
PERIOD, ROWS = 5.0, 800
TIME = PERIOD * np.arange(ROWS)
GAIN = {NEAR: (20.0, 1 / 600), FAR: (9.0, 1 / 900), X: (-60.0, 1 / 500), Y: (80.0, 1 / 900)}
LEVELS = np.repeat([0.0, 1.0, 0.3, 0.8, 0.0, 0.5, 1.0, 0.0], ROWS // 8)


def machine(outputs, *effects):
    def first_order(gain, rate):
        return Deflection(gain, rate, 0.0, 1.0, 0.0, 1.0)

    return Model(
        drives=(Drive(HEAT, "zero", 0.0, (0.0, 1.0)),),
        outputs=tuple(
            Output(o, "deflection", "first" if o.startswith("d_") else 0.0, (-100.0, 100.0))
            for o in outputs
        ),
        terms=tuple(Term(HEAT, o, first_order(*GAIN[o])) for o in outputs),
        sample_period=PERIOD,
        effects=effects,
    )


def bench(outputs, truth=(), heat=LEVELS, noise=0.02, assumptions=RELEASED, seed=1, **beside):
    """The machine without `truth`, on a log of the machine with it."""
    columns = {HEAT: heat, **beside}
    simulated = machine(outputs, *truth).simulate(Record(TIME, columns, digest="log"))
    rng = np.random.default_rng(seed)
    for o in outputs:
        columns[o] = simulated[o] + noise * rng.standard_normal(ROWS)
    log = Record(TIME, columns, digest="log")
    return Hypothesis.of(machine(outputs), [log], machine(outputs), assumptions)


def cause(name, channel, log=None, **parameters):
    return effect_class(name)(channel, parameters, log)


def fitted(made, *effects):
    """Refined where they are, the best one first."""
    found = [fit_candidate(made, CauseCandidate.unfitted(e, made.assumptions)) for e in effects]
    return sorted(found, key=lambda c: -c.evidence)


def shown_size(made, effect):
    """From which the logs would show it."""
    return detectable(InformationMatrix(made, made.assumptions), effect)


def names(found):
    return sorted(zip(found.names, found.channels, strict=True))


# ---------------------------------------------------------------- linear algebra


def test_angles_of_known_vectors():
    rng = np.random.default_rng(0)
    others = rng.standard_normal((50, 3))
    inside, outside = others @ [1.0, -2.0, 0.5], rng.standard_normal(50)
    outside -= others @ np.linalg.lstsq(others, outside, rcond=None)[0]
    outside *= np.linalg.norm(inside) / np.linalg.norm(outside)
    for share in (0.0, 0.3, 1.0):
        vector = np.sqrt(1 - share) * inside + np.sqrt(share) * outside
        columns = np.column_stack([vector, others])
        expected = np.degrees(np.arcsin(np.sqrt(share)))
        assert angle(columns.T @ columns) == pytest.approx(expected, abs=1e-4)


def test_what_is_eliminated_twice_or_not_there_changes_nothing():
    columns = np.random.default_rng(1).standard_normal((40, 4))
    repeated = np.column_stack([columns, columns[:, 3], np.zeros(40)])
    plain, again = (eliminated(c.T @ c, 2) for c in (columns, repeated))
    np.testing.assert_allclose(again, plain, rtol=1e-9)


# ---------------------------------------------------------------- what else it could be


def test_suspects_are_told_the_likeliest_first_with_what_would_tell():
    truth = cause("transport_delay", HEAT, delay=4.0)
    one = bench([NEAR], [truth], noise=0.05)
    found = fitted(one, truth, cause("sensor_lag", NEAR, time_constant=4.0))
    (several,) = suspected(one, [*found, found[0]])
    assert several.kind == "suspected"
    assert several.names == tuple(c.effect.name for c in found)
    assert several.separating_experiment
    (alone,) = suspected(one, found[:1])
    assert alone.names == (found[0].effect.name,)
    assert alone.separating_experiment == LOG_AGAIN
    assert suspected(one, []) == []


def test_a_delay_and_a_lag_of_the_only_sensor():
    truth = cause("transport_delay", HEAT, delay=12.0)
    lag = cause("sensor_lag", NEAR, time_constant=12.0)
    one = bench([NEAR], [truth], noise=0.05)
    first, second = fitted(one, truth, lag)
    (found,) = indistinguishable(one, first, [first, second])
    assert names(found) == [("sensor_lag", NEAR), ("transport_delay", HEAT)]
    assert found.names[0] == first.effect.name
    assert found.angle < MIN_ANGLE_OF_ANOTHER
    assert found.opened > found.angle
    # Either a drive fast against both, or another look at the same temperature.
    assert "switch Q_main_1" in found.separating_experiment or (
        f"second sensor beside {NEAR}" in found.separating_experiment
    )


def test_a_second_output_tells_a_delay_from_a_lag():
    truth = cause("transport_delay", HEAT, delay=12.0)
    lag = cause("sensor_lag", NEAR, time_constant=12.0)
    two = bench([NEAR, Y], [truth], noise=0.05)
    found = fitted(two, truth, lag)
    assert found[0].effect.name == "transport_delay"
    assert indistinguishable(two, found[0], found) == []


def test_a_jump_of_the_only_displacement():
    step = cause("geometry_step", X, "log", **{f"step[{X}]": 3.0, "time": 1500.0})
    offset = cause("sensor_offset_step", X, "log", step=3.0, time=1500.0)
    one = bench([NEAR, X], [step])
    first, second = fitted(one, step, offset)
    (found,) = indistinguishable(one, first, [first, second])
    assert names(found) == [("geometry_step", X), ("sensor_offset_step", X)]
    assert found.angle == pytest.approx(0.0, abs=0.1)
    # No input brings a collision back.
    assert f"second sensor beside {X}" in found.separating_experiment
    assert found.opened > 80


def test_a_room_that_stands_still_in_an_experiment_is_still_a_rival():
    # Its lag moves nothing there, and neither does its gain.
    room = 20.0 + np.where(TIME < 1500.0, 0.0, 1.0)
    step = cause("geometry_step", X, "log", **{f"step[{X}]": 3.0, "time": 1500.0})
    drift = cause("ambient_drift", ROOM, **{f"gain[{X}]": 3.0, "time_constant": 30.0})
    one = bench([NEAR, X], [step], **{ROOM: room})
    first, second = fitted(one, step, drift)
    (found,) = indistinguishable(one, first, [first, second])
    assert ("ambient_drift", ROOM) in names(found)
    assert found.separating_experiment


def test_two_displacements_that_jump_are_no_sensor():
    step = cause("geometry_step", X, "log", **{f"step[{X}]": 3.0, f"step[{Y}]": -2, "time": 1500.0})
    offset = cause("sensor_offset_step", X, "log", step=3.0, time=1500.0)
    two = bench([X, Y], [step])
    found = fitted(two, step, offset)
    assert found[0].effect.name == "geometry_step"
    assert indistinguishable(two, found[0], found) == []


def test_what_happened_once_cannot_be_asked_for():
    jumps = {f"step[{X}]": 3.0, f"step[{Y}]": -2.0}
    step = cause("geometry_step", X, "log", **jumps, time=1500.0)
    gains = {f"gain[{X}]": 3.0, f"gain[{Y}]": -2.0}
    source = cause("second_source", "", "log", **gains, time_constant=1.0, start=1495.0)
    made = bench([X, Y], [step])
    first, second = fitted(made, step, source)
    (found,) = indistinguishable(made, first, [first, second])
    assert names(found) == [("geometry_step", X), ("second_source", "")]
    assert "log what else switches" in found.separating_experiment
    assert np.isnan(found.opened)


def together(channel):
    return cause("second_source", channel, time_constant=400.0, **{f"gain[{NEAR}]": 4.0})


def test_two_sources_that_switch_together():
    switched = ((TIME // 700) % 2).astype(float)
    beside = {BEARING: switched, PUMP: switched.copy()}
    both = bench([NEAR], [together(BEARING)], **beside)
    first, second = fitted(both, together(BEARING), together(PUMP))
    (found,) = indistinguishable(both, first, [first, second])
    assert names(found) == [("second_source", BEARING), ("second_source", PUMP)]
    assert found.angle < 1
    assert found.separating_experiment.startswith("switch Q_")
    assert f"with {HEAT} at 0" in found.separating_experiment
    assert found.opened > 60


def test_two_sources_that_switch_apart():
    beside = {BEARING: ((TIME // 700) % 2), PUMP: ((TIME // 450) % 2)}
    both = bench([NEAR], [together(BEARING)], **beside)
    found = fitted(both, together(BEARING), together(PUMP))
    assert found[0].effect.channel == BEARING
    assert indistinguishable(both, found[0], found) == []


def test_another_part_of_the_residual_is_no_other_name():
    # Two causes that act at once: neither is decisive before the other, but they are not alike.
    two = [cause("sensor_drift", NEAR, rate=0.3), cause("sensor_gain", FAR, gain=1.05)]
    made = bench([NEAR, FAR], two, assumptions=WITHIN_CALIBRATION)
    found = fitted(made, *two)
    close = [replace(c, evidence=100.0, gain=50.0) for c in found]
    assert indistinguishable(made, close[0], close, two) == []
    # The second is not named beside the first: it is what else may have done it.
    (group,) = indistinguishable(made, close[0], close, two[:1])
    assert group.names == ("sensor_drift", "sensor_gain")


# ---------------------------------------------------------------- what cannot be seen


def invisible_at(made):
    return {(n, a.channels[0]): a for a in invisible(made) for n in a.names}


def test_two_levels_do_not_show_an_exponent_and_three_do():
    two = invisible_at(bench([NEAR], heat=np.where(LEVELS > 0, 0.8, 0.0)))
    entry = two["drive_nonlinearity", HEAT]
    assert entry.angle < 0.5
    assert entry.opened > 5
    assert "level" in entry.separating_experiment
    three = invisible_at(bench([NEAR], heat=np.where(LEVELS > 0.6, 0.8, np.minimum(LEVELS, 0.4))))
    assert ("drive_nonlinearity", HEAT) not in three


def test_a_log_that_begins_warm_takes_one_level_from_what_it_shows():
    def warm(*levels):
        heat = np.repeat(levels, ROWS // len(levels))
        made = bench([NEAR], heat=heat)
        measured = made.logs[0].columns[NEAR] + 15 * np.exp(-TIME / 600)
        log = Record(TIME, {HEAT: heat, NEAR: measured}, digest="log")
        return Hypothesis.of(machine([NEAR]), [log], machine([NEAR]), RELEASED)

    assert ("drive_nonlinearity", HEAT) in invisible_at(warm(0.9, 0.4))
    assert ("drive_nonlinearity", HEAT) not in invisible_at(warm(0.9, 0.4, 0.6, 0.2))
    # The same two levels from rest are three.
    assert ("drive_nonlinearity", HEAT) not in invisible_at(bench([NEAR], heat=np.r_[
        np.zeros(50), np.full(350, 0.9), np.full(400, 0.4)]))  # fmt: skip


def test_a_source_that_switches_with_the_drive():
    heat = np.where(LEVELS > 0, 1.0, 0.0)
    made = bench([NEAR], heat=heat, **{BEARING: heat.copy(), PUMP: (TIME // 700) % 2})
    shown = invisible_at(made)
    # Its lag is not the drive's, but this one is.
    same = cause("second_source", BEARING, time_constant=600.0, **{f"gain[{NEAR}]": 1.0})
    assert shown_size(made, same) is None
    apart = cause("second_source", PUMP, time_constant=600.0, **{f"gain[{NEAR}]": 1.0})
    assert shown_size(made, apart).left > 0.3
    assert ("second_source", PUMP) not in shown


@pytest.mark.slow
def test_what_is_detectable_is_detected():
    """The predicted change reaches the evidence that it was computed for."""
    step = cause("sensor_offset_step", X, "log", step=1.0, time=1500.0)
    clean = bench([NEAR, X], noise=0.1)
    found = shown_size(clean, step)
    assert found.output == X
    size = found.change / np.std(clean.simulation.displacement(step)[X][0])
    evidence = []
    for seed in range(12):
        changed = bench([NEAR, X], [step.changed({"step": size})], noise=0.1, seed=100 + seed)
        evidence.append(fitted(changed, step)[0].evidence)
    assert np.mean(evidence) == pytest.approx(10.0, abs=6.0)


def test_more_noise_hides_more():
    gain = cause("sensor_drift", X, rate=1.0)
    quiet, loud = (shown_size(bench([X], noise=n), gain).change for n in (0.05, 0.2))
    assert loud == pytest.approx(4 * quiet, rel=0.4)


def test_the_models_own_gain_hides_a_sensors():
    gain = cause("sensor_gain", X, gain=2.0)
    assert shown_size(bench([X]), gain) is None
    assert not [n for n, _ in invisible_at(bench([X])) if n == "sensor_gain"]


# ---------------------------------------------------------------- experiments


def test_experiments_stay_inside_what_the_machine_has_seen():
    made = bench([NEAR], heat=0.7 * LEVELS)
    for each in library(made, [cause("transport_delay", HEAT, delay=10.0)], UNLIMITED):
        heat = each.record.columns[HEAT]
        assert heat[0] == 0
        assert heat.min() >= 0
        assert heat.max() <= 1
        assert len(each.record.time) <= 5010
        assert HEAT in each.sentence


def test_the_third_level_is_a_new_one():
    made = bench([NEAR], heat=np.where(LEVELS > 0, 0.8, 0.0))
    found = levels_of(made, HEAT)
    assert (found.start, found.low, found.high) == (0.0, 0.0, 1.0)
    assert 0.2 < found.third < 0.7


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(7.0, "7 s"), (150.0, "150 s"), (2400.0, "40 min"), (14500.0, "4 h"), (0.4, "0.4 s")],
)
def test_times_are_told_as_they_are_set(seconds, text):
    assert duration_text(seconds) == text


# ---------------------------------------------------------------- other people's machines


@pytest.mark.slow
def test_a_hidden_delay():
    """A machine that shares no code with the models; five outputs tell a delay from a lag."""
    log = hide(["transport_delay"], 5.0, 11, 12)
    outputs = (NEAR, FAR, "T_column_degC"), (X, Y)
    calibration = {k: v for k, v in log.calibration.items() if k != "time_s"}
    model = calibrate(
        [Record(log.calibration["time_s"], calibration)], CalibrationPlan((HEAT,), *outputs)
    )
    known = corrected(model)
    signals = Record(
        log.log["time_s"], {k: v for k, v in log.log.items() if k != "time_s"}, digest="log"
    )
    made = Hypothesis.of(known, [signals], known, WITHIN_CALIBRATION)
    found = fitted(
        made,
        cause("transport_delay", HEAT, delay=5.0),
        *(cause("sensor_lag", o, time_constant=5.0) for o in (NEAR, X)),
    )
    assert found[0].effect.name == "transport_delay"
    assert indistinguishable(made, found[0], found) == []
    seen = shown_size(made, found[0].effect)
    assert log.hidden[0].size == pytest.approx(5.0, rel=0.01)
    assert seen.change / log.noise[seen.output] < 5.0


@pytest.mark.slow
def test_the_first_half_of_the_heating_system():
    """Issue: 4 V and 9 V cannot identify the lamp's exponent; a third level of the lamp can."""
    log = read_log(
        str(whole_log("daisy/heating_system.csv")), columns=str(MAPS / "heating_system.toml")
    )

    def halved(end):
        rows = log.time <= end
        columns = {name: values[rows] for name, values in log.columns.items()}
        plan = CalibrationPlan(("U_lamp_V",), ("T_plate_degC",), ())
        model = calibrate([Record(log.time[rows], columns)], plan)
        half = Record(log.time[rows], columns, digest="log")
        return invisible_at(Hypothesis.of(model, [half], model, RELEASED))

    entry = halved(800.0)["drive_nonlinearity", "U_lamp_V"]
    assert "third level" in entry.separating_experiment
    assert "U_lamp_V" in entry.separating_experiment
    assert entry.angle < 0.1
    assert entry.opened > 10
    assert ("drive_nonlinearity", "U_lamp_V") not in halved(2000.0)
