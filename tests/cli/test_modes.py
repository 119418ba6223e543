"""modes: a declared body or a log in; table, JSON and figures out; faults are one line."""

from __future__ import annotations

import json
import subprocess
import sys

import meshio
import numpy as np
import pytest
from machines.shared_modes import SPINDLE_GAINS, SPINDLE_TAUS, SharedModes
from skfem import MeshTet

ROD = """
format = "thermaltool-body"
version = 1
name = "spindle rod"

[mesh]
rod = {length = 1000, area = 31400, elements = 22}
unit = "mm"

[materials.steel]
conductivity = 60.5
density = 7800
specific_heat = 434
expansion = 10.8e-6
youngs_modulus = 120e9

[convection]
side = 20

[heat.Q_motor_W]
on = "left"

[points.T_1_degC]
at = 100

[deflections.d_tip_um]
at = 1000
direction = "x"

[supports]
fixed = ["left"]
"""
COLUMN = """
format = "thermaltool-body"
version = 1

[mesh]
file = "column.msh"
unit = "mm"

[materials.steel]
conductivity = 50
density = 7850
specific_heat = 480
expansion = 12e-6
youngs_modulus = 205e9

[materials.iron]
conductivity = 45
density = 7200
specific_heat = 500
expansion = 10e-6
youngs_modulus = 120e9

[regions]
base = "iron"
"upper arm" = "steel"

[convection]
skin = 12

[heat.Q_motor_W]
on = ["tip"]

[points.T_tip_degC]
at = [300, 30, 40]

[deflections.d_x_um]
at = [300, 30, 40]
direction = "x"
against = [0, 0, 0]

[supports]
fixed = ["foot"]
"""


def write_column(path, apart=0.0):
    """A box of tetrahedra [mm] in two regions, as Gmsh writes it, with a point of no element."""
    mesh = MeshTet.init_tensor(np.linspace(0, 300, 7), np.linspace(0, 60, 3), np.linspace(0, 80, 3))
    regions = np.where(mesh.p[0, mesh.t].mean(axis=0) < 100, 1, 2)
    points, cells = mesh.p.T, mesh.t.T
    if apart:
        cells = np.where(regions[:, None] == 2, cells + len(points), cells)
        points = np.vstack([points, points + np.array([apart, 0, 0])])
    facets = mesh.facets[:, mesh.boundary_facets()]
    place = mesh.p[0, facets].mean(axis=0)
    tags = np.where(np.isclose(place, 0), 10, np.where(np.isclose(place, 300), 11, 12))
    meshio.write(path, meshio.Mesh(
        np.vstack([points, [[9e3, 9e3, 9e3]]]),
        [("triangle", facets.T), ("tetra", cells)],
        cell_data={name: [tags, regions] for name in ("gmsh:physical", "gmsh:geometrical")},
        field_data={"base": np.array([1, 3]), "upper arm": np.array([2, 3]),
                    "foot": np.array([10, 2]), "tip": np.array([11, 2]),
                    "skin": np.array([12, 2])},
    ), file_format="gmsh22", binary=False)  # fmt: skip


@pytest.fixture
def spindle_log(tmp_path):
    time = np.arange(0.0, 24 * 3600.0, 300.0)
    duty = [(600.0, 0.0), (8 * 3600.0, 1.0), (16 * 3600.0, 0.0)]
    plant = SharedModes(SPINDLE_TAUS, SPINDLE_GAINS)
    readings = plant.readings(time, duty, 0.02, np.random.default_rng(5))
    names = ["time_s", *readings]
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, *readings.values()]), delimiter=",",
               fmt="%.4f", header=",".join(names), comments="")  # fmt: skip
    return tmp_path / "run.csv"


LOG_CALL = ("--drive", "duty_spindle_1", *(f"--sensor={name}" for name in SPINDLE_GAINS))


def test_a_rod_gives_table_json_and_figure(thermaltool, tmp_path):
    (tmp_path / "rod.toml").write_text(ROD)
    out = tmp_path / "modes.json"
    done = thermaltool("modes", tmp_path / "rod.toml", "-o", out, "--plot", tmp_path / "m.png")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("spindle rod: 23 nodes, 22 elements, all modes")
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads(out.read_text())
    first, second, third = found["modes"][:3]
    assert first["time_constant_s"] / 60 == pytest.approx(141.0, abs=0.05)
    assert first["relative_weights"]["Q_motor_W"] == pytest.approx(0.477, abs=0.001)
    assert (second["nodes_m"], third["nodes_m"]) == (
        [pytest.approx(0.5)], [pytest.approx(0.25, abs=0.002), pytest.approx(0.75, abs=0.002)]
    )  # fmt: skip
    assert second["extremes"][1] == {"value": pytest.approx(-1), "at_m": [pytest.approx(1.0)]}
    gain = found["gains"]["d_tip_um"]["Q_motor_W"]
    # All heat leaves by the side: mean temperature 1/(h P L), times α L.
    mean = 1 / (20 * 2 * np.sqrt(np.pi * 0.0314))
    assert gain["value"] == pytest.approx(10.8 * mean, rel=1e-6)


def test_the_model_of_a_rod_runs_in_other_commands(thermaltool, tmp_path):
    (tmp_path / "rod.toml").write_text(ROD)
    model, log = tmp_path / "model.json", tmp_path / "heat.csv"
    done = thermaltool("modes", tmp_path / "rod.toml", "--model", model)
    assert done.code == 0
    assert "model: off the mesh by at most T_1_degC 0.29 %, d_tip_um 0.00 % of" in done.err
    log.write_text("time_s,Q_motor_W\n" + "".join(f"{60 * k},{200}\n" for k in range(3000)))
    simulated = thermaltool("simulate", model, log)
    assert simulated.code == 0
    lines = [line.split(",") for line in simulated.out.splitlines()]
    last = dict(zip(lines[0], map(float, lines[-1]), strict=True))
    mean = 1 / (20 * 2 * np.sqrt(np.pi * 0.0314))
    assert last["d_tip_um"] == pytest.approx(200 * 10.8 * mean, rel=1e-4)


@pytest.mark.slow
def test_the_model_of_a_rod_compensates(thermaltool, tmp_path):
    (tmp_path / "rod.toml").write_text(ROD)
    model, designed = tmp_path / "model.json", tmp_path / "designed.json"
    assert thermaltool("modes", tmp_path / "rod.toml", "--model", model).code == 0
    rows = "time_s,T_1_degC\n"
    idle = 20 + 0.02 * np.random.default_rng(2).standard_normal(2000)
    (tmp_path / "idle.csv").write_text(
        rows + "".join(f"{10 * k},{x:.4f}\n" for k, x in enumerate(idle))
    )
    noise = tmp_path / "noise.json"
    assert thermaltool("noise", tmp_path / "idle.csv", "-o", noise).code == 0
    assert thermaltool("regularize", model, "--noise", noise, "-o", designed).code == 0
    warming = tmp_path / "warming.csv"
    warming.write_text(rows + "".join(f"{10 * k},{20 + 0.01 * k:.4f}\n" for k in range(200)))
    command = [sys.executable, "-m", "thermaltool", "compensate", designed, warming]
    compensated = subprocess.run(command, capture_output=True, text=True, check=True)
    # The last line is the safe setpoint; the tip has grown by some micrometres before.
    assert -9.0 < float(compensated.stdout.splitlines()[-2].split(",")[1]) < -3.0


def test_a_mesh_file_of_gmsh(thermaltool, tmp_path):
    write_column(tmp_path / "column.msh")
    (tmp_path / "column.toml").write_text(COLUMN)
    done = thermaltool("modes", tmp_path / "column.toml", "--plot", tmp_path / "m.png", "--json")
    assert done.code == 0
    assert done.json["nodes"] == 63
    # Two materials in a row, one face heated, sides cooled: slower than either alone would be.
    assert 60 < done.json["modes"][0]["time_constant_s"] / 60 < 120
    assert (tmp_path / "m.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('base = "iron"', 'bass = "iron"', "the mesh has no region 'bass' (near: base)"),
        ('base = "iron"', 'base = "irn"', "regions.base: no material 'irn' (near: iron)"),
        ('base = "iron"', "", "regions: 'base' is missing"),
        ("specific_heat = 500", "", "materials.iron: 'specific_heat' is missing"),
        ("expansion = 12e-6", "", "materials.steel: 'expansion' is missing"),
        ("conductivity = 50", "conductivity = -50", "steel.conductivity: not above 0: -50"),
        ("skin = 12", "skn = 12", "the mesh has no boundary 'skn' (near: skin)"),
        ("skin = 12", "", "nothing cools the body"),
        ("[300, 30, 40]", "[400, 30, 40]", "T_tip_degC: (0.4, 0.03, 0.04) m is 0.1 m from"),
        ("[300, 30, 40]", "300", "points.T_tip_degC.at: three numbers, not 1"),
        ('direction = "x"', 'direction = "q"', "direction: 'q' is none of x, y, z"),
        ("T_tip_degC", "T_tip_rpm", "points.T_tip_rpm: is no temperature"),
        ("column.msh", "none.msh", "none.msh: cannot be read: No such file"),
        ("column.msh", "column.toml", "column.toml: meshio cannot read this mesh"),
        ('fixed = ["foot"]', "fixed = []", "nothing holds the body"),
        ("[supports]", "[suports]", "no field 'suports' is known (near: supports"),
    ],
)
def test_a_wrong_declaration_is_one_line(thermaltool, tmp_path, before, after, message):
    write_column(tmp_path / "column.msh")
    assert before in COLUMN
    (tmp_path / "column.toml").write_text(COLUMN.replace(before, after))
    done = thermaltool("modes", tmp_path / "column.toml")
    assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
    assert message in done.err


def test_pieces_that_share_no_points_are_named(thermaltool, tmp_path):
    write_column(tmp_path / "column.msh", apart=1.0)
    (tmp_path / "column.toml").write_text(COLUMN)
    done = thermaltool("modes", tmp_path / "column.toml")
    assert done.code == 1
    assert "in 2 pieces that share no points" in done.err


@pytest.mark.slow
def test_a_log_gives_shared_time_constants(thermaltool, tmp_path, spindle_log):
    figure = tmp_path / "m.svg"
    done = thermaltool("modes", spindle_log, *LOG_CALL, "--json", "--plot", figure)
    assert done.code == 0
    taus = done.json["time_constants_s"]
    assert len(taus) == 3
    for found, tau in zip(taus, SPINDLE_TAUS, strict=True):
        assert found["value"] == pytest.approx(tau, rel=0.06)
    channel = done.json["channels"]["T_rear_degC"]["drives"]["duty_spindle_1"]
    assert channel["weights"][1]["value"] == pytest.approx(-2.0, abs=0.2)
    assert "T_rear_degC" in figure.read_text()
    table = thermaltool("modes", spindle_log, *LOG_CALL, "--count", "3")
    assert "3 modes shared by 3 channels" in table.out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "logs need --drive and --sensor"),
        (("--drive", "duty_spindle_1", "--sensor", "duty_spindle_1"), 2, "both drive and follow"),
        (("--drive", "duty_spindle_1", "--sensor", "T_frnt_degC"), 1, "T_front_degC"),
        ((*LOG_CALL, "--stop", "500"), 1, "there is nothing to identify|never moves"),
        ((*LOG_CALL, "--model", "m.json"), 2, "--model is of a body"),
        ((*LOG_CALL, "--stop", "1800", "--count", "3"), 1, "rows do not carry 3 modes"),
    ],
)
def test_a_wrong_call_on_a_log_is_one_line(thermaltool, spindle_log, arguments, code, message):
    done = thermaltool("modes", spindle_log, *arguments)
    assert (done.code, done.out) == (code, "")
    assert any(each in done.err for each in message.split("|")), done.err


def test_options_of_logs_are_refused_for_a_body(thermaltool, tmp_path):
    (tmp_path / "rod.toml").write_text(ROD)
    done = thermaltool("modes", tmp_path / "rod.toml", "--drive", "n_spindle_rpm")
    assert done.code == 2
    assert "--drive is of logs" in done.err
