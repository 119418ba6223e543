"""identify with many inputs: nothing is said, and components of them are taken."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from machines.bar import NAMES, ROWS, bar
from scipy.signal import lfilter

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


@pytest.mark.slow
def test_what_no_output_follows_is_left_out(thermaltool, tmp_path):
    """The model needs only the inputs kept, and each other one is named with its reason."""
    rng = np.random.default_rng(1795573010)
    rows, names = 1200, [f"Q_h{k}_W" for k in range(8)]
    u = np.array(
        [np.repeat(rng.uniform(0, 1, 150), rng.integers(8, 40, 150))[:rows] for _ in names]
    )
    u[6] = 3 * u[2] + 0.01 * rng.standard_normal(rows)
    u[7] = 2.0
    a, y = np.exp(-1 / 30), 20 + 0.02 * rng.standard_normal(rows)
    y += lfilter([0, 1 - a], [1, -a], 2 * (u[2] - u[2, 0]))
    log, model = tmp_path / "run.csv", tmp_path / "model.json"
    np.savetxt(log, np.vstack([np.arange(rows), u, y]).T, delimiter=",", fmt="%.10g", comments="",
               header=",".join(["time_s", *names, "T_out_degC"]))  # fmt: skip
    call = [part for name in names for part in ("--input", name)]
    done = thermaltool("identify", log, *call, "--output", "T_out_degC", "--split", "0.6", "--json",
                       "-o", model)  # fmt: skip
    assert done.code == 0, done.err
    (kept,) = done.json["models"][0]["inputs"]
    assert kept in ("Q_h2_W", "Q_h6_W")
    (copy,) = {"Q_h2_W", "Q_h6_W"} - {kept}
    assert f"{copy} says the same as {kept}: it is left out" in done.err
    assert "Q_h7_W never moves within the rows that are fitted: it is left out" in done.err
    assert "no evidence for Q_h0_W, Q_h1_W, Q_h3_W, Q_h4_W, Q_h5_W: they are left out" in done.err
    assert [each["input"] for each in done.json["inputs_left_out"]] == [
        n for n in names if n != kept
    ]
    few = tmp_path / "few.csv"
    columns = [0, 1 + names.index(kept), 9]
    lines = [line.split(",") for line in log.read_text().splitlines()]
    few.write_text("\n".join(",".join(line[k] for k in columns) for line in lines) + "\n")
    again = thermaltool("simulate", model, few, "--start", "720", "--json")
    assert again.json["T_out_degC"]["fit_percent"] == pytest.approx(
        done.json["models"][0]["validation"]["fit_percent"], abs=0.5
    )


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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("first", [pytest.param(1, marks=pytest.mark.slow), 600])
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


@pytest.mark.slow
def test_calibrate_reduces_as_identify_does(thermaltool, log, tmp_path):
    """One path: the same model, for raw sensors, and for compensate where one of them dies."""
    drives = [part for name in NAMES for part in ("--drive", name)]
    paths = [tmp_path / "calibrated.json", tmp_path / "identified.json"]
    done = thermaltool("calibrate", log, *drives, "--deflection", "d_z_um", "--reduce", "pca:6",
                       "-o", paths[0])  # fmt: skip
    assert done.code == 0, done.err
    assert "rational6_direct" in done.err
    assert "may be zero" not in done.err
    assert "intervals hold given the components and the ridge (d_z_um: 6 of" in done.err
    assert thermaltool("identify", log, *CALL, "--reduce", "pca:6", "-o", paths[1]).code == 0
    own, other = (json.loads(path.read_text()) for path in paths)
    assert own["terms"] == other["terms"]
    assert own["redundancy"] == other["redundancy"]
    assert own["outputs"][0]["role"] == "deflection"
    design = tmp_path / "design.json"
    thermaltool("regularize", paths[0], "-o", design)
    lines, messages = compensated(design, without(log, tmp_path / "dead.csv", slice(4, 5), 200))
    assert "reduced" in {line[-1] for line in lines}
    assert "T_s4_degC" in messages


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--reduce", "pca:0"), "the number of components is 1 or more"),
        (("--reduce", "pls:17"), "there are 16 drives"),
        (("--reduce", "pca", "--linear"), "--linear does not go with --reduce"),
        (("--reduce", "pca", "--fix", "r0=0.1"), "--fix does not go with --reduce"),
        (("--reduce", "pca", "--response", "d_z_um=rational1"), "--response does not go with"),
    ],
)
def test_calibrate_refuses_what_components_do_not_have(thermaltool, log, options, why):
    drives = [part for name in NAMES for part in ("--drive", name)]
    done = thermaltool("calibrate", log, *drives, "--deflection", "d_z_um", *options)
    assert done.code == 2
    assert why in done.err
