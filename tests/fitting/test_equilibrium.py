"""A temperature that takes that of its surroundings in the end, and what may stand against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machines.shop import BASE, HEAD, HEAT, ROOM, shop_columns
from scipy.linalg import expm

from thermaltool.effects.channels import is_possible_gain
from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.fitting.covariance import block_covariance
from thermaltool.fitting.possible import impossible, reversal
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.report.calibration import calibration_warnings
from thermaltool.responses import response_class

OUTPUT = HEAD
PLAN = CalibrationPlan((HEAT, ROOM), (OUTPUT,), choose=True)


def log_of(*how, **more):
    columns = shop_columns(*how, **more)
    return Record(columns.pop("time_s"), columns, digest=f"{how} {more}")


def room_gain(model, output=HEAD):
    return sum(t.response.dc_gain() for t in model.terms if (t.drive, t.output) == (ROOM, output))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_room_that_hardly_moves_is_followed_in_the_end(seed):
    """Another day is warmer by 4 K: a gain from a room that moved by 0.5 K is no guide."""
    model = calibrate([log_of(seed, 0.5)], PLAN)
    assert room_gain(model) == pytest.approx(1.0, abs=0.01)
    # Known as a law, whatever else the log leaves open.
    term = next(t for t in model.terms if t.drive == ROOM)
    names = (*term.response.searched, *term.response.gains)
    gains = np.array([float(name in term.response.gains) for name in names])
    assert gains @ np.array(term.covariance) @ gains < 0.01**2
    other = log_of(seed + 10, 4.0)
    left = other.column(OUTPUT) - model.simulate(other)[OUTPUT]
    assert np.std(left) < 0.08
    told = calibration_warnings(model)
    assert f"without heat {OUTPUT} will be as warm as {ROOM}" in " ".join(told)


@pytest.mark.slow
@pytest.mark.parametrize("others", [(), (BASE,)])
def test_a_floor_that_nobody_logs_is_told_and_followed(others):
    model = calibrate([log_of(4, 4.0, floor=6.0)], replace(PLAN, sensors=(OUTPUT, *others)))
    # 6 W/K from the base to the floor beside 5 and, through the head, 1.5 W/K to the room.
    to_room = 5.0 + 1 / (1 / 5.0 + 1 / 1.5)
    base = to_room / (to_room + 6.0)
    truth = (1.5 + 5.0 * base) / 6.5
    assert room_gain(model) == pytest.approx(truth, abs=0.03)
    assert all(room_gain(model, name) == pytest.approx(base, abs=0.03) for name in others)
    told = [line for line in calibration_warnings(model) if "add up" in line]
    for name, line in zip((OUTPUT, *others), told, strict=True):
        assert line.startswith(f"{name}: its gains to {ROOM} add up to 0.")


def test_what_is_known_of_a_sum_is_known_of_its_covariance():
    rng = np.random.default_rng(5)
    one = rng.standard_normal(300)
    J = np.column_stack([one, one + 1e-12 * rng.standard_normal(300)])
    arguments = J, 0.1 * rng.standard_normal(300), np.zeros(300, int), np.ones(300)
    known = np.array([[1.0, 0.0]]) / 0.01
    covariance = block_covariance(*arguments, np.full(2, np.inf), known)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.01, rel=0.2)


def test_a_temperature_does_not_go_back_while_it_is_warmed():
    drive = Drive(HEAT, "zero", 0.0, (0.0, 1.0))
    kind = response_class("rational2")
    shape = {"tau1": 5000.0, "tau2": 300.0, "delay": 0.0}
    back = kind(K1=-0.4, K2=1.0, **shape)
    assert "staying on, cool it" in impossible([drive], OUTPUT, [back])
    assert not impossible([drive], "d_z_um", [back])
    # What two places differ by may.
    assert not impossible([drive], "dT_pair_K", [back])
    assert not impossible([drive], OUTPUT, [kind(K1=0.4, K2=1.0, **shape)])
    # What begins a little the wrong way is a short delay, by a kind of few time constants.
    assert not impossible([drive], OUTPUT, [kind(K1=1.0, K2=-0.1, **shape)])
    assert reversal(np.array([0.0, 1.0, 0.75])) == pytest.approx(0.25)
    assert reversal(np.array([0.0, -1.0, -0.75])) == pytest.approx(0.25)
    assert reversal(np.zeros(3)) == 0.0


@pytest.mark.slow
def test_kinds_that_come_as_near_widen_what_is_known():
    model = calibrate([log_of(6, 1.0)], PLAN)
    (output,) = model.outputs
    spread = np.array(output.fit["discrepancy"]["spread"])
    lags = output.fit["discrepancy"]["lags"]
    assert spread.shape[1] == len(lags)
    assert len(spread) > 1
    # The step responses differ by some noise at the largest heat, not by all that they are.
    late = np.array([1 - np.exp(-2e4 / tau) if drive == HEAT else 0.0 for drive, tau in lags])
    size = 120.0 * np.abs(spread @ late)
    assert 0.001 < np.max(size) < 3.0
    plain = replace(PLAN, choose=False, kinds={OUTPUT: "rational2"})
    (given,) = calibrate([log_of(6, 1.0)], plain).outputs
    # Beside a kind that is given stand other ends of its own search, which hardly differ.
    ends = np.reshape(given.fit["discrepancy"]["spread"], (-1, len(lags)))
    assert np.max(120.0 * np.abs(ends @ late), initial=0.0) < 0.1 * given.fit["noise"]
    assert len(ends) < len(spread)


@pytest.mark.parametrize(
    ("source", "output", "gain", "is_possible"),
    [
        ("T_oil_degC", OUTPUT, -1.0, False),  # nothing that is warmer cools
        ("T_oil_degC", OUTPUT, 2.5, True),
        ("T_aria_degC", OUTPUT, 2.5, False),
        ("T_Halle2_degC", OUTPUT, 2.5, False),
        ("T_hallway_degC", OUTPUT, 2.5, True),
        ("dT_pair_K", OUTPUT, -1.0, True),
        ("T_oil_degC", "dT_pair_K", -1.0, True),
        ("T_oil_degC", "d_z_um", -40.0, True),
    ],
)
def test_how_far_a_temperature_may_move_another(source, output, gain, is_possible):
    assert is_possible_gain(source, output, gain) is is_possible


def water_cooled(seed):
    """Eight bodies of a laser head: most of their heat goes into water at 24 °C, not logged.

    Returns a log of the rim of its lens, and what it gains from the hall for good.
    """
    generator = np.random.default_rng([11, seed])
    size = np.array([18.0, 45.0, 25.0, 80.0, 900.0, 2200.0, 1800.0, 4200.0, 350.0])  # J/K
    links = ((0, 1, 0.09), (1, 6, 0.35), (2, 3, 0.12), (3, 6, 0.3), (3, 4, 0.15), (4, 5, 0.8),
             (5, 6, 1.6), (5, 7, 0.7), (8, 5, 0.5), (8, 7, 0.3))  # fmt: skip
    air = np.array([0.005, 0.01, 0.0, 0.01, 0.1, 0.25, 0.25, 0.6, 0.12])
    water = np.array([0.0, 0.0, 0.0, 0.05, 0.5, 0.0, 0.9, 0.0, 0.0])
    loss = np.diag(air + water)
    for i, j, through in links:
        loss[[i, j], [i, j]] += through
        loss[[i, j], [j, i]] -= through
    beam, coil = np.zeros(9), np.zeros(9)
    beam[[0, 2, 4, 6]] = 0.0009, 0.0007, 0.0012, 0.0015
    coil[8] = 1.0
    time = 20.0 * np.arange(1400)

    def duty(levels, shortest, longest, first):
        values, at = np.zeros(len(time)), first
        while at < len(time):
            rows = int(generator.uniform(shortest, longest) / 20.0)
            values[at : at + rows] = generator.choice(levels)
            at += rows
        return values

    swing = np.sin(2 * np.pi * time / generator.uniform(20000.0, 40000.0))
    swing = 1.3 * swing + 0.5 * np.sin(2 * np.pi * time / generator.uniform(2000.0, 3200.0))
    walk = np.cumsum(generator.standard_normal(len(time))) * 0.02
    drives = {
        "Q_beam_W": duty([0.0, 0.0, 2000.0, 4000.0, 6000.0], 200.0, 2400.0, 20),
        "Q_coil_W": duty([0.0, 2.0, 4.0, 6.0], 600.0, 4000.0, 35),
        ROOM: 22.0 + np.minimum(time / 1200.0, 1.0) * (swing + walk - walk[0]),
    }
    inputs = np.column_stack([beam, coil, air, 24.0 * water])
    heats = np.column_stack([*drives.values(), np.ones(len(time))])
    whole = np.zeros((13, 13))
    whole[:9, :9], whole[:9, 9:] = -loss / size[:, None], inputs / size[:, None]
    kept = expm(20.0 * whole)
    state, rim = np.linalg.solve(loss, inputs @ heats[0]), []
    for row in heats:
        rim.append(state[3])
        state = kept[:9, :9] @ state + kept[:9, 9:] @ row
    read = np.round(rim + 0.02 * generator.standard_normal(len(time)), 2)
    return Record(time, {**drives, OUTPUT: read}, digest="log"), np.linalg.solve(loss, air)[3]


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=pytest.mark.slow if seed == 1 else pytest.mark.study)
        for seed in (1, 2, 3)
    ],
)
def test_water_that_nobody_logs_is_no_room_and_needs_no_slow_lag(seed):
    log, truth = water_cooled(seed)
    plan = CalibrationPlan(("Q_beam_W", "Q_coil_W", ROOM), (OUTPUT,), choose=True, linear=True)
    model = calibrate([log], plan)
    assert room_gain(model) == pytest.approx(truth, abs=0.1)
    # The slowest time constant of the bodies is 73 min.
    assert max(t.response.slowest() for t in model.terms) < 1.5 * 4400.0
