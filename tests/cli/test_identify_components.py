"""identify with many inputs: nothing is said, and components of them are taken."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from machines.bar import NAMES, ROWS, bar

INPUTS = [part for name in NAMES for part in ("--input", name)]
CALL = [*INPUTS, "--output", "d_z_um"]


def write_log(path, temperatures, growth, time):
    columns = np.vstack([time, temperatures, growth]).T
    np.savetxt(path, columns, delimiter=",", fmt="%.10g", comments="",
               header=",".join(["time_s", *NAMES, "d_z_um"]))  # fmt: skip
    return path


@pytest.fixture(scope="module")
def machine():
    return bar(np.random.default_rng(1795470002))


@pytest.fixture
def log(tmp_path, machine):
    return write_log(tmp_path / "run.csv", *machine)


@pytest.fixture(scope="module")
def model(tmp_path_factory, machine):
    """A model by the first 60 % of the rows, with its design."""
    import thermaltool as tt

    folder = tmp_path_factory.mktemp("bar")
    log = write_log(folder / "run.csv", *machine)
    found = tt.identify(log, NAMES, ["d_z_um"], split=0.6, warn=lambda message: None)
    tt.write_model(tt.regularize(found, warn=lambda message: None), folder / "model.json")
    return folder / "model.json"


@pytest.mark.slow
def test_defaults_take_components_and_say_so(thermaltool, log, tmp_path):
    model = tmp_path / "model.json"
    done = thermaltool("identify", log, *CALL, "--split", "0.6", "-o", model)
    assert done.code == 0, done.err
    assert "16 inputs of which" in done.err
    assert "--structure components; --structure oe" in done.err
    assert "choices those that count most" in done.out
    start = done.out.split("--start ")[1].split()[0]
    again = thermaltool("simulate", model, log, "--start", start, "--json")
    shown = thermaltool("identify", log, *CALL, "--split", "0.6", "--json").json["models"][0]
    assert shown["structure"] == "components"
    assert again.json["d_z_um"]["fit_percent"] == pytest.approx(
        shown["validation"]["fit_percent"], abs=0.5
    )
    assert shown["validation"]["fit_percent"] > 90


def test_few_inputs_have_transfer_functions(thermaltool, log):
    few = INPUTS[:4]
    done = thermaltool("identify", log, *few, "--output", "d_z_um", "--orders", "1,1,0", "--json")
    assert done.json["models"][0]["structure"] == "oe"


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--reduce", "pca:0"), "the number of components is 1 or more"),
        (("--reduce", "pca:99"), "there are 16 inputs"),
        (("--reduce", "foo"), "none of pca, pls, none, pca:k, pls:k"),
        (("--reduce", "none:4"), "it keeps all inputs"),
        (("--reduce", "pca", "--structure", "oe"), "--reduce goes with --structure components"),
        (("--structure", "components", "--orders", "1,1,1"), "components take --reduce"),
        (("--structure", "components", "--modes", "2"), "--modes goes with"),
        (("--reduce", "pls", "--delay", "auto"), "--delay goes with"),
        (("--reduce", "pls", "--real-poles"), "--real-poles"),
    ],
)
def test_options_that_contradict(thermaltool, log, options, why):
    done = thermaltool("identify", log, *CALL, *options)
    assert done.code == 2
    assert why in done.err


def test_a_sensor_with_holes(thermaltool, machine, tmp_path):
    """Named; its last value stands in where that is asked for."""
    temperatures, growth, time = machine
    holed = temperatures.copy()
    holed[3, 5::7] = np.nan
    log = write_log(tmp_path / "holes.csv", holed, growth, time)
    refused = thermaltool("identify", log, *CALL)
    assert refused.code == 1
    assert "T_s4_degC" in refused.err
    done = thermaltool("identify", log, *CALL, "--nan-policy", "hold", "--split", "0.6", "--json")
    assert done.code == 0, done.err
    assert done.json["models"][0]["validation"]["fit_percent"] > 90


def compensated(model, log):
    """Lines of compensate with estimates and status, and its messages."""
    tool = [sys.executable, "-c", "from thermaltool.cli import main; main()", "compensate"]
    arguments = [model, log, "--also", "estimates", "--also", "status"]
    done = subprocess.run([*tool, *arguments], capture_output=True, text=True, check=True)
    return [line.split(",") for line in done.stdout.splitlines()[1:]], done.stderr


def without(log, path, columns, first):
    """The log without readings of these columns from a line on."""
    rows = log.read_text().splitlines()
    for k in range(first, len(rows)):
        cells = rows[k].split(",")
        cells[columns] = [""] * len(cells[columns])
        rows[k] = ",".join(cells)
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("first", [1, 600])
def test_the_others_stand_for_a_dead_sensor(log, model, tmp_path, first):
    """From the first row on, or later: the announced band bounds what is lost."""
    column = 1 + NAMES.index("T_s5_degC")
    dead = without(log, tmp_path / "dead.csv", slice(column, column + 1), first)
    (whole, _), (left, messages) = compensated(model, log), compensated(model, dead)
    assert "T_s5_degC: left out, the others go on" in messages
    said = messages.split("the band widens: d_z_um by ")[1].split()[0]
    assert len(whole) == len(left) >= ROWS
    apart = np.array([float(a[2]) - float(b[2]) for a, b in zip(whole, left, strict=True)])
    assert 0 < np.sqrt(np.mean(apart**2)) < float(said)
    # The last line is the safe one.
    assert {line[3] for line in left[700 : ROWS - 10]} == {"reduced"}


def test_too_many_dead_sensors_are_safe(log, model, tmp_path):
    dead = without(log, tmp_path / "dead.csv", slice(1, 9), 600)
    lines, _ = compensated(model, dead)
    assert {line[3] for line in lines[700:]} == {"safe"}
