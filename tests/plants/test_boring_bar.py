"""The boring bar against the figures in print, and against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
from click.testing import CliRunner
from machines.roundness import roundness

from thermaltool.cli.plant import command
from thermaltool.logs import read_log
from thermaltool.plants.boring_bar import (
    PARTS,
    SECTIONS,
    TAPER_SLOPE,
    BarParameters,
    Workpiece,
    build,
)

BAR = build()
SMOOTH = Workpiece(
    depth=150.0, lobes={}, force_noise=0.0, spindle_lobes={}, spindle_noise=0.0, feed=0.0
)
PERIOD = BarParameters().period


def answer_at(frequency, amplitude, attribute="reading"):
    """Complex response to the command at a frequency [µm/V]."""
    time = PERIOD * np.arange(4000)
    cut = BAR.probe(5 + amplitude * np.sin(2 * np.pi * frequency * time))
    wave = np.exp(-2j * np.pi * frequency * time)[2000:]
    return (getattr(cut, attribute)[2000:] @ wave) / (cut.command[2000:] @ wave)


def test_the_cutter_falls_short_by_the_printed_part_of_the_depth():
    """Table 6.3: errors of 10, 13, 16 and 21 µm on the diameter."""
    for depth, printed in zip(SECTIONS.values(), (10, 13, 16, 21), strict=True):
        cut = BAR.cut(dataclasses.replace(SMOOTH, depth=depth), 600, 600)
        assert -2 * cut.deflection[-1] == pytest.approx(printed, abs=1.7)
        assert cut.deflection[-1] == pytest.approx(-0.044 * depth, rel=1e-3)


def test_travel_and_hysteresis():
    up = np.linspace(0, 10, 4000)
    loop = BAR.probe(np.concatenate([up, up[::-1], up]))
    travel = np.ptp(loop.deflection[4000:])
    assert travel == pytest.approx(100 * 9 / 50, rel=0.02)
    down, again = loop.deflection[4000:8000][::-1], loop.deflection[8000:]
    assert np.max(down - again) / travel == pytest.approx(0.12, abs=0.02)
    assert BAR.probe(np.full(2000, 12.0)).deflection[-1] < 20  # the converter ends at 10 V


def test_bandwidth_from_command_to_reading_is_about_80_hz():
    slow = abs(answer_at(2.0, 0.5))
    assert abs(answer_at(80.0, 0.5)) / slow == pytest.approx(math.sqrt(0.5), abs=0.04)


def test_the_bar_rings_at_its_mode():
    push = np.zeros(400)
    push[:1] = 50.0
    cut = BAR.cut(PARTS["none"], 0.0, 400, push=push)
    spectrum = np.abs(np.fft.rfft(cut.deflection, 8192))
    frequency = np.fft.rfftfreq(8192, PERIOD)[np.argmax(spectrum)]
    damped = 2225.0 * math.sqrt(1 - 2 * 0.1685**2) / (2 * math.pi)
    assert frequency == pytest.approx(damped, rel=0.03)


def test_static_stiffness():
    cut = BAR.cut(PARTS["none"], 0.0, 400, push=np.full(400, 27.0))
    assert cut.deflection[-1] == pytest.approx(10.0, rel=1e-6)
    assert cut.reading[100:].mean() == pytest.approx(10.0, abs=0.02)


def test_converters_have_twelve_bits():
    cut = BAR.cut(PARTS["straight"], 600, 500, lambda reading: 0.01 * reading)
    for values, full in ((cut.reading, 40.0), (cut.command, 10.0)):
        level = 2 * full / 4096
        np.testing.assert_allclose(values / level, np.round(values / level), atol=1e-9)
    assert BAR.cut(PARTS["none"], 0.0, 5, lambda reading: 99.0).command.max() < 10.0


def test_a_command_acts_one_computed_sample_later():
    step = BAR.probe(np.array([0.0, 5.0, 5.0, 5.0, 5.0]))
    moved = np.abs(step.deflection) > 1e-9
    # put out at sample 1, held from 2 on, seen at the end of that sample
    np.testing.assert_array_equal(moved, [False, False, False, True, True])


def test_the_cutter_leaves_a_wall_that_is_not_there():
    air = dataclasses.replace(SMOOTH, depth=-50.0)
    assert not BAR.cut(air, 600, 200).deflection.any()


def test_eccentricity_turns_with_the_spindle_and_moves_the_hole_only():
    part = dataclasses.replace(SMOOTH, eccentricity=100.0)
    cut = BAR.cut(part, 600, 1200)
    turn = slice(1000, 1200)
    wave = cut.deflection[turn] @ np.exp(-2j * np.pi * cut.angle[turn]) / 100
    assert abs(wave) == pytest.approx(4.4, rel=0.02)
    assert roundness(cut.angle[turn], cut.trace[turn]) < 0.01


def test_a_taper_deepens():
    part = dataclasses.replace(SMOOTH, taper=TAPER_SLOPE, feed=10 / 60)
    cut = BAR.cut(part, 600, 4000)
    deeper = TAPER_SLOPE * 10 / 60 * PERIOD * 2000
    change = cut.deflection[3900] - cut.deflection[1900]
    assert change == pytest.approx(-0.044 * deeper, rel=0.01)


def test_uncompensated_traces_are_about_as_far_from_round_as_the_printed_ones():
    values = []
    for seed in np.random.SeedSequence(8).spawn(6):
        cut = BAR.cut(PARTS["taper"], 600, 2000, seed=seed)
        values += [roundness(cut.angle[k : k + 200], cut.trace[k : k + 200]) for k in (1000, 1600)]
    assert 5.0 < np.mean(values) < 8.5


def test_a_seed_repeats_a_cut_and_another_does_not():
    first, again, other = (BAR.cut(PARTS["taper"], 600, 300, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.trace, again.trace)
    assert np.ptp(first.trace - other.trace) > 0.1


@pytest.mark.parametrize("wave", [2, 3, 7])
def test_roundness_leaves_circle_and_centre_out(wave):
    angle = np.arange(720) / 720
    radius = 15000 + 40 * np.cos(2 * np.pi * (angle - 0.2)) + 1.5 * np.cos(
        2 * np.pi * wave * angle
    )  # fmt: skip
    assert roundness(angle, radius) == pytest.approx(3.0, rel=1e-3)
    rough = radius + 5 * np.cos(2 * np.pi * 200 * angle)
    assert roundness(angle, rough) == pytest.approx(3.0, rel=1e-3)


def run(*arguments):
    return CliRunner().invoke(command, [str(a) for a in ("boring-bar", *arguments)])


def test_the_command_writes_a_log(tmp_path):
    target = tmp_path / "cut.csv"
    result = run("--duration", 0.1, "--part", "eccentric", "--speed", 750, "-o", target)
    assert result.exit_code == 0, result.output
    log = read_log(str(target))
    assert len(log) == 200
    np.testing.assert_allclose(np.diff(log.time), PERIOD)
    assert set(log.columns) == {
        "n_spindle_rpm", "U_command_V", "e_tool_um", "d_tool_um", "d_trace_um"
    }  # fmt: skip
    assert not log.column("U_command_V").any()


def test_commands_of_a_log_drive_the_piezo(tmp_path):
    given, target = tmp_path / "commands.csv", tmp_path / "trial.csv"
    given.write_text("time_s,U_command_V\n0,1\n0.0005,2\n0.001,3\n")
    result = run("--part", "none", "--duration", 0.01, "--commands", given, "-o", target)
    assert result.exit_code == 0, result.output
    log = read_log(str(target))
    np.testing.assert_allclose(log.column("U_command_V"), [1, 2] + [3] * 18, atol=0.003)
    assert log.column("d_tool_um")[-1] > 1
