"""Hidden effects: of the wanted size, in the right place, repeatable, and told truly."""

from functools import cache

import numpy as np
import pytest
from machines.faults import FAULTS, VARIANTS
from machines.hidden import EFFECTS, hide
from machines.network import OUTPUTS, machine
from machines.scenario import DEFLECTIONS, DRIVE, SENSORS, new_run

from thermaltool.units import parse_channel

FORMS = [(effect, form) for effect in EFFECTS for form in (None, *VARIANTS.get(effect, ()))]
SIZELESS = ("sensor_frozen", "sensors_swapped", "record_too_short")
CATALOGUE = {
    "ambient_drift",
    "second_source",
    "drive_nonlinearity",
    "transport_delay",
    "sensor_lag",
    "sensor_gain",
    "sensor_offset_step",
    "sensor_drift",
    "sensor_conversion",
    "sensor_frozen",
    "sensors_swapped",
    "convection_state",
    "radiation",
    "joint_contact",
    "hysteresis",
    "backlash",
    "actuator_saturation",
    "periodic",
    "geometry_step",
    "part_temperature",
    "record_too_short",
    "outliers",
}
# What each may change; those that act on the heat balance or the drive change everything.
ONE_SENSOR = {
    "sensor_lag",
    "sensor_gain",
    "sensor_offset_step",
    "sensor_drift",
    "sensor_conversion",
    "sensor_frozen",
}
MACHINE, SEED = 8, 21


@cache
def hidden_alone(effect, size=5.0, form=None):
    return hide([effect], size, MACHINE, SEED, form)


def changed(found):
    return {name for name in OUTPUTS if np.ptp(found.truth[name] - found.clean[name]) > 1e-9}


def reached(found):
    sizes = []
    for name in OUTPUTS:
        change = found.truth[name] - found.clean[name]
        change = change - change.mean() if name in DEFLECTIONS else change
        sizes.append(np.sqrt(np.mean(change**2)) / found.noise[name])
    return max(sizes)


def test_the_whole_catalogue_is_there():
    assert set(EFFECTS) == CATALOGUE


@pytest.mark.parametrize(
    ("effect", "form", "size"),
    [(*each, 5.0) for each in FORMS]
    + [(e, None, 2.0) for e in ("transport_delay", "convection_state", "backlash", "radiation")],
)
def test_effects_have_the_wanted_size_and_tell_it(effect, form, size):
    found = hidden_alone(effect, size, form)
    (hidden,) = found.hidden
    assert (hidden.effect, hidden.variant) == (effect, form)
    assert hidden.size == pytest.approx(reached(found), rel=1e-9)
    if effect not in SIZELESS:
        assert hidden.size == pytest.approx(size, rel=0.02)
    # The rest of the log is as without the effect, but for what it drives or leaves out.
    assert set(found.truth) == set(found.clean) == set(OUTPUTS)
    assert all(np.isfinite(values).all() for values in found.log.values())
    assert len({len(values) for values in found.log.values()}) == 1
    assert set(found.log) == set(found.calibration)
    for name in set(found.log) - {"time_s"}:
        assert parse_channel(name).name == name
    if hidden.channel is not None:
        assert hidden.channel in found.log


@pytest.mark.parametrize(("effect", "form"), FORMS)
def test_effects_change_only_what_physics_says(effect, form):
    found = hidden_alone(effect, form=form)
    (hidden,) = found.hidden
    expected = set(OUTPUTS)
    if effect in ONE_SENSOR | {"joint_contact", "outliers"}:
        expected = {hidden.channel}
    elif effect == "sensors_swapped":
        expected = {"dT_near_K", "dT_far_K"}
    elif effect == "geometry_step":
        expected = set(DEFLECTIONS)
    elif effect == "part_temperature":
        expected = {next(iter(hidden.parameters)).removeprefix("coefficient_")}
    elif effect == "record_too_short":
        expected = set()
    assert changed(found) == expected
    if effect in ONE_SENSOR:
        assert hidden.channel in SENSORS


@pytest.mark.parametrize(("effect", "form"), FORMS)
def test_no_strength_is_no_effect(effect, form):
    plain = new_run(machine(MACHINE), (SEED, MACHINE))
    fault = FAULTS[effect](plain, np.random.default_rng(5), form)
    clean = plain.simulate()
    if fault.most is not None:
        none, little, twice = (new_run(machine(MACHINE), (SEED, MACHINE)) for _ in range(3))
        fault.apply(0.0, none)
        for name, values in none.simulate().items():
            np.testing.assert_allclose(values, clean[name], atol=1e-9)
        # And a little of it is little, in proportion.
        changes = []
        for run, strength in ((little, 1e-3), (twice, 2e-3)):
            fault.apply(strength * min(fault.most, 1.0), run)
            outputs = run.simulate()
            changes.append(max(np.std(outputs[name] - clean[name]) for name in OUTPUTS))
        assert 0.0 < changes[0] < changes[1] < 4.0 * changes[0]


@pytest.mark.parametrize("effect", ["transport_delay", "sensor_frozen", "outliers", "hysteresis"])
def test_seeds_repeat_and_differ(effect):
    first, again, other = (hide([effect], 5.0, MACHINE, seed) for seed in (1, 1, 2))
    assert first.hidden == again.hidden
    assert first.hidden != other.hidden
    for name in first.log:
        np.testing.assert_array_equal(first.log[name], again.log[name])
        np.testing.assert_array_equal(first.calibration[name], again.calibration[name])
    shared = min(len(first.log[DRIVE]), len(other.log[DRIVE]))
    assert not np.array_equal(first.log[DRIVE][:shared], other.log[DRIVE][:shared])


@pytest.mark.parametrize("seed", range(6))
def test_a_clean_log_differs_from_its_truth_by_noise_alone(seed):
    found = hide(["clean"], 5.0, seed, seed)
    assert found.hidden == ()
    for name in OUTPUTS:
        noise = found.log[name] - found.clean[name]
        np.testing.assert_array_equal(found.truth[name], found.clean[name])
        # A tenth of the power is slow, with few independent samples.
        assert np.std(noise) == pytest.approx(found.noise[name], rel=0.15)
    assert 1500 <= len(found.log["time_s"]) <= 2500
    assert found.calibration["time_s"][-1] >= 2.9 * found.slowest
    for table in (found.calibration, found.log):
        assert len(np.unique(table[DRIVE])) >= 5
        assert table[DRIVE].min() == 0.0
        assert table[DRIVE].max() <= 1.0
        assert np.ptp(table["T_part_degC"]) > 1.0
        assert set(np.unique(table["x_coolant_1"])) == {0.0, 1.0}
    for name in (*DEFLECTIONS, "dT_near_K"):
        assert np.ptp(found.log[name]) > 50 * found.noise[name]


def test_an_effect_leaves_the_other_readings_as_they_are():
    clean, found = (hide(names, 5.0, MACHINE, SEED) for names in ([], ["sensor_gain"]))
    for name in set(clean.log) - {found.hidden[0].channel}:
        np.testing.assert_array_equal(clean.log[name], found.log[name])
    for name in clean.calibration:
        np.testing.assert_array_equal(clean.calibration[name], found.calibration[name])


def test_two_effects_act_together():
    names = ["sensor_offset_step", "drive_nonlinearity"]
    both = hide(names, 5.0, MACHINE, SEED, None)
    single = [hidden_alone(name) for name in names]
    assert both.hidden == tuple(each.hidden[0] for each in single)
    # The step of a sensor adds to whatever the machine does.
    for name in OUTPUTS:
        change = sum(each.truth[name] - each.clean[name] for each in single)
        np.testing.assert_allclose(both.truth[name] - both.clean[name], change, atol=1e-9)


def test_what_is_latent_is_not_logged():
    for effect, column in (("ambient_drift", "T_ambient_degC"), ("second_source", "Q_bearing_1")):
        latent = hidden_alone(effect, form="latent")
        assert column not in latent.log
        assert column not in latent.calibration
        assert column in hidden_alone(effect).log


def test_parameters_are_what_the_log_shows():
    step = hide(["geometry_step"], 50.0, MACHINE, SEED)
    truth = step.hidden[0].parameters
    after = step.log["time_s"] >= truth["time_s"]
    assert 0.2 <= np.mean(step.log["time_s"] < truth["time_s"]) <= 0.8
    for name in DEFLECTIONS:
        jump = step.truth[name] - step.clean[name]
        np.testing.assert_allclose(jump, truth[f"step_{name}"] * after, atol=1e-9)

    frozen = hidden_alone("sensor_frozen")
    (hidden,) = frozen.hidden
    since = frozen.log["time_s"] >= hidden.parameters["start_s"]
    assert np.ptp(frozen.log[hidden.channel][since]) == 0.0
    assert np.ptp(frozen.log[hidden.channel][~since]) > 1.0

    spikes = hidden_alone("outliers")
    (hidden,) = spikes.hidden
    off = np.abs(spikes.truth[hidden.channel] - spikes.clean[hidden.channel])
    assert np.mean(off > 0.0) == pytest.approx(hidden.parameters["share"], rel=1e-9)
    assert off.max() <= 1.5 * hidden.parameters["amplitude"] + 1e-9

    swapped = hidden_alone("sensors_swapped")
    np.testing.assert_array_equal(swapped.truth["dT_near_K"], swapped.clean["dT_far_K"])
    assert np.abs(swapped.log["dT_far_K"] - swapped.clean["dT_near_K"]).max() < 0.15


def test_a_gain_of_a_source_is_where_it_ends():
    for effect in ("second_source", "ambient_drift"):
        found = hidden_alone(effect)
        run = new_run(machine(MACHINE), (SEED, MACHINE))
        # A linear machine: the effect with its source on for good.
        fault = FAULTS[effect](run, np.random.default_rng(5), None)
        parameters = fault.apply(0.3, run)
        column = run.columns["Q_bearing_1" if effect == "second_source" else "T_ambient_degC"]
        run.columns[DRIVE] = np.zeros_like(column)
        if effect == "second_source":
            run.heat = np.tile(run.heat[column > 0][0], (len(column), 1))
        else:
            column[0], column[1:] = 20.0, 21.0
        ends = run.simulate()
        for name in OUTPUTS:
            end = ends[name][-1] - (20.0 if name == "T_column_degC" else 0.0)
            assert end == pytest.approx(parameters[f"gain_{name}"], rel=0.02, abs=1e-4)
        assert set(found.hidden[0].parameters) == set(parameters)


def test_a_delay_is_a_delay():
    found = hide(["transport_delay"], 80.0, MACHINE, SEED)
    delay = found.hidden[0].parameters["delay_s"]
    time = found.log["time_s"]
    assert delay > 5 * time[1]
    late = np.interp(time - delay, time, found.clean["d_y_um"])
    np.testing.assert_allclose(found.truth["d_y_um"], late, atol=0.01 * np.ptp(late))


def test_a_lagging_sensor_solves_its_equation():
    found = hide(["sensor_lag"], 30.0, MACHINE, SEED)
    (hidden,) = found.hidden
    rise = 20.0 * hidden.channel.endswith("degC")
    truth, clean = (table[hidden.channel] - rise for table in (found.truth, found.clean))
    dt = found.log["time_s"][1]
    slope = np.diff(truth) / dt * hidden.parameters["time_constant_s"]
    mean = (truth[1:] + truth[:-1] - clean[1:] - clean[:-1]) / 2
    np.testing.assert_allclose(slope, -mean, atol=0.02 * np.ptp(clean))


def test_hysteresis_and_backlash_remember():
    drive = np.r_[np.linspace(0, 1, 201), np.linspace(1, 0, 201), np.linspace(0, 1, 201)]
    for effect in ("hysteresis", "backlash"):
        run = new_run(machine(MACHINE), (SEED, MACHINE))
        fault = FAULTS[effect](run, np.random.default_rng(5), None)
        truth = fault.apply(0.2, run)
        heat = run.drive[0](drive)
        half = truth["width"] / 2
        share = truth.get("share", 1.0)
        middle = np.array([100, 301])
        up, down = heat[middle]
        # Midway: the loop is open by the width, less what a Bouc-Wen law has not yet taken up.
        slack = 1.0 if effect == "backlash" else -np.expm1(-0.5 / half)
        back = 1.0 if effect == "backlash" else 1.0 - 2.0 * np.exp(-0.5 / half)
        assert down - up == pytest.approx(share * half * (slack + back), rel=0.03)
        static = FAULTS["drive_nonlinearity"](run, np.random.default_rng(5), None)
        static.apply(0.2, run)
        up, down = run.drive[1](drive)[middle]
        assert up == pytest.approx(down)


def test_a_joint_transmits_what_its_balance_says():
    found = hide(["joint_contact"], 40.0, MACHINE, SEED)
    (hidden,) = found.hidden
    stiffness, stiffening = (hidden.parameters[k] for k in ("stiffness_1", "stiffening"))
    transmitted, linear = found.truth[hidden.channel], found.clean[hidden.channel]
    compression = linear * (1 + stiffness) / stiffness - transmitted
    force = stiffness * compression * (1 + stiffening * compression)
    np.testing.assert_allclose(force, transmitted, atol=1e-8 * np.ptp(linear))


def test_the_curvature_of_a_joint_is_its_leading_term():
    found = hidden_alone("joint_contact", size=0.1)
    (hidden,) = found.hidden
    linear = found.clean[hidden.channel]
    leading = hidden.parameters["curvature"] * linear**2
    error = found.truth[hidden.channel] - linear - leading
    assert np.abs(error).max() < 0.02 * np.abs(leading).max()


def test_a_short_record_ends_before_the_slowest_time_constant():
    short, whole = (hide(names, 5.0, MACHINE, SEED) for names in (["record_too_short"], []))
    end = short.calibration["time_s"][-1]
    assert end <= 0.5 * short.slowest < end + short.log["time_s"][1]
    for name, values in short.calibration.items():
        np.testing.assert_array_equal(values, whole.calibration[name][: len(values)])
    assert len(short.log["time_s"]) == len(whole.log["time_s"])


def test_radiation_is_hidden_in_a_hot_log():
    found = hidden_alone("radiation")
    assert found.clean["T_column_degC"].max() > found.calibration["T_column_degC"].max() + 10.0
    assert 0.0 < found.hidden[0].parameters["emissivity"] <= 1.0
    # Only losses beyond proportion: never warmer than without it.
    assert np.all(found.truth["T_column_degC"] <= found.clean["T_column_degC"] + 1e-9)


@pytest.mark.parametrize(
    ("effects", "size", "variant"),
    [
        (["gravity"], 5.0, None),
        (["backlash", "backlash"], 5.0, None),
        (["backlash"], 5.0, "latent"),
        ([], 5.0, "latent"),
        (["backlash"], 0.0, None),
        (["backlash"], float("nan"), None),
    ],
)
def test_what_cannot_be_hidden_is_said(effects, size, variant):
    with pytest.raises(ValueError, match=r"effect|variant|positive"):
        hide(effects, size, 0, 0, variant)
