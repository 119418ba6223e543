"""The foreign machines: they keep their heat, come to rest, and go wrong as much as is wanted."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from machines.foreign import PLANTS
from machines.foreign.fault import Scene
from machines.foreign.faults import CATALOGUE, NATURAL
from machines.foreign.hide import KINDS, calibration, change_of, hide, size_of
from machines.foreign.plant import ROOM, draw, read, run
from machines.foreign.solver import Loads, simulate
from machines.foreign.strangers import MAY_BE_KNOWN, NEVER_KNOWN

from thermaltool.units import parse_channel

SEED = 5


def machine(name):
    return PLANTS[name](np.random.default_rng(SEED))


def loads_of(body, steps, heat):
    ones = np.ones(steps)
    return Loads(np.tile(heat, (steps, 1)), np.zeros(steps), ones, ones)


@pytest.mark.parametrize("name", PLANTS)
def test_rest_stays_rest(name):
    body = machine(name).body
    found = simulate(body, 10.0, loads_of(body, 50, np.zeros(body.nodes)))
    np.testing.assert_array_equal(found, 0.0)


@pytest.mark.parametrize("name", PLANTS)
def test_steady_heat_leads_to_the_steady_state(name):
    plant = machine(name)
    body, heat = plant.body, plant.drive.law(np.array([1.0]))[0] * plant.drive.inlet
    steady = body.steady(heat)
    found = simulate(body, 400 * plant.dt, loads_of(body, 200, heat))
    np.testing.assert_allclose(found[-1], steady, rtol=1e-3, atol=1e-6)
    # What goes in goes out by the film: nothing is lost between nodes that exchange heat.
    if name != "chain":
        assert body.film @ steady == pytest.approx(heat.sum(), rel=1e-9)
        assert np.abs(body.exchange.sum(axis=1)).max() < 1e-9 * np.abs(body.exchange).max()


@pytest.mark.parametrize("name", [name for name in PLANTS if name != "chain"])
def test_heat_is_kept(name):
    """What a machine holds is what went in less what went out."""
    plant = machine(name)
    body, dt, steps = plant.body, plant.dt, 400
    heat = plant.drive.law(np.array([1.0]))[0] * plant.drive.inlet
    found = simulate(body, dt, loads_of(body, steps, heat))
    lost = dt * np.sum(0.5 * (found[1:] + found[:-1]) @ body.film)
    held = _stored(body, found) if body.properties else body.capacity @ found[-1]
    assert held + lost == pytest.approx(dt * (steps - 1) * heat.sum(), rel=5e-3)


def _stored(body, found):
    return sum(body.properties(0.5 * (a + b))[0] @ (b - a) for a, b in itertools.pairwise(found))


def test_a_room_that_warms_moves_the_machine_as_much():
    body = machine("rod").body
    air = simulate(body, 1e4, Loads(np.zeros((40, 60)), np.ones(40), np.ones(40), np.ones(40)))
    np.testing.assert_allclose(air[-1], 1.0, rtol=1e-3)


@pytest.mark.parametrize("name", PLANTS)
def test_logs_are_ones_that_the_tool_can_read(name):
    plant = machine(name)
    table = calibration(plant, SEED)
    assert {parse_channel(channel).name for channel in set(table) - {"time_s"}} == set(table) - {
        "time_s"
    }
    assert len({len(values) for values in table.values()}) == 1
    assert all(np.isfinite(values).all() for values in table.values())
    assert np.all(np.diff(table["time_s"]) > 0)
    again = calibration(plant, SEED)
    assert all(np.array_equal(table[channel], again[channel]) for channel in table)


def test_a_thermostat_answers_its_bed():
    plant = machine("printer")
    course = run(plant, draw(plant, np.random.default_rng(1)))
    heat = course.table["Q_bed_W"]
    assert heat.max() == plant.drives[0].largest
    # It commands less as the bed comes near its set point.
    assert len(np.unique(heat)) > 50
    assert ROOM in course.table


def test_copper_that_warms_gives_more_heat_and_radiation_takes_some():
    motor, bonder = machine("motor"), machine("bonder")
    plain = replace(motor, drives=(replace(motor.drive, grows=None),))
    assert 1.05 < _peak(motor) / _peak(plain) < 1.5
    assert 0.7 < _peak(bonder) / _peak(replace(bonder, emissivity=0.0)) < 0.99


def _peak(plant):
    c = draw(plant, np.random.default_rng(2), calibrating=True)
    return run(plant, c).nodes.max()


def test_the_air_of_the_bench_cycles():
    plant = machine("bench")
    c = draw(plant, np.random.default_rng(1))
    turns = np.count_nonzero(np.diff(np.sign(np.diff(c.air))))
    assert 2 * np.ptp(c.time) / 3600 < turns < 2 * np.ptp(c.time) / 900


@pytest.mark.parametrize("kind", KINDS)
def test_no_strength_is_no_effect_and_a_little_is_little(kind):
    plant = machine("spindle" if kind == "part_temperature" else "rod")
    generator = np.random.default_rng(3)
    clean = draw(plant, generator)
    fault = KINDS[kind](Scene(plant, clean, run(plant, clean), generator))
    assert all(np.abs(x).max() < 1e-9 for x in change_of(plant, clean, fault, 0.0).values())
    if kind not in NATURAL:
        change = change_of(plant, clean, fault, min(fault.typical, fault.most))
        assert max(np.ptp(x) for x in change.values()) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_a_size_is_reached(name):
    plant = machine(name)
    residual = {channel: 0.02 if "degC" in channel else 0.5 for channel in plant.outputs}
    found = hide(plant, "sensor_gain", 5.0, SEED, residual)
    assert found.size == pytest.approx(5.0, rel=0.06)
    assert size_of(found.change, residual) == pytest.approx(found.size)
    assert set(found.log) == set(found.validation)


def test_what_is_unknown_is_not_in_the_catalogue():
    from thermaltool.effects import CATALOGUE as TOOL

    assert {name.partition("/")[0] for name in (*CATALOGUE, *NATURAL)} <= set(TOOL)
    assert not set(NEVER_KNOWN) & set(TOOL)
    assert not set(MAY_BE_KNOWN) & set(CATALOGUE)


def test_a_warm_start_is_warm():
    plant = machine("spindle")
    starts = []
    for seed in range(6):
        c = draw(plant, np.random.default_rng(seed))
        course = run(plant, c)
        starts.append((c.time[0] < 0, abs(course.table["T_bearing_degC"][0] - 21.0) > 0.1))
    assert all(warm or not before for before, warm in starts)
    assert {before for before, _ in starts} == {True, False}
    read(plant, c, course, np.random.default_rng(0))
