"""rc: logs and declared networks in, parameters and a model file out; faults are one line."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from machines.lumped import Chain, inputs

ONE = """
format = "thermaltool-rc"
version = 1

[nodes.motor]
measured = "T_motor_degC"

[links.motor-room]
between = ["motor", "T_room_degC"]

[heat.motor]
channel = "Q_motor_W"
node = "motor"
"""
INSIDE = ONE.replace('"motor", "T_room_degC"', '"motor", "frame"').replace("motor-room", "inside")
TWO = f"""{INSIDE}
[nodes.frame]

[links.outside]
between = ["frame", "T_room_degC"]
"""


@pytest.fixture
def run(tmp_path, thermaltool):
    """Two logs and two networks in a folder, and the command on them."""
    for name, text in (("one.toml", ONE), ("two.toml", TWO)):
        (tmp_path / name).write_text(text)
    rng = np.random.default_rng(77)
    for name in ("run.csv", "other.csv"):
        time, heat, room = inputs(500, 10.0, rng)
        motor = Chain((800.0, 4000.0), (5.0, 8.0)).run(time, heat, room, rng)
        np.savetxt(tmp_path / name, np.column_stack([time, heat, room, motor]), delimiter=",",
                   fmt="%.6f", header="time_s,Q_motor_W,T_room_degC,T_motor_degC",
                   comments="")  # fmt: skip

    def call(*arguments):
        return thermaltool("rc", tmp_path / "run.csv", *arguments)

    call.folder = tmp_path
    return call


@pytest.mark.slow
def test_printed_fit_is_that_of_simulate(run, thermaltool):
    folder = run.folder
    done = run("--network", folder / "two.toml", "--validate", folder / "other.csv", "--json", "-o",
               folder / "model.json")  # fmt: skip
    assert done.code == 0
    (network,) = done.json["networks"]
    assert network["converged"]
    agreements = {a["log"]: a for a in network["agreements"]}
    for name, rows in (("run.csv", "fitted"), ("other.csv", "held out")):
        told = agreements[str(folder / name)]
        assert told["rows"] == rows
        assert told["simulated"]["fit_percent"] > 90
        again = thermaltool("simulate", folder / "model.json", folder / name, "--json", "-o",
                            folder / "out.csv")  # fmt: skip
        assert told["simulated"]["fit_percent"] == again.json["T_motor_degC"]["fit_percent"]
        assert told["one_step"]["fit_percent"] > 95
    for name, value in (("links.inside", 5.0), ("links.outside", 8.0)):
        e = network["parameters"][f"{name}.conductance"]
        assert e["unit"] == "W/K"
        assert e["value"] == pytest.approx(value, rel=0.05)
        assert network["resistances"][f"{name}.conductance"]["value"] == 1 / e["value"]


@pytest.mark.slow
def test_networks_are_compared_and_the_sufficient_one_is_written(run):
    folder = run.folder
    done = run("--network", folder / "two.toml", "--network", folder / "one.toml", "--split", "0.7",
               "-o", folder / "model.json", "-q")  # fmt: skip
    assert done.code == 0
    assert done.out.rstrip().endswith("sufficient: two")
    assert "carried on %" in done.out
    assert "K/W" in done.out
    model = json.loads((folder / "model.json").read_text())
    assert {term["kind"] for term in model["terms"]} == {"rational2"}


@pytest.mark.slow
def test_missing_readings_and_a_pause_are_left_out(run):
    lines = (run.folder / "run.csv").read_text().splitlines()
    lines = [line.rpartition(",")[0] + "," if k % 7 == 3 else line for k, line in enumerate(lines)]
    (run.folder / "run.csv").write_text("\n".join(lines[:200] + lines[240:]) + "\n")
    done = run("--network", run.folder / "two.toml", "--json")
    assert done.code == 0
    (network,) = done.json["networks"]
    assert network["readings"] < network["rows"]
    for name, value in (("links.inside", 5.0), ("links.outside", 8.0)):
        low, high = network["parameters"][f"{name}.conductance"]["interval"]
        assert 2 * low - high <= value <= 2 * high - low


FAULTS = [
    ("version = 1", "version = 2", "version 2 is newer"),
    ('format = "thermaltool-rc"', "", "not a network of thermaltool rc"),
    ('measured = "T_motor_degC"', "capcity = 3", "nodes.motor: no field 'capcity'"),
    ('measured = "T_motor_degC"', "", "nodes: none is measured"),
    ('measured = "T_motor_degC"', 'measured = "Q_motor_W"', "nodes.motor.measured: Q_motor_W is"),
    ("[nodes.motor]", "[nodes.motor]\ncapacity = -3", "nodes.motor.capacity: not above 0: -3"),
    ("[nodes.motor]", "[nodes.motor]\ncapacity = {start = 'x'}", "nodes.motor.capacity: start: "),
    ("[nodes.motor]", "[nodes.motor]\ncapacity = {start = 1, fixed = 2}", "start or fixed"),
    ("[nodes.motor]", "[nodes.foot]\nnoise = 1\n[nodes.motor]", "foot.noise: the node is not"),
    ("[nodes.motor]", "[nodes.foot]\n[nodes.motor]", "nodes.foot: no path of links to a boundary"),
    ('["motor", "T_room_degC"]', '["motor", "frme"]', "'frme' is no node, boundary or channel"),
    ('["motor", "T_room_degC"]', '["motor"]', "links.motor-room.between: two ends, not 1"),
    ('["motor", "T_room_degC"]', '["motor", "motor"]', "both ends are motor"),
    ('["motor", "T_room_degC"]', '["motor", "dT_room_K"]', "never mixed"),
    ('node = "motor"', 'node = "moter"', "heat.motor.node: 'moter' is no node (near: motor)"),
    ('node = "motor"', 'node = "motor"\nshare = 1.5', "heat.motor.share: not between 0 and 1"),
    ('node = "motor"', 'node = "motor"\nshare = "rest"', "the rest of Q_motor_W goes with exactly"),
    ('node = "motor"', 'node = "motor"\ngain = 2', "heat.motor.gain: Q_motor_W is in watts"),
    ('channel = "Q_motor_W"', 'channel = "U_motor_V"', "'gain' says its watts per unit"),
    ('channel = "Q_motor_W"', 'channel = "Q_pump_W"', "no column Q_pump_W"),
    ("[nodes.motor]", "[nodes", "not TOML"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS, ids=[f[2][:30] for f in FAULTS])
def test_a_bad_field_is_one_line_with_its_name(run, old, new, message):
    assert old in ONE
    (run.folder / "bad.toml").write_text(ONE.replace(old, new))
    done = run("--network", run.folder / "bad.toml")
    assert done.code == 1
    assert message in done.err
    assert len(done.err.splitlines()) == 1
    assert "unexpected" not in done.err


@pytest.mark.slow
def test_sample_networks_run_as_the_page_says(thermaltool, tmp_path):
    samples = Path(__file__).parents[2] / "data_samples"
    log = tmp_path / "duty.csv"
    frame = samples / "frame_duty.parquet"
    assert thermaltool("check", frame, "--resample", "30", "-o", log).code == 0
    one, two = (samples / "networks" / name for name in ("column.toml", "column_frame.toml"))
    done = thermaltool("rc", log, "--network", one, "--network", two, "--json")
    assert done.json["sufficient"] == "column_frame"
    for network in samples.glob("networks/heating_*.toml"):
        done = thermaltool("rc", log, "--network", network)
        assert "no column U_lamp_V" in done.err


def test_the_network_is_not_replaced_by_the_model(run):
    done = run("--network", run.folder / "one.toml", "-o", run.folder / "one.toml")
    assert done.code == 2
    assert tomllib.loads((run.folder / "one.toml").read_text())["nodes"]
