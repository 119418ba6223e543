"""Quill and C-frame: balance of heat, what is printed of them, duties, the command."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from thermaltool.cli.plant import command
from thermaltool.logs import read_log
from thermaltool.plants import build
from thermaltool.plants.duties import DUTIES, HOUR, air, settings
from thermaltool.plants.heated import HEATERS, OUTPUTS, POWERS, Regulator

plant = cache(build)
plants = pytest.mark.parametrize("name", ["quill", "c-frame"])


def angle(name, outputs):
    """[µrad]"""
    return 1e3 * (outputs["d_x2_um"] - outputs["d_x1_um"]) / plant(name).distance


def steady_state(name, powers):
    """Where constant settings end [K and µm above rest]."""
    there = plant(name)
    heat = np.zeros(len(there.capacity))
    heat[-2:] = [r.power(np.array(p)) for r, p in zip(there.regulators, powers, strict=True)]
    rise, before = np.zeros(len(heat)), np.inf
    while np.max(np.abs(rise - before)) > 1e-9:
        before = rise
        rise = np.linalg.solve(there.balance, heat - there._bent(before))
    return dict(zip(OUTPUTS, (there.rows @ rise).tolist(), strict=True))


def calibrated(name, heater, hours=12.0, dt=60.0):
    n = round(hours * HOUR / dt) + 1
    powers = np.zeros((n, 2))
    powers[:, heater] = plant(name).regulators[heater].full
    return plant(name).simulate(powers, np.full(n, 20.0), dt)


def test_printed_figures_of_the_quill():
    """Mareš et al., section 2.2: 9e-5 rad and 60 µm, Δ 100 mm."""
    steady = steady_state("quill", (90.0, 0.0))
    assert abs(angle("quill", steady)) == pytest.approx(90.0, rel=0.05)
    assert abs(steady["d_z_um"]) == pytest.approx(60.0, rel=0.05)
    assert plant("quill").distance == pytest.approx(100.0)


def test_printed_figures_of_the_frame():
    """Section 3: 70 W, Δ 200 mm."""
    assert plant("c-frame").distance == pytest.approx(200.0)
    assert {r.full for r in plant("c-frame").regulators} == {70.0}


@plants
@pytest.mark.parametrize("heater", [0, 1])
def test_a_calibration_of_twelve_hours_ends_settled(name, heater):
    run = calibrated(name, heater)
    powers = [0.0, 0.0]
    powers[heater] = plant(name).regulators[heater].full
    steady = steady_state(name, powers)
    end = {channel: run[channel][-1] - run[channel][0] for channel in OUTPUTS}
    assert angle(name, end) == pytest.approx(angle(name, steady), rel=0.01)
    for channel in OUTPUTS:  # to a micrometre, and half a kelvin
        within = 1.0 if channel.endswith("um") else 0.5
        assert end[channel] == pytest.approx(steady[channel], abs=within), channel


@plants
def test_the_stabilization_heater_can_bend_it_back(name):
    full = plant(name).regulators[0].full
    causal = angle(name, steady_state(name, (full, 0.0)))
    back = angle(name, steady_state(name, (0.0, full)))
    assert causal * back < 0
    assert abs(back) > abs(causal)


@plants
def test_half_the_sample_gives_the_same(name):
    coarse, fine = calibrated(name, 0, 3.0), calibrated(name, 0, 3.0, 15.0)
    for channel in OUTPUTS:
        size = np.ptp(fine[channel])
        np.testing.assert_allclose(coarse[channel], fine[channel][::4], atol=2e-4 * size)


def test_all_heat_is_stored_where_none_is_lost():
    closed = plant("quill")
    n = len(closed.capacity)
    conduction = closed.balance - np.diag(closed.film)
    conduction[:8, :8] -= np.diag(np.sum(conduction, axis=1)[:8])  # no foot
    none, rows = np.zeros(n), np.vstack([closed.rows[:4], closed.capacity])
    balance = conduction + 1e-12 * np.eye(n)
    free = replace(closed, balance=balance, natural=none, film=none, rows=rows)
    stored = free.simulate(np.tile([90.0, 0.0], (61, 1)), np.full(61, 20.0), 60.0)["d_z_um"]
    np.testing.assert_allclose(stored, 90.0 * 60.0 * np.arange(61), rtol=1e-6)


@plants
def test_warm_air_alone_warms_it(name):
    n = 1500
    course = np.where(np.arange(n) > 0, 21.0, 20.0)
    run = plant(name).simulate(np.zeros((n, 2)), course, 60.0)
    assert 20.3 < run["T_causal_degC"][-1] < 21.0
    assert run["T_causal_degC"][0] == 20.0


def test_a_regulator_agrees_at_both_ends_and_rises():
    regulator = Regulator(70.0, 1.65, 0.5)
    power = regulator.power(np.linspace(0, 70, 200))
    assert power[[0, -1]] == pytest.approx([0.0, 70.0])
    assert np.all(np.diff(power) > 0)
    np.testing.assert_array_equal(regulator.power(np.array([-5.0, 90.0])), [0.0, 70.0])
    np.testing.assert_allclose(Regulator(70.0, 1.0, 0.0).power(np.array([7.0])), [7.0])
    assert Regulator(70.0, 2.0, 0.0).power(np.array(35.0)) == pytest.approx(70.0 / 4)


def test_duties():
    time = np.arange(-1800.0, 56 * HOUR, 60.0)
    drawn = {name: settings(name, (True, False), 70.0, time, 5) for name in DUTIES}
    for name, powers in drawn.items():
        assert powers.shape == (len(time), 2), name
        assert not powers[:, 1].any(), name
        assert not powers[time < 0].any(), name
        assert 0 <= powers.min() < powers.max() <= 70.0, name
        np.testing.assert_array_equal(powers, settings(name, (True, False), 70.0, time, 5))

    def holds(name, rows):
        moves = time[1:][np.diff(drawn[name][:, 0]) != 0]
        return np.diff(moves[rows(moves)])

    assert sorted(set(drawn["A"][time >= 0, 0].tolist())) == [10, 20, 30, 40, 50, 60, 70]
    assert np.all(holds("A", lambda t: t >= 0) == 8 * HOUR)
    turn = 0.9 * time[-1]
    assert holds("B", lambda t: t < turn).min() >= HOUR - 60
    assert holds("B", lambda t: t > turn + 60).max() <= 2 * 20 * 60 + 60
    assert holds("quick", lambda t: t > 0).min() < 10 * 60
    different = settings("B", (True, True), 70.0, time, 5)
    np.testing.assert_array_equal(different[:, 0], drawn["B"][:, 0])
    assert not np.array_equal(different[:, 0], different[:, 1])


def test_the_air_starts_where_it_is_told():
    time = np.arange(0, 200 * HOUR, 60.0)
    course = air(time, 21.0, 0.5, 3)
    assert course[0] == 21.0
    assert 0.2 < np.std(course) < 1.0
    np.testing.assert_array_equal(air(time, 21.0, 0.0, 3), 21.0)


def run(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments])


def test_the_command_writes_the_channels(tmp_path):
    (offered,) = (p.type.choices for p in command.params if p.name == "heater")
    assert [*HEATERS, "both"] == list(offered)
    target = tmp_path / "run.csv"
    result = run("c-frame", "--heater", "stabilization", "--power", 40, "--duration", 5400,
                 "--start", 600, "--clean", "-o", target)  # fmt: skip
    assert result.exit_code == 0, result.output
    log = read_log(str(target))
    assert list(log.columns) == [*POWERS, "T_ambient_degC", *OUTPUTS]
    assert log.period == 60.0
    np.testing.assert_array_equal(log.column("Q_stabilization_W"), [0.0] * 10 + [40.0] * 81)
    assert not log.column("Q_causal_W").any()
    again = run("c-frame", "--input", target, "--start", 0, "--duration", 5400, "--clean")
    assert again.stdout == target.read_text()


def test_noise_is_that_of_its_seed():
    one, two, other = (run("quill", "--duration", 1800, "--seed", s).stdout for s in (3, 3, 4))
    assert one == two
    assert one != other


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("quill", "--power", 100), "quill has 90 W"),
        (("quill", "--input", "triangle"), "none of step, A, B, quick, mixed"),
        (("c-frame", "--heater", "main"), "'main' is not one of"),
    ],
)
def test_bad_usage_is_named(arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr
