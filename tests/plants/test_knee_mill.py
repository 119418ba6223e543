"""The knee mill: laws of its contact, balances, how far it is from proportion, the command."""

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from thermaltool.cli.plant import command
from thermaltool.plants import SettingError, build
from thermaltool.plants.contact import KILOGRAM_PER_CM2, Joint, Surface
from thermaltool.plants.knee_mill import KneeMillGeometry, knee_mill_mesh

DT, DURATION = 100.0, 6000.0
ROOM = Path(__file__).parents[2] / "thermaltool" / "plants"
plant = cache(build)


@cache
def response(level, load=0.0):
    n = round(DURATION / DT) + 1
    return plant("knee-mill").simulate(np.full(n, level), np.full(n, 20.0), DT, load)


def test_shares_no_code_with_models():
    for name in ("contact", "jointed", "knee_mill"):
        tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
        modules = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        own = {m for m in modules if m.startswith("thermaltool")}
        assert all(m.startswith("thermaltool.plants") for m in own)


def test_laws_of_the_source():
    """Fraser (1997), 4.4.5: λ = 0.65 sqrt(p); stiffness p^(1-m)/(m c) (4.2); R/sqrt(p) (4.5)."""
    surface = Surface()
    approach = surface.approach(45.0)
    assert approach == pytest.approx(0.65 * np.sqrt(45.0))
    pressure, slope = surface.pressure(np.array([approach, 0.0, -3.0]))
    np.testing.assert_allclose(pressure, [45.0, 0.0, 0.0])
    np.testing.assert_allclose(slope, [np.sqrt(45.0) / (0.5 * 0.65), 0.0, 0.0])
    stiffness, by_pressure = surface.shear_stiffness(pressure)
    np.testing.assert_allclose(stiffness, [np.sqrt(45.0) / 0.75, 0.0, 0.0])
    assert by_pressure[1] == 0.0
    passes = surface.conductance(pressure, 46.5)
    np.testing.assert_allclose(passes, [0.14 * 46.5 / 1.25e-6 * 45.0 / 20000.0, 0.0, 0.0])


def test_a_single_pair_is_in_equilibrium_and_slips():
    area, flexibility = np.array([1e-3]), 1e-9
    joint = Joint(Surface(), 45.0, area, flexibility * np.eye(3))
    opened = joint.equilibrium(np.array([5.0, 0.0, 0.0]), joint.closed(), np.zeros((2, 1)))
    assert opened.converged
    # What the joint lacks in pressure pulls the gap shut.
    force = area * KILOGRAM_PER_CM2 * (opened.pressure - 45.0)
    np.testing.assert_allclose(opened.gap[0], 5.0 + 1e6 * flexibility * force, atol=1e-5)
    assert 0 < opened.pressure[0] < 45.0
    sheared = joint.equilibrium(np.array([0.0, 8.0, 0.0]), joint.closed(), np.zeros((2, 1)))
    friction = 0.2 * sheared.pressure[0] * area[0] * KILOGRAM_PER_CM2
    assert -sheared.force[1] == pytest.approx(friction, rel=1e-9)
    assert 0 < sheared.slip[0, 0] < sheared.gap[1, 0] < 8.0
    away = joint.equilibrium(np.array([9e3, 0.0, 0.0]), joint.closed(), np.zeros((2, 1)))
    assert away.pressure[0] == 0.0


def test_the_joint_has_two_sides_and_the_area_of_the_strips():
    mesh, column, knee = knee_mill_mesh(KneeMillGeometry())
    np.testing.assert_array_equal(mesh.p[:, column], mesh.p[:, knee])
    assert not np.intersect1d(column, knee).size
    assert np.isin(knee, mesh.t).all()
    area = plant("knee-mill").bodies.joint.area
    assert area.sum() == pytest.approx(0.4 * 0.075)
    assert np.all(area > 0)


def test_heat_is_balanced():
    """All heat is stored or convected: the joint takes from one side what the other gets."""
    there = plant("knee-mill")
    run = there.start(DT)
    one = np.ones(there.heat.size)
    assert there.heat.sum() == pytest.approx(197.5 / 2)
    stored = []
    for _ in range(5):
        stored.append(one @ (there.thermal.capacity @ run.rise))
        run.advance(2.0, 0.0)
    convected = there.thermal.film @ run.rise
    change = (one @ (there.thermal.capacity @ run.rise) - stored[-1]) / DT
    assert change + convected == pytest.approx(197.5, rel=2e-3)


def test_at_rest_nothing_moves():
    still = plant("knee-mill").simulate(np.zeros(4), np.full(4, 20.0), DT, 4448.0)
    for name, values in still.items():
        assert np.ptp(values) < 1e-4, name
        assert values[0] == (20.0 if name.startswith("T_") else 0.0)


@pytest.mark.slow
def test_size_of_the_departure_from_proportion():
    """Of the order of the source's 3.4 % in y and 2 % in x at Q = 2; the other way at 0.5."""
    reference, double, half = (response(level) for level in (1.0, 2.0, 0.5))
    for name, low, high in (("d_y_um", 2.5, 5.0), ("d_x_um", 1.5, 6.0)):
        off = double[name] - 2 * reference[name]
        assert low < 100 * np.max(np.abs(off)) / np.max(np.abs(double[name])) < high
        assert off[-1] * (half[name] - 0.5 * reference[name])[-1] < 0
    # Close to the source the temperatures stay in proportion, at the joint they do not.
    near, joint = "dT_main_K", "T_joint1_degC"
    assert np.max(np.abs(double[near] - 2 * reference[near])) < 0.01 * np.max(double[near])
    assert np.max(np.abs(double[joint] - 2 * reference[joint] + 20.0)) > 0.5


def test_a_load_on_the_table_changes_what_the_heat_does():
    off = response(1.0, 4448.0)["d_y_um"] - response(1.0)["d_y_um"]
    assert 0.1 < np.max(np.abs(off)) < 5.0


@pytest.mark.slow
def test_shorter_steps_agree():
    heat, air = np.full(16, 2.0), np.full(16, 20.0)
    coarse, finer, finest = (
        plant("knee-mill").simulate(heat, air, DT, substeps=steps) for steps in (1, 2, 8)
    )
    for name in ("d_x_um", "d_y_um"):
        errors = [np.max(np.abs(each[name] - finest[name])) for each in (coarse, finer)]
        assert errors[1] < errors[0] / 2


def test_convergence_is_reported_and_its_lack_is_an_error():
    run = plant("knee-mill").start(DT)
    run.advance(2.0, 0.0)
    assert run.iterations > 0
    assert run.residual < 1e-6
    with pytest.raises(SettingError, match="from the start: less heat or load"):
        plant("knee-mill").simulate(np.full(50, 1e9), np.full(50, 20.0), DT)


def test_the_command_writes_its_log():
    arguments = ["knee-mill", "--duration", "300", "--load", "4448", "--clean"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0] == (
        "time_s,Q_main_1,T_ambient_degC,dT_main_K,T_joint1_degC,T_joint2_degC,T_joint3_degC,"
        "T_joint4_degC,T_column_degC,T_table_degC,d_x_um,d_y_um"
    )
    assert len(lines) == 1 + 31
    refused = CliRunner().invoke(command, ["frame", "--load", "1"])
    assert "--load is not for frame, but for knee-mill" in refused.stderr
