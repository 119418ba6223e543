"""What causes do, against formulas and integrators of other origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effects.machine import (
    AIR,
    BEARING,
    COLUMN,
    COOLANT,
    FAR,
    FROZEN,
    HEAT,
    NEAR,
    PART,
    PERIOD,
    RESPONSES,
    X,
    Y,
    columns,
    first_order,
    model,
    scene,
)
from scipy.integrate import solve_ivp

from thermaltool.effects import effect_class
from thermaltool.effects.channels import is_air, is_part
from thermaltool.effects.dynamics import play
from thermaltool.effects.effect import STILL
from thermaltool.errors import ModelError
from thermaltool.record import Record

TIME = PERIOD * np.arange(800)


def make(name, channel, /, log=None, partner=None, **parameters):
    return effect_class(name)(channel, parameters, log, None, partner)


def run(effects, drive, **beside):
    given = {HEAT: np.broadcast_to(np.asarray(drive, float), TIME.shape), **beside}
    return model(*effects).simulate(Record(TIME, given, digest="p"))


def stood(plays, u, width):
    """The play operator, row by row."""
    p, result = 0.0, []
    for now in u:
        p = min(max(p, now - width / 2), now + width / 2)
        result.append(p)
    np.testing.assert_allclose(plays, result, rtol=0, atol=1e-15)


# ---------------------------------------------------------------- drive


def test_a_delayed_step_comes_later():
    y = run([make("transport_delay", HEAT, delay=12 * PERIOD)], np.where(TIME >= 100, 0.7, 0.0))
    for output, response in RESPONSES.items():
        expected = 0.7 * response.step(TIME - 100 - 12 * PERIOD)
        np.testing.assert_allclose(y[output], expected, rtol=0, atol=1e-9)


def test_heat_goes_with_the_square():
    y = run([make("drive_nonlinearity", HEAT, exponent=2.0, level=2.0)], 0.5)
    np.testing.assert_allclose(y[X], 2.0 * 0.0625 * RESPONSES[X].step(TIME), atol=1e-9)


@pytest.mark.parametrize("curvature", [-0.4, 0.6])
def test_a_parabola_is_taken_back(curvature):
    effect = make("drive_nonlinearity", HEAT, curvature=curvature, level=2.0)
    u = np.linspace(-2, 2, 41)
    acting = effect.drive(None, u)
    np.testing.assert_allclose(acting[[0, 20, -1]], [-2 - 2 * curvature, 0, 2 + 2 * curvature])
    assert (np.diff(acting) > 0).all()
    np.testing.assert_allclose(effect.undone(acting), u, atol=1e-14)


@pytest.mark.parametrize(
    ("law", "other"), [({"exponent": 1.5}, 1.0), ({"dead_band": 0.2}, 0.5), ({"curvature": 0.6}, 1)]
)
def test_a_law_agrees_with_the_straight_line_where_it_says(law, other):
    u = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    plain = make("drive_nonlinearity", HEAT, level=2.0, **law)
    effect = make("drive_nonlinearity", HEAT, level=2.0, agrees_at=other, **law)
    acting, bent = effect.drive(None, u), plain.drive(None, u)
    np.testing.assert_allclose(acting[u == other], other)
    np.testing.assert_allclose(acting[u == -other], -other)
    # The same law but for a scale; of a parabola, with the same bend.
    scaled = bent * other / bent[u == other]
    moved = u + 0.6 * u * (np.abs(u) - other) / 2.0
    np.testing.assert_allclose(acting, moved if "curvature" in law else scaled, atol=1e-14)
    np.testing.assert_allclose(effect.drive(None, effect.undone(acting)), acting, atol=1e-14)
    assert effect.finer() is None
    assert plain.finer().parameters["agrees_at"] == (0.2 if "curvature" in law else 2.0)


def test_a_saturated_step_is_the_limit_in_both_directions():
    limited = make("actuator_saturation", HEAT, limit=0.8, level=1.5)
    for sign in (1, -1):
        y = run([limited], sign * np.where(TIME < 2000, 1.5, 0.5))
        plain = run([], sign * np.where(TIME < 2000, 0.8, 0.5))
        for output in y:
            np.testing.assert_array_equal(y[output], plain[output])


def test_a_limit_at_the_largest_level_is_none():
    limit = make("actuator_saturation", HEAT, limit=0.8, level=1.5).parameter("limit")
    assert (limit.neutral, limit.high) == (1.5, 1.5)


def test_play_is_its_definition_row_by_row():
    rng = np.random.default_rng(8)
    for rows in (1, 2, 3, 65, 1000):
        u = np.cumsum(rng.normal(size=rows))
        widths = np.array([0.0, 0.3, 2.0, 50.0])
        for plays, width in zip(play(u, widths), widths, strict=True):
            stood(plays, u, width)
    np.testing.assert_array_equal(play(u, np.zeros(1))[0], u)


def triangle(rows, size=1.0):
    return size * np.interp(np.arange(rows) % 200, [0, 50, 150, 200], [0, 1, -1, 0])


def area(u, v):
    """Of a closed loop (one period of the triangle)."""
    return 0.5 * abs(np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v))


def test_backlash_draws_a_parallelogram():
    u = triangle(800)
    signals = Record(TIME, {})
    for width in (0.1, 0.4, 1.0):
        acts = make("backlash", HEAT, width=width).drive(signals, u)
        assert acts.max() == pytest.approx(1 - width / 2)
        assert area(u[400:600], acts[400:600]) == pytest.approx(2 * width * (1 - width / 2))


def test_hysteresis_is_a_loop_at_any_speed_and_its_area_that_of_its_plays():
    signals = Record(TIME, {})
    effect = make("hysteresis", HEAT, width=0.6, share=0.5)
    u = triangle(800)
    acts = effect.drive(signals, u)
    expected = 0.5 * np.mean([2 * w * (1 - w / 2) for w in (0.2, 0.4, 0.6)])
    assert area(u[400:600], acts[400:600]) == pytest.approx(expected)
    assert acts[200:400].max() == pytest.approx(1 - 0.5 * np.mean([0.1, 0.2, 0.3]))
    whole = make("hysteresis", HEAT, width=0.6).drive(signals, u)
    np.testing.assert_allclose(acts, (u + whole) / 2, atol=1e-14)
    slow = effect.drive(signals, np.repeat(u[:400], 2))
    np.testing.assert_allclose(slow[::2], acts[:400], atol=1e-14)
    # Where the drive is zero: on the way up, and on the way down.
    assert acts[400] < 0 < acts[500]


# ---------------------------------------------------------------- state


def test_convection_decays_at_the_sum_of_the_rates_while_it_lasts():
    on = (TIME >= 2500) & (TIME < 3000)
    drive = np.where(TIME < 2000, 1.0, 0.0)
    effect = make("convection_state", COOLANT, rate=1 / 300, level=1.0, idle=0.0)
    y = run([effect], drive, **{COOLANT: on.astype(float)})
    since = np.clip(TIME - 2500, 0, 500)
    plain = run([], drive)
    for output in y:
        expected = plain[output] * np.exp(-since / 300)
        at = TIME >= 2500
        np.testing.assert_allclose(y[output][at], expected[at], rtol=1e-9)
        np.testing.assert_allclose(y[output][~at], plain[output][~at], rtol=1e-9)


def test_convection_by_levels_goes_along_straight_lines():
    speed = np.where(TIME < 2500, 0.0, 1.5)
    table = {"level0": 0.0, "rate0": 0.0, "level1": 1.0, "rate1": 1 / 500, "level2": 2.0}
    effect = make("convection_state", COOLANT, **table, rate2=1 / 250)
    drive = np.where(TIME < 2000, 1.0, 0.0)
    y, plain = run([effect], drive, **{COOLANT: speed}), run([], drive)
    for output in y:
        expected = plain[output] * np.exp(-np.maximum(TIME - 2500, 0) * 0.003)
        np.testing.assert_allclose(y[output], expected, rtol=1e-9)


def test_a_rate_by_levels_goes_on_a_little_beyond_them():
    table = {"level0": 1.0, "rate0": 1e-3, "level1": 3.0, "rate1": 2e-3, "level2": 5.0}
    effect = make("convection_state", COOLANT, **table, rate2=4e-3)
    assert effect.known_range == (1.0, 5.0)
    flow = np.array([0.0, 0.6, 0.8, 1.0, 4.0, 5.0, 5.2, 5.4, 9.0])
    record = Record(np.arange(9.0), {COOLANT: flow})
    # By a tenth of the rate at the end: below it falls by half of what the line would.
    rates = 1e-3 * np.array([0.9, 0.9, 0.9, 1.0, 3.0, 4.0, 4.2, 4.4, 4.4])
    np.testing.assert_allclose(effect.loss(record, {}), rates, rtol=1e-12)
    # A steep end does not make a machine warm by itself.
    steep = {"level0": 1.0, "rate0": 0.0, "level1": 2.0, "rate1": 5e-3, "level2": 10.0}
    effect = make("convection_state", COOLANT, **steep, rate2=-1e-4)
    assert np.min(effect.loss(record, {})) == 0.0
    assert effect.loss(Record(np.arange(2.0), {COOLANT: np.array([10.0, 11.0])}), {})[1] == -1e-4


def watched():
    drive = np.where(TIME < 2000, 1.0, 0.0)
    return scene((TIME, {HEAT: drive, COOLANT: drive, **run([], drive)}))


@pytest.mark.parametrize(("share", "seconds"), [(-0.5, 1.0), (50.0, 1.0), (2.0, 1e-3), (2.0, 1e5)])
def test_a_rate_is_plausible_by_the_time_scale_of_the_machine(share, seconds):
    at = watched()
    scale = seconds / max(at.slowest.values())
    at = replace(
        at,
        logs=tuple(replace(log, time=scale * log.time) for log in at.logs),
        slowest={name: scale * tau for name, tau in at.slowest.items()},
    )
    slowest = max(at.slowest.values())
    fixed = {"level": 1.0, "idle": 0.0}
    assert make("convection_state", COOLANT, rate=share / slowest, **fixed).plausible(at)
    growing = -1.1 / min(at.slowest.values())
    assert not make("convection_state", COOLANT, rate=growing, **fixed).plausible(at)


def test_heat_that_leaves_at_a_place_does_not_warm_it_through_another_mode():
    at = watched()
    (log,) = at.logs
    cooled = replace(log, columns={**log.columns, COOLANT: np.where(log.time > 900, 1.0, 0.0)})
    at = replace(at, logs=(cooled,))

    def loss(**gains):
        own = {f"{lag}[{NEAR}]": gain for lag, gain in gains.items()}
        known = {"time_constant": 50.0, "slowest": 900.0, "level": 1.0, "idle": 0.0}
        return make("convection_state", COOLANT, partner=NEAR, **own, **known)

    assert loss(fast=0.01, middle=-0.05, slow=-0.2).plausible(at)
    assert not loss(fast=0.2, middle=-0.3, slow=0.0).plausible(at)
    assert not loss(fast=-0.1, middle=0.3, slow=-0.25).plausible(at)


def test_a_speed_may_cool_while_it_turns_or_while_it_stands():
    probes = effect_class("convection_state").probes(watched())
    uniform = [e for e in probes if e.partner is None]
    assert {(e.channel, e.parameters["idle"]) for e in uniform} >= {(HEAT, 0.0), (HEAT, 1.0)}


def radiating(rate, a, gain, rest):
    """One body: its own loss at rest, the radiative part of it by Stefan and Boltzmann."""
    cold = rest + 273.15

    def slope(t, y):
        radiated = rate * ((cold + y) ** 4 - cold**4) / (4 * cold**3)
        return a * gain * (t < 2000) - (a - rate) * y - radiated

    return solve_ivp(slope, (0, TIME[-1]), [0.0], t_eval=TIME, rtol=1e-9, max_step=20).y[0]


@pytest.mark.parametrize("logged", [False, True])
def test_radiation_is_that_of_stefan_and_boltzmann(logged):
    a, gain, rate, rest = 1 / 600, 200.0, 1 / 1500, 21.5
    expected = radiating(rate, a, gain, rest)
    plain = run([], np.where(TIME < 2000, 5.0, 0.0))[COLUMN]
    if logged:
        effect = make("radiation", "T_core_degC", rate=rate)
        beside = {"T_core_degC": rest + expected}
        assert effect.needs() == ("T_core_degC",)
    else:
        effect, beside = make("radiation", COLUMN, rate=rate, rest=rest), {}
        assert effect.needs() == ()
    y = run([effect], np.where(TIME < 2000, 5.0, 0.0), **beside)[COLUMN]
    # Held over a sample, the loss is late by half of one.
    np.testing.assert_allclose(y, expected, rtol=0, atol=2e-3 * expected.max())
    assert np.ptp(plain - expected) > 0.1 * expected.max()


def test_radiation_looks_at_the_hottest_absolute_temperature_from_its_rest():
    effect = next(effect_class("radiation").probes(scene(columns())))
    assert effect.channel == COLUMN
    assert effect.parameters["rest"] == pytest.approx(21.5)
    pairs = replace(scene(columns()), outputs=(FAR, NEAR, X))
    effect = next(effect_class("radiation").probes(pairs))
    assert (effect.channel, effect.parameters["rest"]) == (NEAR, 20.0)
    cores = {"T_bed_degC": 20 + TIME / 400, "T_core_degC": 20 + TIME / 40, AIR: 20 + TIME}
    logged = replace(
        pairs,
        extra=tuple(cores),
        logs=(Record(TIME, {**pairs.logs[0].columns, **cores}, digest="p"),),
    )
    effect = next(effect_class("radiation").probes(logged))
    assert effect.channel == "T_core_degC"
    assert "rest" not in effect.parameters
    effect = make("radiation", COLUMN, rate=1e-3, rest=20.0)
    with pytest.raises(ModelError, match=COLUMN):
        effect.loss(Record(TIME, {}), {NEAR: TIME})


def stored(capacity, a, gain, duty):
    """c(y)·y' = a·(gain·u − y), by an integrator of steps that end where the duty changes."""

    def slope(t, y, u):
        return a * (gain * u - y) / capacity(y)

    y, found = np.zeros(1), [0.0]
    for k in range(len(TIME) - 1):
        step = solve_ivp(slope, TIME[k : k + 2], y, args=(duty[k],), rtol=1e-8, atol=1e-9)
        y = step.y[:, -1]
        found.append(float(y[0]))
    return np.array(found)


@pytest.mark.parametrize("rise", [0.4, -0.3])
def test_a_hot_machine_stores_more_heat(rise):
    duty = np.repeat([0.0, 1.0, 0.3, 0.6, 0.0, 0.8, 0.2, 0.5], len(TIME) // 8)
    expected = stored(lambda y: 1 + rise * y / 40, 1 / 600, 40.0, duty)
    plain = run([], duty)[COLUMN]
    y = run([make("heat_capacity", COLUMN, rise=rise, level=40.0)], duty)[COLUMN]
    # Held over a sample, the capacity is late by half of one.
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-3 * expected.max())
    assert np.ptp(plain - expected) > 0.05 * expected.max()


def test_what_melts_holds_the_temperature():
    duty = np.where(TIME < 2000, 1.0, 0.0)
    heat, at, width, rest = 6.0, 40.0, 1.5, 21.5

    def capacity(y):
        return 1 + heat / (2 * width) / np.cosh((rest + y - at) / width) ** 2

    expected = stored(capacity, 1 / 600, 40.0, duty)
    plain = run([], duty)[COLUMN]
    effect = make("latent_heat", COLUMN, heat=heat, at=at, width=width, rest=rest)
    y = run([effect], duty)[COLUMN]
    np.testing.assert_allclose(y, expected, rtol=0, atol=2e-3 * expected.max())
    assert np.ptp(plain - expected) > 0.05 * expected.max()
    # Warming up by as much as is molten takes as much longer.
    late = np.interp(30.0, expected[TIME < 2000], TIME[TIME < 2000]) - np.interp(
        30.0, plain[TIME < 2000], TIME[TIME < 2000]
    )
    power = (40.0 - (at - rest)) / 600
    assert late == pytest.approx(heat / power, rel=0.05)


def test_no_solid_changes_so_much():
    place = scene(columns())
    effect = next(effect_class("heat_capacity").probes(place))
    assert effect.channel == COLUMN
    level = effect.parameters["level"]
    assert effect.changed({"rise": 0.004 * level}).plausible(place)
    assert not effect.changed({"rise": 0.006 * level}).plausible(place)
    bent = next(effect_class("conductivity").probes(place))
    name = f"curvature[{COLUMN}]"
    assert bent.channel == COLUMN
    assert bent.changed({name: 0.0024}).plausible(place)
    assert not bent.changed({name: 0.0026}).plausible(place)
    cold = make("radiation", COLUMN, rate=1e-3, rest=-554.0)
    assert not cold.plausible(place)


def test_a_material_that_conducts_better_when_it_is_hot():
    """Cells between a heated face and one that is held: the steady flux is that of the whole."""
    cells, beta = 400, 5e-4
    edges = np.zeros(cells + 1)
    for k in range(cells, 0, -1):  # from the held face on, k (T) taken between two cells
        flux = 40.0 / cells
        step = flux
        for _ in range(50):
            step = flux / (1 + beta * (edges[k] + step / 2))
        edges[k - 1] = edges[k] + step
    linear = 40.0 * (1 - np.arange(cells + 1) / cells)
    for depth in (0, cells // 4, cells // 2):
        share = linear[depth] / 40.0
        effect = make("conductivity", COLUMN, **{f"curvature[{COLUMN}]": -beta / 2})
        bent = effect.output(COLUMN, {COLUMN: np.array([linear[depth]])}, STILL)
        assert edges[depth] == pytest.approx(bent[0], abs=beta**2 * linear[depth] ** 3)
        assert abs(linear[depth] - edges[depth]) > 0.2 * share**2


# ---------------------------------------------------------------- sources


def test_a_second_source_is_another_first_order_response():
    bearing = np.where(TIME >= 500, 0.6, 0.0)
    logged = make(
        "second_source", BEARING, time_constant=350.0, **{f"gain[{X}]": 4.0, f"gain[{FAR}]": -1.0}
    )
    y = run([logged], 0.0, **{BEARING: bearing})
    expected = 0.6 * first_order(4.0, 1 / 350).step(TIME - 500)
    np.testing.assert_allclose(y[X], expected, atol=1e-9)
    np.testing.assert_allclose(y[FAR], -expected / 4, atol=1e-9)
    latent = make(
        "second_source",
        "",
        "p",
        start=500.0,
        time_constant=350.0,
        **{f"gain[{X}]": 0.6 * 4.0, f"gain[{FAR}]": -0.6},
    )
    hidden = run([latent], 0.0)
    for output in y:
        np.testing.assert_allclose(hidden[output], y[output], atol=1e-9)
    assert (logged.unit(f"gain[{X}]"), latent.unit(f"gain[{X}]")) == ("um/1", "um")


@pytest.mark.parametrize(("rest", "share"), [(None, 1.0), (0.6, 0.0), (0.9, -0.5)])
def test_a_power_that_is_on_as_a_log_begins_heats_from_there(rest, share):
    own = {f"gain[{X}]": 4.0} | ({} if rest is None else {"rest": rest})
    source = make("second_source", BEARING, time_constant=350.0, **own)
    y = run([source], 0.0, **{BEARING: np.full(len(TIME), 0.6)})
    expected = share * 0.6 * first_order(4.0, 1 / 350).step(TIME)
    np.testing.assert_allclose(y[X], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("course", "rests"),
    [
        (np.where(TIME < 500, 0.0, 2.0), {None}),
        (np.where(TIME < 500, 2.0, 0.0), {None, 2.0}),
        # From 0 these would be a start of the log.
        (np.where(TIME < 500, 2.0, 2.02), {2.0}),
        (np.full(len(TIME), 2.0), set()),
        # One reading that is off is no level.
        (np.where(TIME[0] == TIME, 9.0, np.where(TIME < 500, 2.0, 0.0)), {None, 2.0}),
    ],
)
def test_a_source_is_tried_from_0_and_from_where_it_stands(course, rests):
    own = {BEARING: course}
    trials = effect_class("second_source").probes(scene((TIME, {HEAT: np.ones(len(TIME)), **own,
                                                                **run([], 1.0)})))  # fmt: skip
    assert {e.parameters.get("rest") for e in trials if e.channel == BEARING} == rests


def test_a_source_that_is_not_read_yet_does_nothing():
    pump = np.where(TIME < 300, np.nan, 1.0)
    source = make("second_source", BEARING, time_constant=350.0, **{f"gain[{X}]": 4.0})
    y = run([source], 0.0, **{BEARING: pump})[X]
    np.testing.assert_array_equal(y[TIME < 300], 0.0)
    np.testing.assert_allclose(y, first_order(4.0, 1 / 350).step(TIME - 300), atol=1e-9)


def test_a_temperature_warms_by_its_changes_alone():
    source = make("second_source", "T_lid_degC", time_constant=350.0, **{f"gain[{X}]": 4.0})
    y = run([source], 0.0, T_lid_degC=np.full(len(TIME), 31.0))
    np.testing.assert_array_equal(y[X], 0.0)


def test_the_structure_follows_a_daily_swing_of_the_air_smaller_and_later():
    tau, omega, gain = 400.0, 2 * np.pi / 1200, 3.0
    air = 20 + 2 * np.sin(omega * TIME)
    y = run([make("ambient_drift", AIR, time_constant=tau, **{f"gain[{Y}]": gain})], 0.0,
            **{AIR: air})[Y]  # fmt: skip
    late = np.arctan(omega * tau)
    expected = 2 * gain * np.cos(late) * np.sin(omega * TIME - late)
    settled = 8 * tau < TIME
    # The air runs on in straight lines between samples.
    np.testing.assert_allclose(y[settled], expected[settled], atol=2e-3)


def test_without_a_logged_air_all_outputs_swing_together_from_rest():
    swing = make("ambient_drift", "", "p", period=8000.0, phase=0.5,
                 **{f"swing[{X}]": 3.0, f"swing[{COLUMN}]": -0.5})  # fmt: skip
    y = run([swing], 0.0)
    np.testing.assert_allclose(y[X], -6 * y[COLUMN], atol=1e-12)
    assert y[X][0] == 0
    # Two derivatives bring a sine back.
    middle = y[X][1:-1] + 3 * np.sin(0.5)
    bend = np.diff(y[X], 2) / PERIOD**2
    np.testing.assert_allclose(bend, -((2 * np.pi / 8000) ** 2) * middle, atol=1e-9)


def test_a_swing_is_tried_only_where_no_log_holds_the_air():
    with_air = effect_class("ambient_drift").probes(scene(columns()))
    assert {e.channel for e in with_air} == {AIR}
    without = list(effect_class("ambient_drift").probes(scene(columns(extra=(BEARING,)))))
    assert without
    assert {e.channel for e in without} == {""}


def test_a_part_grows_by_its_expansion():
    # 300 mm of steel, 11.5e-6 per kelvin
    part = 22 + TIME / 1000
    y = run([make("part_temperature", PART, **{f"coefficient[{X}]": 0.3e6 * 11.5e-6})], 0.0,
            **{PART: part})  # fmt: skip
    np.testing.assert_allclose(y[X], 3.45 * (part - 22), atol=1e-12)
    assert not np.any(y[Y])


def test_channels_go_to_the_cause_that_their_name_says():
    air = ["T_ambient_degC", "T_room2_degC", "T_lab_air_degC", "dT_Hall_K"]
    other = ["dT_pair1_K", "T_chamber_degC", "T_label_degC", "n_air_rpm", "T_bed_degC", "T_degC"]
    assert all(map(is_air, air))
    assert not any(map(is_air, [*other, "T_part_degC"]))
    assert is_part("T_workpiece_degC")
    assert is_part("T_part1_degC")
    assert not any(map(is_part, [*other, *air, "Q_part_W", "T_apart_degC"]))
    seen = scene(columns())
    for name, channel in {
        "ambient_drift": {AIR},
        "part_temperature": {PART},
        "second_source": {BEARING, COOLANT, ""},
    }.items():
        assert {e.channel for e in effect_class(name).probes(seen)} == channel


# ---------------------------------------------------------------- structure and sensors


def test_a_joint_has_another_slope_each_way_and_bends():
    y = np.array([-20.0, -10.0, 0.0, 10.0, 20.0])
    signals = Record(np.arange(5.0), {})
    slopes = make("joint_contact", X, asymmetry=0.2)
    np.testing.assert_allclose(slopes.output(X, {X: y}, signals), [-16, -8, 0, 12, 24])
    bent = make("joint_contact", X, curvature=0.01).output(X, {X: y}, signals)
    np.testing.assert_allclose(bent, [-24, -11, 0, 11, 24])


def test_a_joint_that_is_moved_one_way_alone_has_no_asymmetry_to_try():
    both, one = (
        {
            tuple(e.parameters)
            for e in effect_class("joint_contact").probes(scene(columns(bipolar=bipolar)))
            if not e.spreads
        }
        for bipolar in (True, False)
    )
    assert both == {("curvature",), ("asymmetry",), ("curvature", "asymmetry")}
    assert one == {("curvature",)}


def test_a_joint_bends_outputs_together_by_what_the_linear_model_has_near_the_source():
    log = scene(columns()).logs[0]
    given = {f"forces[{X}]": 4.0, "heat[T_column_degC]": -2.0, "time_constant": 400.0}
    joint = make("joint_contact", NEAR, "p", level=10.0, **given)
    plain, y = model().simulate(log), model(joint).simulate(log)
    b = plain[NEAR] * np.abs(plain[NEAR]) / 100.0
    np.testing.assert_allclose(y[X] - plain[X], 4.0 * b, atol=1e-9)
    step = np.diff(log.time)[0]
    late = y["T_column_degC"] - plain["T_column_degC"]
    # τ y' + y = u, in the middle of a sample.
    rate, middle = np.diff(late) / step, (late[1:] + late[:-1]) / 2
    np.testing.assert_allclose(400.0 * rate + middle, -(b[1:] + b[:-1]), atol=2e-3 * np.ptp(late))
    assert np.array_equal(y[NEAR], plain[NEAR])


def test_a_joint_tells_its_heat_by_the_contact_temperature_that_is_read():
    log = scene(columns()).logs[0]
    linear = model().simulate(log)
    read = 21.5 + linear["T_column_degC"] - 3.0 * (log.time > 1000.0)
    told = log.with_columns({"T_column_degC": read})
    joint = effect_class("joint_contact")(
        NEAR, {f"deviation[{Y}]": 2.0, "time_constant": 1e-3, "level": 10.0}, None, None,
        "T_column_degC",
    )  # fmt: skip
    assert joint.needs() == ("T_column_degC",)
    moved = model(joint).simulate(told)[Y] - linear[Y]
    late = log.time > 1000.0 + 2 * log.period
    np.testing.assert_allclose(moved[late], -6.0, atol=1e-6)
    np.testing.assert_allclose(moved[log.time < 1000.0], 0.0, atol=1e-6)
    at_once = effect_class("joint_contact")(
        NEAR, {f"contact[{Y}]": 2.0, "level": 10.0}, None, None, "T_column_degC"
    )
    moved = model(at_once).simulate(told)[Y] - linear[Y]
    np.testing.assert_allclose(moved, -6.0 * (log.time > 1000.0), atol=1e-9)


def test_displacements_jump_together_at_one_time():
    step = make("geometry_step", X, "p", time=1000.0, **{f"step[{X}]": 12.0, f"step[{Y}]": -7.0})
    y, plain = run([step], 1.0), run([], 1.0)
    for output, size in {X: 12.0, Y: -7.0, NEAR: 0.0}.items():
        np.testing.assert_allclose(y[output] - plain[output], size * (TIME >= 1000), atol=1e-12)


@pytest.mark.parametrize("at", [97, 402, 640])
def test_a_jump_is_tried_at_its_own_sample(at):
    rng = np.random.default_rng(at)
    time, given = columns()
    wander = np.cumsum(rng.normal(size=len(time))) * 0.01
    for output, size in {X: 0.25, Y: -0.2}.items():
        given[output] = given[output] + wander + size * (np.arange(len(time)) >= at)
        given[output][[5, at - 3, at + 2, 700]] = np.nan
    tried = list(effect_class("geometry_step").probes(scene((time, given))))
    assert time[at] in [e.parameters["time"] for e in tried]
    assert np.max(np.diff(sorted(e.parameters["time"] for e in tried))) < 0.05 * time[-1]


def test_a_jump_is_not_looked_for_where_nothing_is_measured():
    time, given = columns()
    given[X][:] = np.nan
    given[Y][3:] = np.nan
    for effect in effect_class("geometry_step").probes(scene((time, given))):
        assert time[0] < effect.parameters["time"] < time[-1]


def test_a_lag_makes_two_poles():
    drive = np.ones(800)
    y = run([make("sensor_lag", NEAR, time_constant=80.0)], drive)[NEAR]
    a, b, gain = 1 / 200, 1 / 80, 20.0
    expected = gain * (1 - (b * np.exp(-a * TIME) - a * np.exp(-b * TIME)) / (b - a))
    # Straight lines between samples.
    np.testing.assert_allclose(y, expected, atol=gain * (a * PERIOD) ** 2 / 8)


def test_a_sensor_drifts_by_its_rate_in_an_hour():
    late = TIME + 500
    y = effect_class("sensor_drift")(NEAR, {"rate": 0.9}).output(
        NEAR, {NEAR: np.zeros(800)}, Record(late, {})
    )
    assert y[0] == 0
    assert y[np.searchsorted(late, 500 + 3600)] == pytest.approx(0.9)


def test_a_thermistor_read_with_another_ones_constants_is_gain_and_curvature():
    """β law: R = R25 exp(β(1/T − 1/298.15)), read with a β that is 4 % too small."""
    truth = np.linspace(0, 30, 61)
    rest, beta, wrong = 293.15, 3950.0, 3800.0
    log_r = beta * (1 / (rest + truth) - 1 / 298.15)
    reading = 1 / (log_r / wrong + 1 / 298.15)
    reading = reading - reading[0]
    fit = np.linalg.lstsq(np.column_stack([truth, truth**2]), reading, rcond=None)[0]
    effect = make("sensor_conversion", NEAR, gain=float(fit[0]), curvature=float(fit[1]))
    got = effect.output(NEAR, {NEAR: truth}, Record(truth, {}))
    error = np.max(np.abs(reading - truth))
    assert error > 0.5
    assert np.max(np.abs(got - reading)) < 0.005 * error


def test_a_frozen_sensor_repeats_the_reading_at_its_start():
    y, plain = run([make("sensor_frozen", FAR, "p", start=300.0, stop=900.0)], 1.0), run([], 1.0)
    still = (TIME >= 300) & (TIME < 900)
    np.testing.assert_array_equal(y[FAR][still], plain[FAR][60])
    np.testing.assert_array_equal(y[FAR][~still], plain[FAR][~still])
    never = run([make("sensor_frozen", FAR, "p", start=1e6)], 1.0)
    np.testing.assert_array_equal(never[FAR], plain[FAR])


def test_a_frozen_sensor_is_looked_for_where_a_reading_repeats_itself_and_nowhere_else():
    time, given = columns()
    found = list(effect_class("sensor_frozen").probes(scene((time, given))))
    place = {"start": time[FROZEN.start], "stop": time[FROZEN.stop]}
    assert [(e.channel, e.log, e.parameters) for e in found] == [(FAR, "p", place)]
    # To the end, with gaps.
    given[FAR][FROZEN.start :] = given[FAR][FROZEN.start]
    given[FAR][::7] = np.nan
    (found,) = effect_class("sensor_frozen").probes(scene((time, given)))
    assert found.parameters == {"start": time[FROZEN.start]}


@pytest.mark.parametrize("what", ["coarse", "settled"])
def test_equal_readings_are_not_always_a_fault(what):
    time, given = columns()
    given[FAR] = 4 + model().simulate(Record(time, given))[FAR]
    if what == "coarse":  # a step of 0.5 K repeats itself everywhere
        given[FAR] = np.round(given[FAR] * 2) / 2
    else:  # idle, at rest, and read to 0.1 K
        given[HEAT][:100] = 0
        given[FAR] = 4 + model().simulate(Record(time, given))[FAR]
        given[FAR][:100] = 4.0
    assert not list(effect_class("sensor_frozen").probes(scene((time, given))))


def test_swapped_sensors_read_each_other():
    swap = make("sensors_swapped", NEAR, partner=FAR)
    y, plain = run([swap], 1.0), run([], 1.0)
    np.testing.assert_array_equal(y[NEAR], plain[FAR])
    np.testing.assert_array_equal(y[FAR], plain[NEAR])
    pairs = {(e.channel, e.partner) for e in effect_class("sensors_swapped").probes(
        scene(columns()))}  # fmt: skip
    assert pairs == {(NEAR, FAR), (X, Y)}
    alone = model(swap, outputs=(NEAR,))
    with pytest.raises(ModelError, match=FAR):
        alone.simulate(Record(TIME, {HEAT: np.ones(800)}))


@pytest.mark.parametrize("period", [23.7, 61.0, 310.0, 640.0, 1500.0])
def test_a_line_in_the_residual_is_found_between_the_slow_misfit(period):
    rng = np.random.default_rng(4)
    time, given = columns(frozen=False)
    slow = np.cumsum(rng.normal(size=len(time))) * 0.004
    given[NEAR] = given[NEAR] + 0.08 * np.sin(2 * np.pi * time / period + 1) + slow
    given[NEAR][[0, 1, 200, 201, 600]] = np.nan
    found = list(effect_class("periodic").probes(scene((time, given))))
    duration = time[-1]
    misses = [abs(1 / e.parameters["period"] - 1 / period) * duration for e in found]
    nearest = found[int(np.argmin(misses))]
    # Less than half a cycle in the record: one search goes on from there.
    assert min(misses) < 0.45
    assert nearest.channel == NEAR
    values = {n: nearest.parameters[n] for n in (f"sine[{NEAR}]", f"cosine[{NEAR}]")}
    assert values == {f"sine[{NEAR}]": 1.0, f"cosine[{NEAR}]": 1.0}


def test_a_sine_has_its_period_and_counts_from_zero():
    effect = make("periodic", NEAR, "p", period=600.0, **{f"sine[{NEAR}]": 3.0,
                                                          f"cosine[{NEAR}]": 4.0})  # fmt: skip
    y = run([effect], 0.0)[NEAR]
    assert y[0] == pytest.approx(4.0)
    assert y[30] == pytest.approx(3.0)
    np.testing.assert_allclose(y[120:], y[:-120], atol=1e-12)
    assert np.max(np.abs(y)) == pytest.approx(5.0, rel=1e-3)


def test_a_jump_is_seen_from_both_sides():
    place = scene(columns())
    log = place.logs[0]

    def jump(time):
        return make("sensor_offset_step", COLUMN, log=log.digest, step=1.0, time=time)

    for row in (3, 400, len(log) - 3):
        assert jump(log.time[row]).plausible(place)
    for row in (0, 2, len(log) - 2):
        assert not jump(log.time[row]).plausible(place)


def test_nothing_warms_more_than_what_warms_it():
    place = scene(columns())

    def lid(gain):
        return make("second_source", "T_lid_degC", time_constant=900.0, **{f"gain[{COLUMN}]": gain})

    assert lid(0.8).plausible(place)
    assert not lid(-7.6).plausible(place)
    lamp = make("second_source", "Q_lamp_W", time_constant=900.0, **{f"gain[{COLUMN}]": 7.6})
    assert lamp.plausible(place)


def test_air_does_not_bend_a_machine_far_more_than_its_own_heat_does():
    # On a log too short for a deflection beside sensors that are quicker, and without these.
    time, values = columns()
    short = scene((time[:40], {c: v[:40] for c, v in values.items()}))
    for place in (scene((time, values)), short, replace(short, outputs=(Y,))):

        def follows(gain, place=place):
            found = make("ambient_drift", AIR, time_constant=50.0, **{f"gain[{Y}]": gain})
            return found.plausible(place)

        assert follows(9.0 * 100.0 / 40.0)  # um/K
        assert not follows(-11.0 * 100.0 / 40.0)
    # Of temperatures that nobody measures nothing is known.
    assert make("ambient_drift", AIR, time_constant=50.0, **{f"gain[{Y}]": 1e3}).plausible(
        replace(short, spans={Y: 100.0})
    )
