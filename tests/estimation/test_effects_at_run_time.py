"""A model's effects in estimate and stream: readings put right, sources, losses, refusals."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from effects.machine import (
    AIR,
    BEARING,
    COLUMN,
    COOLANT,
    FAR,
    HEAT,
    NEAR,
    PART,
    PERIOD,
    ROWS,
    X,
    Y,
    columns,
    model,
)

from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.design_model import DesignModel
from thermaltool.estimation.estimator import SensorNoise
from thermaltool.estimation.known_inputs import Feedforward
from thermaltool.estimation.pipeline import EstimatorPipeline
from thermaltool.estimation.regularization import design_kalman, design_kernel
from thermaltool.estimation.variable_cooling import VariableCoolingEstimator
from thermaltool.model import dumps, loads, only_sensors
from thermaltool.record import Record
from thermaltool.responses import response_class
from thermaltool.responses.sample_clock import CLOCK_STEP
from thermaltool.runtime.compensation import offsets
from thermaltool.runtime.messages import Messages
from thermaltool.runtime.rows.row import Row
from thermaltool.runtime.settings import Settings

NOISE = dict.fromkeys((COLUMN, NEAR, FAR), SensorNoise(0.02, 0.01, 600.0))
WARM = {"gain[{}]": 1.0}
KERNEL = {"A": 3e-3, "B": 1.5e-3, "c": 0.045, "cutoff_Hz": 0.05, "delay_s": 6.0}
LATE_KERNEL = {"A": 1e-3, "B": 1e-3, "c": 0.1, "cutoff_Hz": 0.05, "delay_s": 2.0}


def effect(name, channel, log=None, partner=None, **parameters):
    named = {k.replace("__", "[") + ("]" if "__" in k else ""): v for k, v in parameters.items()}
    return effect_class(name)(channel, named, log, partner=partner)


# Each with parameters in the unit of its channels; all stand in every log.
GAIN = effect("sensor_gain", NEAR, gain=0.8)
CONVERSION = effect("sensor_conversion", NEAR, gain=1.1, curvature=0.004)
SWAPPED = effect("sensors_swapped", NEAR, partner=FAR)
LAG = effect("sensor_lag", NEAR, time_constant=120.0)
BEARING_HEAT = effect(
    "second_source", BEARING, gain__dT_near_K=3.0, gain__d_x_um=20.0, time_constant=300.0
)
RESTING_HEAT = effect(
    "second_source", BEARING, gain__dT_near_K=3.0, gain__d_x_um=20.0, time_constant=300.0, rest=0.25
)
AMBIENT = effect("ambient_drift", AIR, gain__T_column_degC=0.8, gain__d_y_um=6.0,
                 time_constant=500.0)  # fmt: skip
PART_WARM = effect("part_temperature", PART, coefficient__d_y_um=4.0)
JOINT = effect("joint_contact", X, curvature=0.01)
JOINTLY = (
    effect("joint_contact", NEAR, forces__d_x_um=6.0, forces__d_y_um=-4.0, heat__d_y_um=3.0,
           heat__T_column_degC=-0.5, time_constant=400.0, level=10.0)
)  # fmt: skip
NONLINEAR = effect("drive_nonlinearity", HEAT, exponent=1.8, dead_band=0.05, level=1.0)
DRIVE_GAIN = effect("drive_gain", HEAT, gain=1.3)
SATURATION = effect("actuator_saturation", HEAT, limit=0.7, level=1.0)
DELAY = effect("transport_delay", HEAT, delay=30.0)
HYSTERESIS = effect("hysteresis", HEAT, width=0.2)
BACKLASH = effect("backlash", HEAT, width=0.1)
COOLING = effect("convection_state", COOLANT, rate=1.5e-3, level=1.0, idle=0.0)
RADIATION = effect("radiation", COLUMN, rate=2e-2, rest=21.5)
CAPACITY = effect("heat_capacity", COLUMN, rise=0.5, level=30.0)
LATENT = effect("latent_heat", COLUMN, heat=8.0, at=35.0, width=3.0, rest=21.5)
RADIATION_THERE = effect("radiation", PART, rate=2e-2)
LOSS = effect("loss_change", COLUMN, factor=1.4, time_constant=600.0, slow__dT_near_K=-0.05)
SUPPORTED = {
    "gain": (GAIN,),
    "conversion": (CONVERSION,),
    "gain, then conversion": (GAIN, CONVERSION),
    "swapped": (SWAPPED,),
    "swapped, gain": (GAIN, SWAPPED),
    "lag": (LAG,),
    "lag, then conversion": (LAG, CONVERSION),
    "second source": (BEARING_HEAT,),
    "second source with a rest": (RESTING_HEAT,),
    "second source, lag, gain": (BEARING_HEAT, LAG, GAIN),
    "ambient": (AMBIENT,),
    "part": (PART_WARM,),
    "joint": (JOINT,),
    "outputs by a joint": (JOINTLY,),
    "source, joint": (BEARING_HEAT, JOINT),
    "nonlinear": (NONLINEAR,),
    "drive gain": (DRIVE_GAIN,),
    "saturation": (SATURATION,),
    "delay": (DELAY,),
    "hysteresis": (HYSTERESIS,),
    "backlash": (BACKLASH,),
    "cooling": (COOLING,),
    "radiation": (RADIATION,),
    "radiation of a column": (RADIATION_THERE,),
    "heat capacity": (CAPACITY,),
    "latent heat": (LATENT,),
    "loss": (LOSS,),
    "loss, lag": (LOSS, LAG),
    "cooling, ambient, gain": (COOLING, AMBIENT, GAIN),
}
supported = pytest.mark.parametrize("name", SUPPORTED)


def machine_of(document, **kept):
    return DesignModel.of(document, NOISE, PERIOD, **kept)


def designed(document, form="kalman", measured=()):
    """A model with a pinned design."""
    machine = machine_of(document, measured=measured)
    if not machine.drives:
        estimator = Feedforward(machine.outputs)
    elif form == "kalman":
        estimator = design_kalman(machine, 0.05)[0].estimator
    else:
        shape = LATE_KERNEL if LAG in document.effects else KERNEL
        estimator = design_kernel(machine, shape)[0].estimator
    return loads(dumps(document.with_design(machine.finished(estimator).document())))


def ranged(document):
    """Ranges as a calibration would have seen them."""
    seen = {COLUMN: (-30.0, 40.0), NEAR: (-15.0, 20.0), FAR: (-6.0, 8.0)}
    outputs = tuple(replace(o, range=seen.get(o.channel, o.range)) for o in document.outputs)
    drives = tuple(replace(d, range=(-0.6, 1.0)) for d in document.drives)
    return replace(document, outputs=outputs, drives=drives)


@cache
def inputs():
    return columns(extra=(AIR, PART, BEARING, COOLANT), frozen=False)


def log_of(document):
    """What a machine with these effects would log: its own rest, no noise."""
    time, given = inputs()
    result = {c: given[c] for c in (HEAT, AIR, PART, BEARING, COOLANT)}
    simulated = document.simulate(Record(time, result))
    for o in document.outputs:
        result[o.channel] = simulated[o.channel] + (3.0 if o.offset == "first" else o.offset)
    return time, result, simulated


def batch(document, time, table, settled=False):
    pipeline = EstimatorPipeline.of(document)
    told = pipeline.run(time, pipeline.true_values(table), settled)
    return dict(zip(pipeline.estimator.estimates, told.T, strict=True))


def compensator(document, said=None, settled=False, **settings):
    emit = [].append if said is None else said.append
    return offsets(document, Settings(**settings), Messages(emit), settled=settled)


def stream(document, time, table, **settings):
    each = compensator(document, **settings)
    names, rows = EstimatorPipeline.of(document).columns, []
    for k, t in enumerate(time.tolist()):
        each.take(Row(t, [float(table[c][k]) for c in names], ("",) * len(names)))
        rows.append(each.estimates)
    estimates = EstimatorPipeline.of(document).estimator.estimates
    return dict(zip(estimates, np.array(rows).T, strict=True))


def sound():
    return ranged(model())


@cache
def baseline():
    """Estimates of the sound machine, and what it does."""
    time, table, truth = log_of(sound())
    return batch(designed(sound()), time, table), truth


# ---------------------------------------------------------------- batch and stream


@pytest.mark.slow
@supported
@pytest.mark.parametrize("settled", [False, True])
def test_batch_is_stream(name, settled):
    document = designed(ranged(model(*SUPPORTED[name])))
    time, table, _ = log_of(document)
    # An even stretch, then a clock that jitters.
    time = time.copy()
    time[300:] += np.cumsum(np.resize([0.0, 0.5, 1.0], ROWS - 300))
    expected = batch(document, time, table, settled)
    got = stream(document, time, table, settled=settled)
    for channel, values in expected.items():
        np.testing.assert_allclose(got[channel], values, atol=1e-8 * np.ptp(values), rtol=1e-9)


@pytest.mark.parametrize("name", ["gain", "lag", "second source", "ambient", "part", "joint"])
def test_batch_is_stream_in_the_kernel_form(name):
    kept = only_sensors(ranged(model(*SUPPORTED[name])), [NEAR])
    document = designed(kept, "kernel")
    time, table, truth = log_of(document)
    expected, got = batch(document, time, table), stream(document, time, table)
    for channel, values in expected.items():
        np.testing.assert_allclose(got[channel], values, atol=1e-8 * np.ptp(values), rtol=1e-9)
    plain = batch(designed(replace(kept, effects=()), "kernel"), time, table)
    right, wrong = (
        max(float(np.sqrt(np.mean((each[d] - truth[d]) ** 2))) for d in (X, Y))
        for each in (expected, plain)
    )
    assert right < 0.1 * wrong


# ---------------------------------------------------------------- the truth comes back


def error(document, table_of=None):
    """RMS errors of both deflections of a design on the log of `table_of` (its own)."""
    time, table, truth = log_of(table_of or document)
    estimates = batch(designed(document), time, table)
    return {d: float(np.sqrt(np.mean((estimates[d] - truth[d]) ** 2))) for d in (X, Y)}


@supported
def test_the_extended_model_is_right_and_the_plain_one_is_wrong(name):
    document = ranged(model(*SUPPORTED[name]))
    usual = error(sound())
    own, plain = error(document), error(sound(), document)
    for deflection in (X, Y):
        # What is told late, by a lag, or with more noise is estimated more slowly.
        assert own[deflection] < 3.0 * usual[deflection], deflection
    if document.effects[0].side != "drive":
        assert max(plain[d] / own[d] for d in (X, Y)) > 30


@pytest.mark.parametrize("name", ["gain", "conversion", "gain, then conversion", "swapped",
                                  "swapped, gain"])  # fmt: skip
def test_readings_are_put_right_exactly(name):
    """The faulty sensors of a sound machine, with the sound machine's own estimator."""
    document = ranged(model(*SUPPORTED[name]))
    estimator = design_kalman(machine_of(sound()), 0.05)[0].estimator
    expected, _ = baseline()
    time, table, _ = log_of(document)
    got = batch(document.with_design(estimator.document()), time, table)
    for channel, values in expected.items():
        np.testing.assert_allclose(got[channel], values, atol=1e-9 * np.ptp(values))


@pytest.mark.parametrize("name", ["second source", "ambient", "part"])
@pytest.mark.parametrize("form", ["kalman", "kernel"])
def test_what_a_column_tells_is_left_out_of_sensors_and_added_to_deflections(name, form):
    plain, document = sound(), ranged(model(*SUPPORTED[name]))
    if form == "kernel":
        plain, document = (only_sensors(each, [NEAR]) for each in (plain, document))
    time, table, without = log_of(plain)
    expected = batch(designed(plain, form), time, table)
    _, table, truth = log_of(document)
    got = batch(designed(document, form), time, table)
    for channel, values in expected.items():
        share = truth[channel] - without[channel] if channel in truth else 0.0
        np.testing.assert_allclose(got[channel], values + share, atol=1e-9 * np.ptp(values))


def test_the_heat_of_a_joint_is_told_by_the_contact_temperature_that_is_read():
    """Readings of the contact that depart from the linear model move the deflections alone."""
    bend = effect("joint_contact", NEAR, forces__d_x_um=6.0, level=10.0)
    joint = replace(
        effect("joint_contact", NEAR, deviation__d_x_um=5.0, contact__d_y_um=2.0,
               deviation__d_y_um=-3.0, time_constant=400.0, level=10.0),
        partner=COLUMN,
    )  # fmt: skip
    plain = ranged(model(bend, joint))
    outputs = tuple(replace(o, role="deflection") if o.channel == COLUMN else o
                    for o in plain.outputs)  # fmt: skip
    document = replace(plain, outputs=outputs)
    time, table, _ = log_of(ranged(model()))
    table[COLUMN] = table[COLUMN] + 2.0 * (time > 0.4 * time[-1])
    expected = document.simulate(Record(time, table))
    for measured in ((), (HEAT,)):
        machine = designed(document, measured=measured)
        got, streamed = batch(machine, time, table), stream(machine, time, table)
        # What is read need not be estimated.
        assert COLUMN not in got
        for deflection in (X, Y):
            np.testing.assert_allclose(
                streamed[deflection], got[deflection], atol=1e-8 * np.ptp(got[deflection])
            )
            off = got[deflection] - expected[deflection]
            # Read, z is of the moment; estimated, the heat comes late.
            assert np.sqrt(np.mean(off**2)) < 0.02 * np.ptp(expected[deflection])


def test_a_contact_that_answers_late_is_followed():
    joint = replace(effect("joint_contact", NEAR, contact__d_x_um=5.0, level=10.0), partner=COLUMN)
    plain = ranged(model(joint))
    late = {"response": response_class("rational1")(K1=4.0, tau1=900.0, delay=60.0)}
    document = replace(
        plain,
        outputs=tuple(
            replace(o, role="deflection") if o.channel == COLUMN else o for o in plain.outputs
        ),
        terms=tuple(replace(t, **late) if t.output == COLUMN else t for t in plain.terms),
    )
    time, table, _ = log_of(replace(document, effects=()))
    table[COLUMN] = table[COLUMN] + 1.0 * (time > 0.4 * time[-1])
    got, expected = batch(designed(document), time, table), document.simulate(Record(time, table))
    off = got[X] - expected[X]
    assert np.sqrt(np.mean(off**2)) < 0.02 * np.ptp(expected[X])


@pytest.mark.parametrize("name", ["nonlinear", "saturation", "delay"])
def test_drives_are_told_as_they_are_logged_where_one_can(name):
    document = ranged(model(*SUPPORTED[name]))
    time, table, _ = log_of(document)
    heat = batch(designed(document), time, table)[HEAT]
    # The last tenth of each level.
    steady = np.concatenate([np.arange(90, 100) + 100 * k for k in range(8)])
    told = table[HEAT][steady]
    if name == "saturation":
        told = np.clip(told, -0.7, 0.7)
    told = np.where((name == "nonlinear") & (told == 0), heat[steady], told)
    np.testing.assert_allclose(heat[steady], told, atol=0.06)


def test_what_cannot_be_taken_back_is_noted():
    (note,) = machine_of(ranged(model(SATURATION))).notes
    assert note == "Q_main_1: the estimate is what acts, behind actuator_saturation"
    assert machine_of(ranged(model(NONLINEAR, GAIN))).notes == ()
    (note,) = machine_of(model(effect("sensor_gain", X, gain=1.3))).notes
    assert note.startswith("d_x_um: what is estimated is the truth, before sensor_gain")


# ---------------------------------------------------------------- machines written by hand


def by_hand(seconds=6000, period=5.0, lag=0.0, gain=1.0, bearing=0.0, loss=0.0):
    """A machine in small steps: one temperature, one deflection; bearing and coolant switched."""
    steps, inner = int(seconds / period), 200
    dt = period / inner
    warm = bend = second = second_bend = read = 0.0
    rows = []
    for k in range(steps):
        t = k * period
        heat = 1.0 if 500 <= t < 3500 else 0.3
        heat = 0.0 if t < 500 else heat
        on, coolant = float(1500 <= t < 4000), float(2000 <= t < 5000)
        sensed = gain * (read if lag else warm + second)
        rows.append([t, sensed, on, coolant, bend + second_bend])
        for _ in range(inner):
            warm += dt * ((20.0 * heat - warm) / 200 - loss * coolant * warm)
            bend += dt * ((-60.0 * heat - bend) / 500 - loss * coolant * bend)
            second += dt * (bearing * 3.0 * on - second) / 300
            second_bend += dt * (bearing * 20.0 * on - second_bend) / 300
            if lag:
                read += dt * (warm + second - read) / lag
    time, sensed, on, coolant, deflection = np.array(rows).T
    return time, {NEAR: sensed, BEARING: on, COOLANT: coolant}, deflection


@pytest.mark.parametrize(
    ("fault", "causes"),
    [
        ({"gain": 0.8}, (GAIN,)),
        ({"lag": 120.0}, (LAG,)),
        ({"bearing": 1.0}, (BEARING_HEAT,)),
        ({"loss": 1.5e-3}, (COOLING,)),
        ({"bearing": 1.0, "lag": 120.0, "gain": 0.8}, (BEARING_HEAT, LAG, GAIN)),
    ],
)
def test_a_machine_written_by_hand(fault, causes):
    plain = ranged(model(outputs=(NEAR, X)))
    extended = replace(plain, effects=causes)
    time, table, truth = by_hand(**fault)
    sigma = [
        float(np.sqrt(np.mean((batch(designed(m), time, table)[X] - truth) ** 2)))
        for m in (plain, extended)
    ]
    # Of about 60 µm.
    assert sigma[0] > 3.0
    assert sigma[1] < 0.1


# ---------------------------------------------------------------- measured drives


def test_without_sensors_deflections_follow_from_the_drives_as_in_a_simulation():
    for hold in ("zero", "first"):
        document = ranged(model(NONLINEAR, AMBIENT, JOINT, outputs=(X, Y), hold=hold))
        document = designed(document)
        time, table, truth = log_of(document)
        assert EstimatorPipeline.of(document).columns == (HEAT, AIR)
        got = batch(document, time, table)
        assert tuple(got) == (X, Y)
        for channel, values in got.items():
            np.testing.assert_allclose(values, truth[channel], atol=1e-6 * np.ptp(values))
            np.testing.assert_allclose(stream(document, time, table)[channel], values, atol=1e-8)


def test_a_measured_drive_beside_an_estimated_one():
    """The bearing as a drive of its own: read, in place of an effect that does the same."""
    from effects.machine import first_order

    from thermaltool.model import Drive, Term

    document = sound()
    terms = (
        Term(BEARING, NEAR, first_order(3.0, 1 / 300)),
        Term(BEARING, X, first_order(20.0, 1 / 300)),
    )
    drive = Drive(BEARING, "zero", 0.0, (0.0, 1.0))
    document = replace(document, drives=(*document.drives, drive), terms=document.terms + terms)
    other = designed(ranged(model(BEARING_HEAT)))
    mine = designed(document, measured=(BEARING,))
    time, table, _ = log_of(other)
    expected, got = batch(other, time, table), batch(mine, time, table)
    for channel, values in expected.items():
        np.testing.assert_allclose(got[channel], values, atol=1e-9 * np.ptp(values))
    for channel, values in stream(mine, time, table).items():
        np.testing.assert_allclose(values, got[channel], atol=1e-8 * np.ptp(values))
    assert machine_of(document, measured=(HEAT, BEARING)).sensors == ()
    with pytest.raises(ModelError, match="no drive Q_pump_1 in the model"):
        machine_of(document, measured=("Q_pump_1",))


def test_known_columns_are_held_as_sensors_are_and_lost_as_they_are():
    said = []
    each = compensator(designed(ranged(model(AMBIENT))), said, hold=20.0, frozen_after=10.0)
    names = [sensor.channel for sensor in each.sensors]
    assert names == [COLUMN, NEAR, FAR, AIR]
    readings = [21.5, 0.0, 0.0, 20.0]
    for k in range(3):
        each.take(Row(5.0 * k, [x + 1e-6 * k for x in readings], ("",) * 4))
    bad = [21.5, 0.0, 0.0, float("nan")]
    for k in range(3, 9):
        each.take(Row(5.0 * k, [x + 1e-6 * k for x in bad], ("", "", "", "empty")))
    assert next(s for s in said if AIR in s).endswith("empty: holding 20.000002")
    assert each.sensors[3].lost
    assert not any(sensor.lost for sensor in each.sensors[:3])


# ---------------------------------------------------------------- readings without a truth


def test_readings_that_no_truth_gives_are_bad():
    bent = effect("sensor_conversion", NEAR, curvature=-0.02)
    document = designed(ranged(model(bent)))
    pipeline = EstimatorPipeline.of(document)
    # The turning point: 25 K read as 12.5 K.
    table = {COLUMN: [21.5] * 2, NEAR: [12.4, 12.6], FAR: [0.0] * 2}
    truths = pipeline.true_values({name: np.array(values) for name, values in table.items()})
    assert truths[0, 1] == pytest.approx((1 - np.sqrt(1 - 0.08 * 12.4)) / 0.04)
    assert np.isnan(truths[1, 1])
    said = []
    each = compensator(document, said)
    for k, reading in enumerate([0.0, 12.4, 12.6, 12.0]):
        each.take(Row(5.0 * k, [21.5, reading, 0.0], ("",) * 3))
    assert [s.split(": ", 1)[1] for s in said if "truth" in s] == [
        "dT_near_K: out of range: no truth gives 12.6: holding 12.4"
    ]
    assert each.sensors[1].value == 12.0


def test_ranges_are_of_the_truth():
    document = designed(ranged(model(effect("sensor_gain", NEAR, gain=0.1))))
    said = []
    each = compensator(document, said)
    # 3 K read are 30 K: beyond the 20 K of the calibration, within what is borne.
    for k, reading in enumerate([0.0, 1.0, 3.0, 6.0]):
        each.take(Row(5.0 * k, [21.5, reading, 0.0], ("",) * 3))
    assert any("3 is outside the calibrated range" in s for s in said)
    assert any("out of range: 6 (60) not in -50..55" in s for s in said)


# ---------------------------------------------------------------- refusals


REFUSED = [
    (effect("sensor_drift", NEAR, rate=0.1), "sensor_drift of dT_near_K: no reading of a stream"),
    (effect("sensor_frozen", NEAR, start=10.0), "sensor_frozen of dT_near_K: an accident"),
    (effect("sensor_offset_step", NEAR, step=1.0, time=9.0), "sensor_offset_step of dT_near_K"),
    (effect("geometry_step", X, step__d_x_um=1.0, time=9.0), "geometry_step of d_x_um"),
    (effect("drive_gain_step", HEAT, gain=0.5, time=9.0), "drive_gain_step of Q_main_1: an acc"),
    (effect("sensor_self_heating", NEAR, rise=1.0, time_constant=9.0), "sensor_self_heating of dT"),
    (effect("logger_clock", NEAR, offset=9.0, logged__dT_near_K=1.0), "logger_clock of dT_near_K"),
    (effect("stick_slip", X, width=9.0), "stick_slip of d_x_um: supported only where it bends"),
    (
        effect("switching_loss", NEAR, rate=1e-3, on=9.0, off=8.0),
        "switching_loss of dT_near_K: it counts by the reading of a sensor",
    ),
    (effect("outliers", NEAR, share=0.1, amplitude=1.0), "outliers of dT_near_K"),
    (effect("noise_state", NEAR, partner=HEAT, quiet=0.1, loud=0.3), "noise_state of dT_near_K"),
    (effect("periodic", X, sine__d_x_um=1.0, cosine__d_x_um=1.0, period=60.0), "periodic of d_x"),
    (effect("record_too_short", X, covered=0.5), "record_too_short of d_x_um"),
    (
        effect("second_source", "", gain__d_x_um=1.0, time_constant=9.0, start=3.0),
        "second_source: no column tells a stream of it",
    ),
    (
        effect("ambient_drift", "", swing__d_x_um=1.0, period=9e3, phase=0.0),
        "ambient_drift: no column",
    ),
    (effect("sensor_conversion", NEAR, curvature=-0.03), "two values give one reading"),
    (effect("sensor_gain", NEAR, gain=0.0), "two values give one reading"),
    (effect("joint_contact", NEAR, curvature=0.1), "joint_contact of dT_near_K"),
    (
        effect("joint_contact", X, forces__d_y_um=1.0, time_constant=9.0, level=1.0),
        "joint_contact of d_x_um: supported only where a temperature",
    ),
    (effect("conductivity", NEAR, curvature__dT_near_K=0.1), "conductivity of dT_near_K: "),
    (effect("sensors_swapped", NEAR, partner=X), "not two sensors of the model"),
    (effect("sensors_swapped", NEAR), "not two sensors of the model"),
    (
        effect("convection_state", HEAT, rate=1e-3, level=1.0, idle=1.0),
        "convection_state of Q_main_1: it counts when the drive is off",
    ),
    (effect("radiation", "T_gone_degC", rate=1e-3, rest=20.0), "radiation of T_gone_degC"),
]


@pytest.mark.parametrize(("cause", "message"), REFUSED, ids=lambda each: getattr(each, "name", ""))
def test_what_no_stream_can_follow_is_refused_by_name(cause, message):
    with pytest.raises(ModelError, match=message):
        machine_of(ranged(model(cause)))


@pytest.mark.parametrize(
    ("causes", "message"),
    [
        ((CONVERSION, LAG), "sensor_lag of dT_near_K: not supported behind sensor_conversion"),
        (
            (COOLING, LAG),
            "convection_state of .*: not supported beside a lag of the sensor dT",
        ),
    ],
)
def test_pairs_that_no_stream_can_follow_are_refused(causes, message):
    with pytest.raises(ModelError, match=message):
        machine_of(ranged(model(*causes)))


@pytest.mark.parametrize("cause", [DELAY, HYSTERESIS, BACKLASH])
def test_what_a_measured_drive_cannot_have_is_refused(cause):
    with pytest.raises(ModelError, match=f"{cause.name} of .* not supported"):
        machine_of(ranged(model(cause)), measured=(HEAT,))


def test_every_cause_of_the_catalogue_is_followed_or_refused():
    """None passes in silence: the lists above hold them all."""
    tried = {e.name for each in SUPPORTED.values() for e in each} | {e.name for e, _ in REFUSED}
    assert tried == set(CATALOGUE)


def test_a_cause_that_nobody_taught_to_stream_is_refused():
    class Ghost(Effect):
        name, side, event = "ghost", "sensor", False

    with pytest.raises(ModelError, match="ghost of dT_near_K: no reading of a stream"):
        machine_of(replace(sound(), effects=(Ghost(NEAR, {}),)))


def test_accidents_of_a_log_do_not_act():
    step = effect("sensor_offset_step", NEAR, log="that day", step=5.0, time=100.0)
    document = designed(ranged(model(step)))
    time, table, _ = log_of(sound())
    expected, _ = baseline()
    for channel, values in batch(document, time, table).items():
        np.testing.assert_array_equal(values, expected[channel])


def test_the_kernel_form_follows_no_loss():
    machine = machine_of(only_sensors(ranged(model(COOLING)), [NEAR]))
    with pytest.raises(FitError, match="cannot follow convection_state"):
        design_kernel(machine, KERNEL)


# ---------------------------------------------------------------- some of the sensors


def test_effects_go_with_their_sensors():
    document = ranged(model(GAIN, BEARING_HEAT, AMBIENT, RADIATION))
    kept = only_sensors(document, [COLUMN, FAR])
    assert [e.name for e in kept.effects] == ["second_source", "ambient_drift", "radiation"]
    assert set(kept.effects[0].parameters) == {"gain[d_x_um]", "time_constant"}
    only = effect("second_source", BEARING, gain__dT_near_K=3.0, time_constant=300.0)
    assert only_sensors(ranged(model(only)), [FAR]).effects == ()
    with pytest.raises(ModelError, match="radiation needs the sensor T_column_degC"):
        only_sensors(document, [NEAR])
    with pytest.raises(ModelError, match="sensors_swapped needs the sensor dT_far_K"):
        only_sensors(ranged(model(SWAPPED)), [NEAR])


def test_a_swapped_sensor_is_read_in_the_other_column():
    pipeline = EstimatorPipeline.of(designed(ranged(model(SWAPPED))))
    assert pipeline.columns == (COLUMN, FAR, NEAR)
    assert [inlet.calibrated for inlet in pipeline.input_columns] == [(-30, 40), (-15, 20), (-6, 8)]


def test_noise_is_that_of_the_truth():
    plain, gained = (machine_of(ranged(model(*e))).noise[1] for e in ((), (GAIN,)))
    assert gained.white == pytest.approx(plain.white / 0.8)
    assert gained.drift == pytest.approx(plain.drift / 0.8)


# ---------------------------------------------------------------- losses


def test_a_settled_machine_stays_under_a_loss_that_follows_its_temperature():
    document = designed(ranged(model(RADIATION)))
    time = PERIOD * np.arange(400)
    long = 20.0 * np.arange(600)
    table = {HEAT: np.ones(600)}
    end = {name: values[-1] for name, values in document.simulate(Record(long, table)).items()}
    rests = {COLUMN: 21.5, NEAR: 0.0, FAR: 0.0}
    stood = {name: np.full(400, end[name] + rest) for name, rest in rests.items()}
    got = batch(document, time, stood, settled=True)
    for name in (X, Y):
        np.testing.assert_allclose(got[name], end[name], rtol=2e-3)


def test_a_loss_acts_as_in_a_simulation():
    """Told the heat and readings of a simulation in long samples, nothing is left to correct."""
    document = designed(ranged(model(COOLING)))
    estimator = EstimatorPipeline.of(document).estimator
    period = 60.0
    time = period * np.arange(80)
    table = {HEAT: np.ones(80), COOLANT: (time > 1500).astype(float)}
    simulated = document.simulate(Record(time, table))
    readings = np.column_stack([*(simulated[c] for c in (COLUMN, NEAR, FAR)), table[COOLANT]])
    x = np.zeros(len(estimator.recursion(period).F))
    x[estimator.kalman.modal] = 1.0
    for before, now in pairwise(readings):
        x = estimator.advance(round(period / CLOCK_STEP), x, readings[0], before, now)
        assert x[estimator.kalman.modal] == pytest.approx(1.0, abs=1e-9)


def test_a_held_reading_survives_a_restart():
    document = designed(ranged(model(GAIN)))
    first, second = compensator(document), compensator(document)
    for k in range(5):
        first.take(Row(5.0 * k, [21.5, 0.5 * k, 0.1 * k], ("",) * 3))
    second.resume(first.state())
    for each in (first, second):
        each.take(Row(25.0, [21.5, float("nan"), 0.5], ("", "empty", "")))
    assert first.estimates == second.estimates
    assert first.estimates[0] > 0.01


def test_a_loss_survives_a_restart():
    document = designed(ranged(model(RADIATION, AMBIENT)))
    first, second = compensator(document), compensator(document)
    lines = [Row(5.0 * k, [21.5 + k, 0.5 * k, 0.1 * k, 20.0 + 0.1 * k], ("",) * 4)
             for k in range(20)]  # fmt: skip
    for line in lines[:10]:
        first.take(line)
    second.resume(first.state())
    for line in lines[10:]:
        first.take(line)
        second.take(line)
    assert first.estimates == second.estimates
    state = first.state()
    for damage in ([], state["estimator"][:-1], [*state["estimator"][:-1], float("nan")]):
        with pytest.raises(ValueError, match="not a state"):
            second.resume({**state, "estimator": damage})


def test_a_loss_that_explodes_is_told():
    estimator = EstimatorPipeline.of(designed(ranged(model(COOLING)))).estimator
    assert isinstance(estimator, VariableCoolingEstimator)
    nothing = np.zeros(len(estimator.recursion(PERIOD).F))
    readings = np.array([0.0, 0.0, 0.0, 1.0])
    with pytest.raises(FitError, match="cannot be followed"):
        estimator.advance(round(1e6 / CLOCK_STEP), nothing, readings, readings, readings)


def test_a_design_whose_source_counts_from_its_first_value_is_refused():
    pinned = designed(ranged(model(BEARING_HEAT)))
    design = copy.deepcopy(pinned.design)
    places = [design]
    for place in places:
        if place.get("role") == "source":
            assert place.pop("rest") == 0.0
        inner = (v if isinstance(v, list) else [v] for v in place.values())
        places += [each for values in inner for each in values if isinstance(each, dict)]
    with pytest.raises(ModelError, match=f"{BEARING} counts from 0 now: run .* regularize again"):
        EstimatorPipeline.of(replace(pinned, design=design))
