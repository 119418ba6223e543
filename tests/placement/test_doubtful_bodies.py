"""Bodies that are declared wrongly, or in another unit than their mesh."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import linalg as sparse_linalg

from thermaltool.errors import FitError, ModelError
from thermaltool.placement import thermal_modes
from thermaltool.placement.finite_elements import FiniteElements
from thermaltool.placement.meshes import MeshData, solid_mesh
from thermaltool.report.thermal_modes import mode_notes, mode_table


def modes_of(body, count=None):
    return thermal_modes.thermal_modes(FiniteElements(body).equations(), count)


def test_a_heat_is_of_areas_or_of_volumes(rod, load):
    rod["heat"]["Q_motor_W"]["on"] = ["left", "body"]
    with pytest.raises(ModelError, match="left is a boundary and body a region"):
        load(rod)


def test_a_name_is_a_region_or_a_boundary(load):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    data = MeshData(points, np.array([[0, 1, 2, 3]]), {"housing": np.array([0])},
                    {"housing": np.array([[0, 1, 2]])})  # fmt: skip
    document = {
        "format": "thermaltool-body", "version": 1, "mesh": {"file": "x.msh"},
        "materials": {"iron": {"conductivity": 50, "density": 7800, "specific_heat": 434}},
        "convection": {"housing": 10}, "heat": {"Q_motor_W": {"on": "housing"}},
    }  # fmt: skip
    from thermaltool.placement.declaration import load_body

    with pytest.raises(ModelError, match="'housing' is a region and a boundary"):
        load_body(document, "body.toml", lambda path, unit: data)


def test_of_sets_that_overlap_those_that_have_a_material_count():
    from thermaltool.placement.declaration import load_body

    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    sets = {"base": [0], "Volume1": [0], "arm": [1], "all": [0, 1]}
    data = MeshData(points, np.array([[0, 1, 2, 3], [1, 2, 3, 4]]),
                    {name: np.array(rows) for name, rows in sets.items()},
                    {"foot": np.array([[0, 1, 2]])})  # fmt: skip
    document = {
        "format": "thermaltool-body", "version": 1, "mesh": {"file": "x.inp"},
        "materials": {"iron": {"conductivity": 50, "density": 7800, "specific_heat": 434}},
        "regions": {"base": "iron", "arm": "iron"},
        "convection": {"foot": 10}, "heat": {"Q_motor_W": {"on": "foot"}},
    }  # fmt: skip
    body = load_body(document, "body.toml", lambda path, unit: data)
    assert set(body.regions) == {"base", "arm"}
    with pytest.raises(ModelError, match=r"in several regions \(base, Volume1, arm, all\)"):
        load_body(document | {"regions": {"bse": "iron"}}, "b.toml", lambda path, unit: data)
    bare = MeshData(points, data.elements)
    with pytest.raises(ModelError, match="the mesh has no boundary: name its surfaces"):
        load_body(document | {"regions": {"body": "iron"}}, "b.toml", lambda path, unit: bare)


def test_a_point_outside_is_refused(rod, load):
    rod["points"]["T_1_degC"]["at"] = 1.03
    with pytest.raises(ModelError, match=r"T_1_degC: \(1.03\) m is 0.03 m from the body"):
        modes_of(load(rod))


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_a_length_that_no_machine_part_has_is_doubted(rod, load, unit):
    rod["mesh"]["unit"] = unit
    for table in ("points", "deflections"):
        rod[table] = {}
    body = load(rod)
    doubts = " ".join(mode_notes(modes_of(body), body))
    assert ("the body is 0.001 m long: is the unit of [mesh] right?" in doubts) == (unit == "mm")


def test_a_flat_element_is_named():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], float)
    data = MeshData(points, np.array([[0, 1, 2, 3], [0, 1, 2, 4]]))
    with pytest.raises(ModelError, match="1 of 2 elements are flat, the first is element 2 at"):
        solid_mesh(data)


def test_iterations_without_an_end_are_told(rod, load, monkeypatch):
    def endless(*_, **__):
        raise sparse_linalg.ArpackNoConvergence("%s %s", np.empty(0), np.empty(0))

    monkeypatch.setattr(sparse_linalg, "eigsh", endless)
    rod["mesh"]["rod"]["elements"] = 700
    with pytest.raises(FitError, match="20 modes are not found after many iterations"):
        modes_of(load(rod))


def test_a_body_in_another_unit_is_doubted(rod, block, load):
    for document in (rod, block):
        body = load(document)
        assert not [each for each in mode_notes(modes_of(body), body) if "unit" in each]
    block["mesh"]["block"] = {"size": [200, 100, 80], "divisions": [6, 4, 4]}
    block["points"]["T_tip_degC"]["at"] = [10, 50, 40]
    block["deflections"]["d_tip_um"]["at"] = [200, 0, 80]
    block["convection"].update(top=20.0, bottom=20.0)
    body = load(block)
    told = mode_notes(modes_of(body), body)
    assert "the body is 200 m long: is the unit of [mesh] right?" in told
    assert any("T_tip_degC by Q_motor_W: modes of up to" in each for each in told)


def test_a_mesh_too_coarse_cools_where_it_is_heated(rod, load):
    rod["mesh"]["rod"].update(length=300.0)
    rod["points"], rod["deflections"] = {}, {}
    body = load(rod)
    assert any("Q_motor_W cools parts of the body" in each
               for each in mode_notes(modes_of(body), body))  # fmt: skip


def test_a_gain_is_per_unit_of_the_heat(rod, load):
    rod["heat"] = {"Q_motor_kW": {"on": "left"}}
    body = load(rod)
    found = modes_of(body)
    row = next(line for line in mode_table(found, body, "rod").splitlines()
               if line.startswith("T_1_degC") and "Q_motor_kW" in line)  # fmt: skip
    _, _, gain, unit, *_ = row.split()
    assert (float(gain), unit) == (pytest.approx(1e3 * found.gains[0, 0], rel=1e-3), "K/kW")
