"""A model row by row gives what it gives of the whole record: every kind, every effect."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from effects.machine import AIR, BEARING, COLUMN, FAR, HEAT, NEAR, PERIOD, X, Y, columns, scene
from effects.machine import model as machine
from effects.test_every_effect import variants

from thermaltool.effects import CATALOGUE, NO_CAUSES, effect_class
from thermaltool.effects.curve import DriveCurve, OutputCurve
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, ModelRecursion, Output, Term, drive_rests
from thermaltool.model.combine import scheduled
from thermaltool.record import Record
from thermaltool.responses import KINDS, MORE_RATIONAL, response_class
from thermaltool.responses.deflection import Deflection
from thermaltool.responses.rational import Rational1, Rational2

DIGEST = "p"
OUTPUT = Output("d_x_um", "deflection", "first", (-100.0, 100.0))
RNG = np.random.default_rng(11)
EVEN = PERIOD * np.arange(160)
UNEVEN = np.cumsum(RNG.choice([0.5, 1.7, 20.0, 400.0], 160))
COURSE = RNG.standard_normal(160)


@cache
def log():
    """A log of the small machine, and what a row of it holds beside the drive."""
    time, given = columns(3)
    return Record(time, given, digest=DIGEST)


def rows(record):
    return (
        (float(t), {name: float(values[k]) for name, values in record.columns.items()})
        for k, t in enumerate(record.time)
    )


def streamed(model, record, restart=None):
    """Outputs row by row; the recursion is written down and read again at row `restart`."""
    shortest = float(np.min(np.diff(record.time)))
    # A stream knows no more than the first value of a drive; a whole record knows its level.
    rests = drive_rests(model, record)
    recursion, found = ModelRecursion(model, record.digest, shortest, rests=rests), []
    for k, (time, row) in enumerate(rows(record)):
        if k == restart:
            kept = json.loads(json.dumps(recursion.state()))
            recursion = ModelRecursion(model, record.digest, shortest, rests=rests)
            recursion.resume(kept)
        found.append(recursion.step(time, row) if k else recursion.start(time, row))
    return {name: np.array([each[name] for each in found]) for name in found[0]}


# Of a sum of modes that cancel, relative to their weights.
ROUNDING = 1e-13
# A loss or a pace that depends on the outputs: over a whole record its integral is repeated until
# it changes by less than 1e-6; row by row it is what it is.
BY_REPETITION = 1e-6


def check(model, record, restart=100):
    by_outputs = any(e.side == "state" and not e.needs() for e in model.effects)
    tolerance = BY_REPETITION if by_outputs else 1e-9
    batch, stream = model.simulate(record), streamed(model, record, restart)
    assert stream.keys() == batch.keys()
    for name, values in batch.items():
        assert np.ptp(values) > 0
        terms = [t.response.modes(PERIOD) for t in model.terms if t.output == name]
        rounding = ROUNDING * sum(np.abs(modes.weights).sum() for modes in terms)
        allowed = tolerance * np.ptp(values) + rounding
        np.testing.assert_allclose(stream[name], values, rtol=0, atol=allowed)
    return stream


def one_term(response, hold, reference=0.0):
    drive = Drive(HEAT, hold, reference, (-1.0, 1.0))
    return Model((drive,), (OUTPUT,), (Term(HEAT, OUTPUT.channel, response),), PERIOD)


@cache
def responses(kind):
    cls = response_class(kind)
    starts = cls.starts(PERIOD, 8000.0, **cls.fixed)
    gains = dict(zip(cls.gains, itertools.cycle((3.5, -1.2, 0.4, -0.2, 0.7, 0.3))))
    plain = [
        cls(**dict(zip(cls.searched, starts[k], strict=True)), **gains, **cls.fixed)
        for k in (0, len(starts) // 2, -1)
    ]
    delays = (2.5, 37.0, 600.0) if "delay" in cls.fixed else ()
    return [*plain, *(replace(plain[1], delay=delay) for delay in delays)]


@pytest.mark.parametrize("kind", [*KINDS, *MORE_RATIONAL])
@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("time", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_every_kind(kind, hold, time):
    for response in responses(kind):
        check(one_term(response, hold), Record(time, {HEAT: COURSE}))


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_on_every_hold(name):
    """None of the catalogue is left out: each has a causal step."""
    # What the diagnosis finds by itself acts on nothing: it leaves the outputs as they are.
    bare = [effect_class(name)(NEAR, dict.fromkeys(effect_class(name).known, 0.5), DIGEST)]
    for effect in variants(name) or bare:
        for hold in ("zero", "first"):
            check(machine(effect, hold=hold), log(), restart=450)


def effect(name, channel, log=None, **parameters):
    return effect_class(name)(channel, parameters, log)


CURVE = {"level": 60.0, "c1": 0.3, "c2": 0.7}
BESIDE = [
    DriveCurve(HEAT, {**CURVE, "level": 1.0}),
    OutputCurve(X, CURVE),
    effect("natural_convection", COLUMN, rate=5e-4, level=30.0),
]


@pytest.mark.parametrize("beside", BESIDE, ids=lambda effect: effect.name)
def test_every_effect_that_is_no_cause(beside):
    check(machine(beside), log())


def test_none_that_is_no_cause_is_left_out():
    assert {each.name for each in BESIDE} == set(NO_CAUSES)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in CATALOGUE if effect_class(n).side != "wiring"])
def test_rows_missing_beside_the_drives(name):
    holed = {c: v.copy() for c, v in log().columns.items()}
    for channel in (AIR, BEARING, "T_part_degC", "x_coolant_1"):
        holed[channel][[0, 1, 300, 301, -1]] = np.nan
    for effect in variants(name):
        check(machine(effect), Record(log().time, holed, digest=DIGEST), restart=301)


LAGS = {"time_constant": 200.0, "slowest": 2000.0}
# A little of everything at once, on a machine with delays, a schedule and drives that count from
# their first value.
ALL = (
    effect("transport_delay", HEAT, delay=13.0),
    effect("hysteresis", HEAT, width=0.4, share=0.7),
    effect("drive_nonlinearity", HEAT, exponent=1.4, level=1.0),
    effect("backlash", BEARING, width=0.3),
    effect("convection_state", "x_coolant_1", rate=1e-3, level=1.0, idle=0.0),
    effect_class("convection_state")(
        "x_coolant_1",
        {f"fast[{NEAR}]": -0.2, f"slow[{NEAR}]": -0.1, f"slow[{X}]": 0.3, "level": 1.0, **LAGS},
        partner=NEAR,
    ),
    effect_class("switching_loss")(
        COLUMN,
        {f"fast[{COLUMN}]": -0.2, f"slow[{X}]": 0.3, "on": 23.0, "off": 22.0, **LAGS},
        partner=COLUMN,
    ),
    effect("radiation", COLUMN, rate=2e-4, rest=21.5),
    effect("radiation", AIR, rate=2e-4),
    effect("heat_capacity", COLUMN, rise=0.2, level=30.0),
    effect("latent_heat", COLUMN, heat=3.0, at=30.0, width=4.0, rest=21.5),
    effect("ambient_drift", AIR, time_constant=700.0, **{f"gain[{X}]": 2.0, f"gain[{FAR}]": 0.1}),
    effect("periodic", "", DIGEST, period=900.0, **{f"sine[{Y}]": 3.0, f"cosine[{Y}]": -1.0}),
    effect("joint_contact", Y, curvature=0.01, asymmetry=0.2),
    effect("sensor_conversion", NEAR, gain=1.1, curvature=0.01),
    effect("sensor_lag", NEAR, time_constant=40.0),
    effect("sensor_drift", FAR, rate=0.5),
    effect("sensor_frozen", FAR, DIGEST, start=1000.0, stop=1800.0),
    effect_class("sensors_swapped")(NEAR, {}, partner=FAR),
)


def everything(hold="zero"):
    drives = Drive(HEAT, hold, 0.0, (0.0, 1.0)), Drive(BEARING, "zero", "first", (0.0, 1.0))
    small = machine(*ALL)
    late = Rational2(8.0, 300.0, -3.0, 1200.0, delay=171.3)
    extra = [Term(BEARING, o, late) for o in (X, NEAR)]
    return replace(small, drives=drives, terms=(*small.terms, *extra))


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_all_at_once(hold):
    check(everything(hold), log(), restart=555)


@pytest.mark.slow
def test_effects_of_another_record_do_not_act():
    elsewhere = Record(log().time, log().columns, digest="another")
    here, there = streamed(everything(), log()), check(everything(), elsewhere)
    assert np.ptp(here[NEAR] - there[NEAR]) > 0.1


def test_a_schedule():
    levels = [one_term(Rational1(gain, tau), "zero") for gain, tau in ((2.0, 300.0), (5.0, 90.0))]
    by_heat = scheduled(levels, HEAT, [0.3, 0.9])
    check(by_heat, log())
    by_air = scheduled(levels, AIR, [19.0, 21.0])
    check(by_air, log())


def test_a_loss_that_goes_on_for_ever_is_followed():
    """Beyond e^700: what is stored is scaled on the way."""
    time = PERIOD * np.arange(9_000)
    heat = (np.sin(time / 900.0) > 0).astype(float)
    late = Rational2(8.0, 300.0, -3.0, 1200.0, delay=171.3)
    model = replace(
        one_term(late, "zero"),
        effects=(effect("convection_state", AIR, rate=2e-2, level=1.0, idle=0.0),),
    )
    always = Record(time, {HEAT: heat, AIR: np.ones(len(time))})
    faster = [Rational1(8.0, 300.0), Rational1(-3.0, 1200.0)]
    rates = [1 / each.tau1 + 2e-2 for each in faster]
    # Every mode decays faster; what enters the dead time decays by as much on its way.
    plain = [
        Rational1(e.K1 / e.tau1 / r * np.exp(-2e-2 * 171.3), 1 / r, delay=171.3)
        for e, r in zip(faster, rates, strict=True)
    ]
    linear = replace(
        one_term(plain[0], "zero"), terms=tuple(Term(HEAT, OUTPUT.channel, r) for r in plain)
    )
    expected = linear.simulate(Record(time, {HEAT: heat}))[OUTPUT.channel]
    got = streamed(model, always, restart=8_000)[OUTPUT.channel]
    # Within a sample a held drive acts, on the mean, in its middle.
    np.testing.assert_allclose(got, expected, rtol=0, atol=2e-3 * np.ptp(expected))


def test_outputs_can_be_chosen():
    whole, part = everything(), replace(machine(), effects=())
    assert streamed(part, log()).keys() == {o.channel for o in whole.outputs}
    some = ModelRecursion(part, DIGEST, outputs=[X])
    assert some.start(*next(rows(log()))).keys() == {X}
    assert len(some.responses) == 1


def test_a_state_that_is_kept_is_not_moved_by_later_rows():
    lags = {f"gain[{X}]": 2.0, f"slow_gain[{X}]": 0.7}
    taus = {"time_constant": 60.0, "slow_time_constant": 900.0}
    model = machine(effect_class("second_source")(BEARING, {**lags, **taus}))
    recursion, every = model.recursion(DIGEST), list(rows(log()))
    recursion.start(*every[0])
    for row in every[1:200]:
        recursion.step(*row)
    kept = recursion.state()
    first = [recursion.step(*row)[X] for row in every[200:400]]
    for _ in range(2):
        recursion.resume(kept)
        assert [recursion.step(*row)[X] for row in every[200:400]] == first


def test_the_steady_state_and_what_comes():
    model = one_term(Rational2(3.0, 100.0, 1.0, 900.0, delay=40.0), "zero")
    recursion = ModelRecursion(model, horizon=300.0)
    assert recursion.start(0.0, {HEAT: 0.5}, settled=True)[OUTPUT.channel] == pytest.approx(2.0)
    assert recursion.ahead({HEAT: 0.5})[OUTPUT.channel] == pytest.approx(2.0)
    futures = np.array([0.0, 0.5, 1.0])
    foretold = recursion.ahead({HEAT: futures})[OUTPUT.channel]
    for k, u in enumerate(futures):
        fresh = model.recursion()
        fresh.start(0.0, {HEAT: 0.5}, settled=True)
        fresh.amend({HEAT: u})
        assert fresh.step(300.0, {HEAT: u})[OUTPUT.channel] == pytest.approx(foretold[k])


def test_what_cannot_be_followed_is_refused_by_name():
    class Median(Effect):
        """It weighs a row by all of the record."""

        name, side = "median", "drive"

        def drive(self, signals, u, memory=None):
            return u * np.median(u)

    whole = machine(Median(HEAT, {}))
    assert whole.simulate(log())[X].any()
    with pytest.raises(ModelError, match="median takes whole records"):
        whole.recursion(DIGEST)


def test_what_is_wrong_with_a_row_is_said():
    recursion = everything().recursion(DIGEST)
    every = list(rows(log()))
    recursion.start(*every[0])
    with pytest.raises(ModelError, match="does not come after"):
        recursion.step(*every[0])
    with pytest.raises(ModelError, match=f"{HEAT}, which is not in the row"):
        recursion.step(every[1][0], {k: v for k, v in every[1][1].items() if k != HEAT})
    with pytest.raises(ModelError, match=AIR):
        recursion.step(every[1][0], {k: v for k, v in every[1][1].items() if k != AIR})
    with pytest.raises(ModelError, match="no steady state is known with convection_state"):
        recursion.start(*every[0], settled=True)
    with pytest.raises(ModelError, match="nothing is foretold with"):
        recursion.ahead(every[0][1])
    with pytest.raises(ModelError, match="transport_delay"):
        recursion.amend(every[0][1])


def test_the_scene_of_the_catalogue_is_the_log():
    """Probes are made for the log that is simulated here."""
    assert scene(columns(3)).logs[0].digest == DIGEST


def test_what_is_no_state_is_refused():
    model = one_term(Deflection(1.0, 0.01, 0.0, 1.0, 0.0, 1.0), "zero")
    recursion = model.recursion()
    recursion.start(0.0, {HEAT: 1.0})
    kept = recursion.state()
    for wrong in ({}, {**kept, "responses": []}, {**kept, "inputs": ["x"]}):
        with pytest.raises((KeyError, TypeError, ValueError)):
            model.recursion().resume(wrong)
