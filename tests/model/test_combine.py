"""Models added up and scheduled by level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermaltool.diagnosis.diagnose import diagnose
from thermaltool.effects.band import ScheduleBand, load_band
from thermaltool.effects.curve import DriveCurve, OutputCurve
from thermaltool.errors import ModelError
from thermaltool.model import Drive, Model, Output, Term, dumps, loads
from thermaltool.model.combine import scheduled, superposed
from thermaltool.record import Record
from thermaltool.responses.rational import Rational2

HEAT, OTHER, ANGLE = "Q_heater_W", "Q_other_W", "phi_x_urad"
TIME = 60.0 * np.arange(600)


def member(level, gain=1.0, tau=900.0, drive=HEAT, **parts):
    terms = (Term(drive, ANGLE, Rational2(gain, tau, 0.3, 5 * tau)),)
    drives = (Drive(drive, "zero", 0.0, (0.0, level)),)
    outputs = (Output(ANGLE, "deflection", "first", (0.0, 80.0), {"rmse": 1.0}),)
    return replace(Model(drives, outputs, terms, 60.0, {"logs": [{"name": str(level)}]}), **parts)


MEMBERS = [member(60.0, 2.0, 600.0), member(20.0, 1.2, 900.0), member(40.0, 1.5, 750.0)]


def run(model, *drives):
    return model.simulate(Record(TIME, dict(zip((HEAT, OTHER), drives, strict=False))))[ANGLE]


def steps(*levels):
    return np.repeat(np.array(levels, float), len(TIME) // len(levels))


def test_the_sum_of_two_models():
    both = superposed([MEMBERS[0], member(50.0, -1.0, drive=OTHER)])
    u, v = steps(0, 60, 10), steps(0, 20, 50)
    expected = (
        run(MEMBERS[0], u)
        + member(50.0, -1.0, drive=OTHER).simulate(Record(TIME, {OTHER: v}))[ANGLE]
    )
    np.testing.assert_allclose(run(both, u, v), expected, atol=1e-12)
    assert [d.channel for d in both.drives] == [HEAT, OTHER]
    assert [log["name"] for log in both.provenance["logs"]] == ["60.0", "50.0"]
    assert dumps(loads(dumps(both))) == dumps(both)


def test_a_curve_of_a_drive_stays_with_it():
    curve = DriveCurve(OTHER, {"level": 50.0, "c1": 0.0, "c2": 1.0})
    bent = member(50.0, -1.0, drive=OTHER, effects=(curve,))
    both = superposed([MEMBERS[0], bent])
    u, v = steps(0, 60, 10), steps(0, 20, 50)
    expected = run(MEMBERS[0], u) + bent.simulate(Record(TIME, {OTHER: v}))[ANGLE]
    np.testing.assert_allclose(run(both, u, v), expected, atol=1e-12)


SQUARE = DriveCurve(HEAT, {"level": 50.0, "c1": 0.0, "c2": 1.0})
LENGTH = "d_z_um"


def elsewhere(each):
    """The same model to another output."""
    return replace(
        each,
        outputs=tuple(replace(o, channel=LENGTH) for o in each.outputs),
        terms=tuple(replace(t, output=LENGTH) for t in each.terms),
    )


def test_a_curve_does_not_bend_another_model():
    """In the sum a drive has one curve for all its terms."""
    bent = member(60.0, 2.0, effects=(SQUARE,))
    with pytest.raises(
        ModelError,
        match=r"^Q_heater_W acts differently in the models a\.json \(drive_curve\), "
        r"b\.json \(straight\): superpose first, correct then "
        r"\(calibrate --linear looks for no curve\)$",
    ):
        superposed([bent, elsewhere(member(50.0))], ["a.json", "b.json"])
    flatter = DriveCurve(HEAT, {"level": 50.0, "c1": 0.5, "c2": 0.5})
    with pytest.raises(ModelError, match=r"Q_heater_W .* model 1 .* model 2 \(drive_curve\)"):
        superposed([bent, elsewhere(member(50.0, effects=(flatter,)))])


def test_models_with_the_same_curve_at_a_drive():
    same = DriveCurve(HEAT, dict(SQUARE.parameters), covariance=np.eye(3))
    one = member(60.0, 2.0, effects=(SQUARE,))
    both = superposed([one, elsewhere(member(50.0, -1.0, effects=(same,)))])
    assert both.effects == (SQUARE,)
    u = steps(0, 60, 10)
    straight = [member(60.0, 2.0), elsewhere(member(50.0, -1.0))]
    for each, output in zip(straight, (ANGLE, LENGTH), strict=True):
        expected = each.simulate(Record(TIME, {HEAT: u**2 / 50.0}))[output]
        np.testing.assert_allclose(
            both.simulate(Record(TIME, {HEAT: u}))[output], expected, atol=1e-12
        )


def at_rest(each, zero):
    return replace(each, outputs=tuple(replace(o, offset=zero) for o in each.outputs))


@pytest.mark.parametrize("combine", [superposed, lambda models: scheduled(models, HEAT)])
def test_rest_is_where_the_models_have_it_on_the_mean(combine):
    """Every model has its own estimate of one state; nothing of it adds up."""
    other = member(50.0, drive=OTHER if combine is superposed else HEAT)
    made = combine([at_rest(MEMBERS[0], 20.0625), at_rest(other, 20.5)])
    assert made.outputs[0].offset == pytest.approx(20.28125)
    assert combine([MEMBERS[0], other]).outputs[0].offset == "first"


@pytest.mark.parametrize("combine", [superposed, lambda models: scheduled(models, HEAT)])
def test_clocks_that_were_printed_are_the_same(combine):
    """Medians of time columns with six decimals, one of them from a start late in the day."""
    clocks = [np.round(start + 0.1 * np.arange(50), 6) for start in (0.0, 81234.567891)]
    periods = [float(np.median(np.diff(clock))) for clock in clocks]
    assert periods[0] != periods[1]
    other = member(50.0, drive=OTHER if combine is superposed else HEAT)
    pair = [replace(m, sample_period=dt) for m, dt in zip((MEMBERS[0], other), periods,
                                                          strict=True)]  # fmt: skip
    assert combine(pair).sample_period in periods
    with pytest.raises(ModelError, match=r"model 2: sampled every 0\.11 s, model 1 every 0\.1 s"):
        combine([pair[0], replace(pair[1], sample_period=0.11)])


@pytest.mark.parametrize("k", range(3))
def test_at_its_level_a_member_is_alone(k):
    model = scheduled(MEMBERS, HEAT)
    u = steps(0, MEMBERS[k].drives[0].range[1], 0)
    np.testing.assert_allclose(run(model, u), run(MEMBERS[k], u), atol=1e-10)


def test_between_levels_gains_are_mixed_and_beyond_the_end_one_stays():
    model = scheduled(MEMBERS, HEAT)
    slow = np.full(600, 30.0)
    long = model.simulate(Record(6000.0 * np.arange(600), {HEAT: slow}))[ANGLE][-1]
    assert long == pytest.approx(30.0 * (1.5 + 1.8) / 2, rel=1e-6)
    np.testing.assert_allclose(run(model, steps(0, 90)), run(MEMBERS[0], steps(0, 90)), atol=1e-10)
    np.testing.assert_allclose(run(model, steps(0, 5)), run(MEMBERS[1], steps(0, 5)), atol=1e-10)


def test_no_output_jumps_where_the_level_does():
    """Twice as fine a clock halves the largest step: there is nothing left of a jump."""
    model = scheduled(MEMBERS, HEAT)

    def largest(dt):
        time = np.arange(0, 20000, dt)
        u = np.select([time < 6000, time < 12000], [60.0, 20.0], 43.0)
        return np.max(np.abs(np.diff(model.simulate(Record(time, {HEAT: u}))[ANGLE])))

    assert largest(2.0) == pytest.approx(largest(4.0) / 2, rel=0.02)


def test_another_channel_may_choose():
    model = scheduled(MEMBERS, "T_room_degC", [24.0, 18.0, 21.0])
    u, room = steps(0, 50), np.full(600, 18.0)
    got = model.simulate(Record(TIME, {HEAT: u, "T_room_degC": room}))[ANGLE]
    np.testing.assert_allclose(got, run(MEMBERS[1], u), atol=1e-10)
    assert "T_room_degC" in model.needs()
    with pytest.raises(ModelError, match="T_room_degC"):
        model.simulate(Record(TIME, {HEAT: u}))


def test_it_travels_in_the_model_file():
    model = scheduled(MEMBERS, HEAT)
    back = loads(dumps(model))
    assert dumps(back) == dumps(model)
    assert [t.band for t in back.terms] == [
        ScheduleBand(HEAT, (20.0, 40.0, 60.0), k) for k in range(3)
    ]
    assert back.drives[0].range == (0.0, 60.0)
    assert back.parameters_digest() != MEMBERS[0].parameters_digest()


def test_shares_add_up_to_one():
    values = np.linspace(-80, 80, 333)
    shares = [ScheduleBand(HEAT, (10.0, 20.0, 70.0), k).share(values) for k in range(3)]
    np.testing.assert_allclose(np.sum(shares, axis=0), 1.0)
    np.testing.assert_allclose(shares[0], shares[0][::-1], atol=1e-12)
    assert ScheduleBand(HEAT, (10.0, 20.0), 1).share(np.array(20.0)) == 1.0
    # A level below zero: the sign counts.
    assert ScheduleBand(HEAT, (-20.0, 20.0), 1).share(np.array(-10.0)) == 0.25


@pytest.mark.parametrize(
    ("levels", "index", "message"),
    [
        ([20.0, 10.0], 0, "rise"),
        ([1.0], 1, "no number 1"),
        ([np.nan], 0, "not a finite number: nan"),
    ],
)
def test_unsound_bands_are_named(levels, index, message):
    with pytest.raises(ModelError, match=message):
        load_band({"channel": HEAT, "levels": levels, "index": index})


CURVED = member(30.0, effects=(OutputCurve(ANGLE, {"level": 9.0, "c1": 1.0}),))


@pytest.mark.parametrize(
    ("models", "by", "levels", "message"),
    [
        (MEMBERS[:1], HEAT, None, "two models or more"),
        (MEMBERS, "T_room_degC", None, "is no drive of the models: give the levels"),
        (MEMBERS, HEAT, [1.0, 2.0], "3 models, 2 levels"),
        (MEMBERS, HEAT, [-1.0, 2.0, 3.0], "sizes, without sign: from 0 on"),
        ([MEMBERS[0], MEMBERS[0]], HEAT, None, "two models of one level"),
        ([MEMBERS[0], member(50.0, drive=OTHER)], HEAT, None, "same drives and outputs"),
        ([MEMBERS[0], CURVED], HEAT, None, "correct the schedule"),
        ([MEMBERS[0], scheduled(MEMBERS[1:], HEAT)], HEAT, None, "schedule of schedules"),
        ([MEMBERS[0], member(50.0, sample_period=30.0)], HEAT, None, "every 30 s"),
    ],
)
def test_what_cannot_be_scheduled(models, by, levels, message):
    with pytest.raises(ModelError, match=message):
        scheduled(models, by, levels)


def test_what_cannot_be_added():
    with pytest.raises(ModelError, match="it counts twice"):
        superposed(MEMBERS)
    other = member(50.0, drive=OTHER)
    absolute = replace(other, outputs=(replace(other.outputs[0], offset=0.0),))
    with pytest.raises(ModelError, match="differ in its zero: a number, or the first"):
        superposed([MEMBERS[0], absolute])
    sensor = replace(other, outputs=(replace(other.outputs[0], role="sensor"),))
    with pytest.raises(ModelError, match="differ in its role"):
        superposed([MEMBERS[0], sensor])
    with pytest.raises(ModelError, match="superpose first"):
        superposed([CURVED, other])


def test_a_schedule_is_not_diagnosed():
    rng = np.random.default_rng(1)
    table = {HEAT: steps(0, 50), ANGLE: rng.standard_normal(600)}
    with pytest.raises(ModelError, match="diagnose its members"):
        diagnose(scheduled(MEMBERS, HEAT), [Record(TIME, table, digest="a")])
