"""The shared checks: whatever is listed in `CATALOGUE` has to pass them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from effects.machine import AIR, BEARING, COOLANT, HEAT, PART, columns, model, scene

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.severity import Severity
from thermaltool.effects import CATALOGUE, effect_class, load_effect
from thermaltool.effects.effect import SIDES, reference_of
from thermaltool.errors import ModelError
from thermaltool.model import dumps, loads
from thermaltool.record import Record
from thermaltool.units import UNITS, is_displacement

# Found by the diagnosis itself; there is nothing to simulate.
NO_TRIAL = ("record_too_short", "outliers", "noise_state")
# Probes of one cause at one place of one log.
MOST = 60

causes = pytest.mark.parametrize("name", CATALOGUE)
acting = pytest.mark.parametrize("name", [n for n in CATALOGUE if n not in NO_TRIAL])


@cache
def place(air=True, logs=1):
    extra = (AIR, PART, BEARING, COOLANT) if air else (PART, BEARING, COOLANT)
    return scene(*(columns(seed, extra) for seed in range(logs)))


def probes(name, air=True, logs=1):
    return list(effect_class(name).probes(place(air, logs)))


def variants(name):
    """One probe of every form that a cause has: by its parameters, and whether it has a channel."""
    found = {}
    for effect in probes(name) + probes(name, air=False):
        found.setdefault((tuple(effect.parameters), bool(effect.channel)), effect)
    return list(found.values())


def simulate(*effects):
    log = place().logs[0]
    return model(*effects).simulate(log)


def moved(effect, beside=()):
    """Outputs that are not what they are without, or beside other effects."""
    plain, changed = simulate(*beside), simulate(effect)
    return {o for o in plain if not np.array_equal(plain[o], changed[o])}


@causes
def test_it_is_described(name):
    cls = effect_class(name)
    assert cls.name == name
    # What a cause with several forms says of itself goes by its form.
    for form in variants(name) or [cls]:
        assert form.side in SIDES
        for text in (form.explanation, form.action, form.signature, form.source):
            assert len(text) > 15
            assert text == text.strip()
            assert not text.endswith(".")


@acting
def test_an_action_has_its_place_and_its_numbers(name):
    """Every form says where to look, and no number is missing."""
    for effect in variants(name):
        output = next((own for n in effect.parameters if (own := reference_of(n)[1])), "")
        severity = {output or place().outputs[0]: Severity(3.25, 1.0)}
        said = action_of(effect, severity, {})
        assert any(where and where in said for where in (effect.channel, output))
        assert effect.channel or "3.25" in said
        assert not re.search(r"[{}]|nan", said)
        assert action_of(effect, {}, {})


@causes
def test_places_and_sizes_to_try(name):
    known = {HEAT, *place().outputs, *place().extra}
    total = 0
    for tried in (probes(name, logs=2), probes(name, air=False)):
        counts = Counter((e.channel, e.partner, e.log, tuple(e.parameters)) for e in tried)
        assert max(counts.values(), default=0) <= MOST
        total += len(tried)
        for effect in tried:
            assert effect.channel in known or (effect.channel == "" and effect.log), effect
            assert effect.log in (None, "p", "q")
            assert effect.log or not effect.event, "an accident belongs to a log"
            for parameter, value in effect.parameters.items():
                allowed = effect.parameter(parameter)
                assert allowed.low <= value <= allowed.high
                assert np.isfinite(value)
    assert bool(total) == (name not in NO_TRIAL)


@acting
def test_every_trial_can_be_seen(name):
    for effect in probes(name):
        assert moved(effect), effect


@acting
def test_neutral_is_no_effect(name):
    if name in ("sensor_frozen", "sensors_swapped"):
        pytest.skip("it is there or not")
    for effect in variants(name):
        names = effect.linear() or effect.searched()
        if effect.stands:
            names = (*effect.linear(), *effect.searched())
        neutral = effect.changed({n: effect.parameter(n).neutral for n in names})
        plain, changed = simulate(), simulate(neutral)
        for output, y in plain.items():
            np.testing.assert_allclose(changed[output], y, rtol=0, atol=1e-12 * np.ptp(y))


@acting
def test_only_what_its_side_says_changes(name):
    every = set(place().outputs)
    for effect in variants(name):
        reached = moved(effect)
        own = {o for n in effect.parameters if (o := reference_of(n)[1])}
        if effect.side in ("drive", "state"):
            assert reached == every
        elif effect.side == "wiring":
            assert reached == {effect.channel, effect.partner}
        else:
            assert reached == (own or {effect.channel})
        # Heat that a joint redirects is felt in temperatures, too, and so is what conducts it.
        alone = effect.side == "structure" and not effect.joins and name != "conductivity"
        if alone or name == "part_temperature":
            assert all(is_displacement(o) for o in reached)


@acting
def test_linear_parameters_are_linear(name):
    rng = np.random.default_rng(3)
    for effect in variants(name):
        linear = effect.linear()
        if not linear:
            continue
        neutral = {n: effect.parameter(n).neutral for n in linear}
        a, b = ({n: float(rng.normal()) for n in linear} for _ in range(2))
        both = {n: neutral[n] + 2 * a[n] - 0.7 * b[n] for n in linear}
        ya, yb, y = (
            simulate(effect.changed(values))
            for values in (
                {n: neutral[n] + a[n] for n in linear},
                {n: neutral[n] + b[n] for n in linear},
                both,
            )
        )
        y0 = simulate(effect.changed(neutral))
        for o in y:
            expected = y0[o] + 2 * (ya[o] - y0[o]) - 0.7 * (yb[o] - y0[o])
            scale = max(float(np.max(np.abs(each[o]))) for each in (y, ya, yb))
            np.testing.assert_allclose(y[o], expected, rtol=0, atol=1e-11 * scale)


@acting
def test_an_amplitude_of_an_output_moves_that_output_alone(name):
    for effect in variants(name):
        for parameter in effect.linear():
            output = reference_of(parameter)[1]
            if output is None:
                continue
            neutral = {n: effect.parameter(n).neutral for n in effect.linear()}
            bare = [effect.changed(neutral)] if effect.stands else []
            sized = effect.changed({**neutral, parameter: effect.parameters[parameter] or 0.1})
            # No mode of an output is fast that is as slow as the time constant that changes.
            slow = place().bodies[output] >= effect.parameters.get("time_constant", np.inf)
            idle = effect.stands and slow and parameter == f"fast[{output}]"
            assert moved(sized, bare) == (set() if idle else {output})
            gone = tuple(n for n in effect.linear() if reference_of(n)[1] != output)
            alone = effect.without(gone)
            assert moved(alone) == (set(place().outputs) if effect.stands else {output})
            if effect.channel in place().outputs and not effect.joins:
                assert alone.channel == output
            else:
                assert alone.channel == effect.channel


@causes
def test_units_are_known(name):
    examples = variants(name) or [effect_class(name)("dT_near_K", dict.fromkeys(
        effect_class(name).known, 1.0))]  # fmt: skip
    used = set()
    for effect in (*examples, *(finer for each in examples if (finer := each.finer()))):
        for parameter in effect.parameters:
            used.add(reference_of(parameter)[0])
            above, _, below = effect.unit(parameter).partition("/")
            assert above in UNITS
            assert not below or below in UNITS
    # Every parameter that is documented is used by some form of the cause; `contact` by those that
    # a calibration finds, `rest` where a log begins with the source on.
    numbered = {n for n in effect_class(name).known if n[-1].isdigit()}
    optional = {"stop", "contact", "rest", *numbered}
    assert set(effect_class(name).known) - used <= optional


@causes
def test_it_travels_in_the_model_file(name):
    cls = effect_class(name)
    known = dict.fromkeys(cls.known, 0.5)
    for effect in variants(name) or [cls("dT_near_K", known, "p")]:
        size = len(effect.parameters)
        covariance = 0.1 * np.eye(size) if size else None
        kept = model(replace(effect, covariance=covariance))
        text = dumps(kept)
        back = loads(text)
        assert dumps(back) == text
        assert back.effects == kept.effects
        assert list(back.effects[0].parameters) == list(effect.parameters)
        assert type(back.effects[0]) is cls
        if size:
            np.testing.assert_array_equal(back.effects[0].covariance, covariance)
        assert back.parameters_digest() != model().parameters_digest()


@causes
def test_an_unknown_parameter_is_named(name):
    document = effect_class(name)("dT_near_K", {}).document()
    with pytest.raises(ModelError, match="wrong"):
        load_effect({**document, "parameters": {"wrong": 1.0}, "covariance_names": ["wrong"]})


@acting
def test_a_channel_that_it_needs_and_is_not_there_is_named(name):
    log = place().logs[0]
    for effect in variants(name):
        assert effect.channel in effect.needs() or effect.channel not in place().extra
        for channel in effect.needs():
            if channel == HEAT:
                continue
            assert channel in model(effect).needs()
            rest = {c: v for c, v in log.columns.items() if c != channel}
            with pytest.raises(ModelError, match=channel):
                model(effect).simulate(Record(log.time, rest, digest=log.digest))


@acting
def test_it_leaves_what_it_reads_alone(name):
    time, given = columns()
    for values in (time, *given.values()):
        values.flags.writeable = False
    outputs = simulate()
    for values in outputs.values():
        values.flags.writeable = False
    signals = Record(time, given, digest="p")
    for effect in variants(name):
        effect.drive(signals, given[HEAT])
        effect.loss(signals, outputs)
        for output in outputs:
            assert len(effect.output(output, outputs, signals)) == len(time)


@acting
def test_it_acts_in_its_own_log_alone(name):
    log = place().logs[0]
    for effect in variants(name):
        elsewhere = model(replace(effect, log="another day"))
        y = elsewhere.simulate(log)
        plain = simulate()
        assert all(np.array_equal(y[o], plain[o]) for o in plain)


@acting
def test_missing_readings_of_a_channel_beside_the_model_do_not_spread(name):
    log = place().logs[0]
    for effect in variants(name):
        for channel in effect.needs():
            if channel == HEAT:
                continue
            holed = {**log.columns, channel: log.columns[channel].copy()}
            holed[channel][[0, 1, 300, 301, -1]] = np.nan
            y = model(effect).simulate(Record(log.time, holed, digest=log.digest))
            assert all(np.isfinite(values).all() for values in y.values())


def test_a_law_agrees_nowhere_inside_its_dead_band():
    scene = place()
    drive, level = next(iter(scene.levels().items()))

    def law(**parameters):
        return effect_class("drive_nonlinearity")(drive, {"level": level, **parameters})

    assert law(dead_band=0.5 * level, agrees_at=level).plausible(scene)
    assert not law(dead_band=0.5 * level, agrees_at=0.4 * level).plausible(scene)
    assert not law(dead_band=0.5 * level, agrees_at=5.0 * level).plausible(scene)
    # ... nor where more of the drive would be less of what acts.
    assert law(curvature=0.4, agrees_at=level).plausible(scene)
    assert not law(curvature=2.0, agrees_at=level).plausible(scene)
    # u (1 - 0.4 u) rises up to its level, wherever it is scaled to agree.
    assert law(curvature=-0.4 / 0.6, agrees_at=level).plausible(scene)
    assert law(curvature=2.0, agrees_at=level).undone(np.zeros(1)) == 0.0
