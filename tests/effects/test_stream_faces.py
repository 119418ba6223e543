"""What causes say of themselves for a stream agrees with what they do in a simulation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from effects.machine import AIR, BEARING, COOLANT, PART, columns, model, scene

from thermaltool.effects import CATALOGUE, effect_class
from thermaltool.record import Record


@cache
def everywhere():
    return scene(columns(extra=(AIR, PART, BEARING, COOLANT)))


def variants(name):
    """One probe of every form and place."""
    found = {}
    for effect in effect_class(name).probes(everywhere()):
        # Not all of it by the slower of two lags.
        share = {k: 0.3 for k in effect.parameters if k.startswith("slow_gain")}
        found.setdefault((tuple(effect.parameters), effect.channel), effect.changed(share))
    return list(found.values())


def signals(time, **named):
    return Record(time, named)


causes = pytest.mark.parametrize("name", CATALOGUE)
VALUES = np.linspace(-1.0, 1.0, 41)
ROWS = 200  # of a log that are followed by small steps
STILL = Record(np.zeros(41), {})


@causes
def test_undone_undoes(name):
    for effect in variants(name):
        if effect.undone(VALUES) is None:
            continue
        assert effect.memoryless
        effect = effect.changed({"curvature": 0.1} if name == "sensor_conversion" else {})
        if effect.side == "drive":
            done = effect.drive(STILL, VALUES)
        else:
            done = effect.output(effect.channel, {effect.channel: VALUES}, STILL)
        # Nothing acts inside a dead band.
        there = done != 0
        assert there.sum() > 20
        np.testing.assert_allclose(effect.undone(done)[there], VALUES[there], atol=1e-12)
        np.testing.assert_array_equal(effect.undone(done[:1]), effect.undone(done)[:1])


@causes
def test_a_path_is_what_a_source_does(name):
    log = everywhere().logs[0]
    for effect in variants(name):
        for output in (o.channel for o in model().outputs):
            rest = np.zeros(len(log.time))
            done = effect.output(output, {o.channel: rest for o in model().outputs}, log)
            paths = effect.paths(output)
            if not paths:
                # What is lost at one place goes by a product of two columns.
                told = effect.side == "source" and effect.channel and not effect.partner
                assert not told or effect.log or not done.any()
                continue
            values = log.columns[effect.channel] - log.columns[effect.channel][0]
            held = "T_" not in effect.channel
            expected = sum(gain * followed(log.time, values, tau, held) for gain, tau in paths)
            np.testing.assert_allclose(done[:ROWS], expected, atol=1e-3 * np.ptp(expected) + 1e-12)


def followed(time, values, tau, held):
    """A first-order lag, by small steps between samples."""
    values, inner, found = values[:ROWS], 20, [0.0]
    if not tau:
        return values
    for a, b, dt in zip(values, values[1:], np.diff(time), strict=False):
        y = found[-1]
        for k in range(inner):
            u = a if held else a + (b - a) * (k + 0.5) / inner
            y += (u - y) * -np.expm1(-dt / inner / tau)
        found.append(y)
    return np.array(found)


@causes
def test_memoryless_is_said_of_what_looks_at_the_moment_alone(name):
    order = np.random.default_rng(0).permutation(len(VALUES))
    for effect in variants(name):
        if not effect.memoryless:
            continue
        for act in (
            lambda u, e=effect: e.drive(STILL, u),
            lambda u, e=effect: e.output(e.channel, {e.channel: u}, STILL),
        ):
            np.testing.assert_array_equal(act(VALUES[order]), act(VALUES)[order])


def test_a_turning_point_ends_what_can_be_undone():
    bent = effect_class("sensor_conversion")("dT_near_K", {"gain": -2.0, "curvature": 0.5})
    reading = np.array([-2.1, -1.9, 0.0, 1.0])
    truth = bent.undone(reading)
    assert np.isnan(truth[0])
    np.testing.assert_allclose(-2 * truth[1:] + 0.5 * truth[1:] ** 2, reading[1:], atol=1e-12)
    assert truth[2] == 0
    assert np.all(truth[1:] <= 2)
