"""``thermaltool simulate`` from outside, and the borders that its neighbours share with it."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys

import numpy as np
import pytest

from thermaltool.api.inputs import drives_over_pauses

COLUMNS = ["time_s", "dT_pair1_K", "residual_dT_pair1_K", "d_x_um", "residual_d_x_um"]


def table(text):
    rows = list(csv.reader(io.StringIO(text)))
    return rows[0], np.array(rows[1:], float).reshape(len(rows) - 1, len(rows[0]))


def test_outputs_and_residuals(thermaltool, files):
    result = thermaltool("simulate", files.model, files.log)
    assert result.code == 0
    names, values = table(result.out)
    assert names == COLUMNS
    assert values.shape == (240, 5)
    log_names, log = table(files.log.read_text())
    measured = log[:, log_names.index("dT_pair1_K")]
    np.testing.assert_allclose(values[:, 1] + values[:, 2], measured, atol=1e-9)
    assert np.std(values[:, 2]) == pytest.approx(0.01, rel=0.2)
    told = [line.split()[0] for line in result.err.splitlines()]
    assert told == ["output", *COLUMNS[1::2], "d_x_um:"]
    assert "d_x_um: counts from the median of measured minus simulated" in result.err


@pytest.mark.parametrize("rows", ["0,1\n10,1\n", ""])
def test_max_rmse_needs_something_to_judge(thermaltool, files, rows):
    text = "time_s,Q_main_1\n" + rows
    result = thermaltool("simulate", files.model, "--max-rmse", 1, stdin=text)
    assert result.code == 1
    assert "--max-rmse: no measured output to judge" in result.err


@pytest.mark.parametrize("command", ["simulate", "estimate"])
def test_a_pause_is_told(thermaltool, files, command):
    lines = files.log.read_text().splitlines()
    text = "\n".join(lines[:100] + lines[140:]) + "\n"
    model = files.model if command == "simulate" else files.kalman
    assert "<stdin>:101: a pause of 410 s" in thermaltool(command, model, stdin=text).err
    assert "a pause" not in thermaltool(command, model, "--max-gap", 500, stdin=text).err


def test_a_log_with_drives_alone(thermaltool, files):
    text = "time_s,Q_main_1\n" + "".join(f"{10 * k},{min(k, 1)}\n" for k in range(50))
    result = thermaltool("simulate", files.model, stdin=text)
    assert table(result.out)[0] == ["time_s", "dT_pair1_K", "d_x_um"]
    assert result.err == ""


def test_json(thermaltool, files):
    target = files.folder / "out.csv"
    result = thermaltool("simulate", files.model, files.log, "--json", "-o", target)
    assert set(result.json) == {"dT_pair1_K", "d_x_um"}
    assert set(result.json["d_x_um"]) == {
        "rmse", "max_error", "mean", "band", "steady", "fit_percent", "rows", "rmse_zero_free",
        "zero",
        "zero_from_s",
        "zero_to_s",
        "zero_rows",
        "initial",
    }  # fmt: skip
    assert table(target.read_text())[0] == COLUMNS
    assert thermaltool("simulate", files.model, files.log, "--json").json == result.json


def test_a_log_that_begins_warm_is_told_as_it_begins(thermaltool, files):
    # Long enough to tell a start from a drift: more than two of the slowest time constants.
    time = 10.0 * np.arange(900)
    heat = np.where((time // 1500) % 2 == 1, 1.0, 0.0)
    text = "time_s,Q_main_1\n" + "".join(f"{t},{q}\n" for t, q in zip(time, heat, strict=True))
    names, values = table(thermaltool("simulate", files.model, "-q", stdin=text).out)
    noise = np.random.default_rng(20261125).standard_normal((2, len(time)))
    logs = []
    for start in (0.0, 1.0):
        columns = [time, heat]
        for name, height, sigma, each in (("dT_pair1_K", 3.0, 0.01, noise[0]),
                                          ("d_x_um", 30.0, 0.1, noise[1])):  # fmt: skip
            began = start * height * np.exp(-time / 150.0)
            columns.append(values[:, names.index(name)] + began + sigma * each)
        rows = [["time_s", "Q_main_1", "dT_pair1_K", "d_x_um"], *np.transpose(columns).tolist()]
        logs.append("".join(",".join(map(str, row)) + "\n" for row in rows))
    cold, warm = logs
    plain = thermaltool("simulate", files.model, "--json", stdin=cold).json
    found = thermaltool("simulate", files.model, "--json", stdin=warm).json
    rested = thermaltool("simulate", files.model, "--json", "--initial", "rest", stdin=warm).json
    for name in found:
        assert plain[name]["initial"] == rested[name]["initial"] == "rest"
        assert found[name]["initial"] == "free"
        assert rested[name]["rmse"] > 5 * found[name]["rmse"]
    said = thermaltool("simulate", files.model, "-", stdin=warm).err
    assert "<stdin>: does not begin at rest: the state of the machine at the first row is" in said
    assert "does not begin" not in thermaltool("simulate", files.model, files.log).err


def test_judged_stretch_and_limit(thermaltool, files):
    stretch = ("--start", 1000, "--stop", 1500)
    result = thermaltool("simulate", files.model, files.log, "--json", *stretch)
    assert result.json["d_x_um"]["rows"] == 51
    assert thermaltool("simulate", files.model, files.log, "--max-rmse", 1).code == 0
    result = thermaltool("simulate", files.model, files.log, "--max-rmse", 0.001)
    assert result.code == 3
    assert table(result.out)[1].shape == (240, 5)


@pytest.mark.parametrize("form", ["ndjson", "parquet"])
def test_formats(thermaltool, files, form):
    target = files.folder / f"out.{form}"
    assert thermaltool("simulate", files.model, files.log, "-o", target, "-q").code == 0
    back = thermaltool("simulate", files.model, target, "-q")
    assert back.code == 1
    assert "no column Q_main_1 (" in back.err
    if form == "ndjson":
        assert list(json.loads(target.read_text().splitlines()[0])) == COLUMNS


def test_outside_the_calibrated_range(thermaltool, files):
    lines = files.log.read_text().splitlines()
    cells = lines[60].split(",")
    cells[1] = "1.4"
    lines[60] = ",".join(cells)
    result = thermaltool("simulate", files.model, stdin="\n".join(lines) + "\n")
    assert result.code == 0
    assert result.err.splitlines()[0] == (
        "<stdin>:61: Q_main_1: 1.4 is outside the calibrated range 0 to 1 (1 row): "
        "the model extrapolates"
    )


def test_header_only(thermaltool, files):
    header = files.log.read_text().splitlines()[0] + "\n"
    result = thermaltool("simulate", files.model, stdin=header)
    assert result.code == 0
    assert result.out == ",".join(COLUMNS) + "\n"
    result = thermaltool("simulate", files.model, "--json", stdin=header)
    assert result.json["d_x_um"]["rmse"] is None
    assert thermaltool("simulate", files.model, stdin="").code == 1


@pytest.mark.parametrize("command", ["simulate", "estimate"])
def test_models_that_cannot_be_read(thermaltool, files, command):
    document = json.loads(files.kalman.read_text())
    for text, message in (
        (json.dumps({**document, "version": 9}), "version 9 is newer"),
        (files.kalman.read_text()[:300], "not JSON"),
        ("", "not JSON"),
        ("{}", "not a thermaltool model"),
        (json.dumps({**document, "terms": None}), "model.json: "),
        (json.dumps({**document, "design": [1]}), "model.json: "),
    ):
        files.model.write_text(text)
        result = thermaltool(command, files.model, files.log)
        assert (result.code, result.out) == (1, "")
        assert result.err.startswith(f"thermaltool {command}: {files.model}:")
        assert message in result.err
        assert result.err.count("\n") == 1
    files.model.write_bytes(b"\xff\xfe\x00")
    assert "not a text file" in thermaltool(command, files.model, files.log).err
    absent = thermaltool(command, files.folder / "absent.json", files.log)
    assert (absent.code, absent.err.count("\n")) == (1, 1)


def test_model_from_stdin(thermaltool, files):
    result = thermaltool("simulate", "-", files.log, "-q", stdin=files.model.read_text())
    assert result.out == thermaltool("simulate", files.model, files.log, "-q").out
    assert thermaltool("simulate", "-", "-", stdin=files.model.read_text()).code == 2


def test_missing_values(thermaltool, files):
    lines = files.log.read_text().splitlines()
    lines[10] = lines[10].replace(",0,", ",,", 1)
    text = "\n".join(lines) + "\n"
    result = thermaltool("simulate", files.model, stdin=text)
    assert result.code == 1
    assert "<stdin>:11: Q_main_1: missing value" in result.err
    held = thermaltool("simulate", files.model, "--nan-policy", "hold", "-q", stdin=text)
    assert held.out == thermaltool("simulate", files.model, files.log, "-q").out
    left = thermaltool("simulate", files.model, "--nan-policy", "omit", "-q", stdin=text)
    assert len(left.out.splitlines()) == 240


def outside(*arguments, before="", **options):
    """In a process of its own, after the statements `before`."""
    code = f"{before}\nfrom thermaltool.cli import main\nmain()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], text=True, check=False, **options
    )


def test_a_full_disk_leaves_the_old_file(files):
    target = files.folder / "old.csv"
    target.write_text("old")
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))"
    result = outside("simulate", files.model, files.log, "-o", target, before=full,
                     capture_output=True)  # fmt: skip
    assert result.returncode == 1
    assert f"{target}: File too large" in result.stderr
    assert target.read_text() == "old"
    assert [path.name for path in files.folder.glob(".*")] == []


@pytest.mark.slow
def test_a_full_device(files):
    with open("/dev/full", "w") as full:
        result = outside("simulate", files.model, files.log, "-q", stdout=full,
                         stderr=subprocess.PIPE)  # fmt: skip
    assert result.returncode == 1
    assert result.stderr == "thermaltool simulate: <stdout>: No space left on device\n"
    result = outside("simulate", files.model, files.log, "-o", "/dev/full", capture_output=True)
    assert result.returncode == 1
    assert "/dev/full: No space left on device" in result.stderr


def test_an_output_that_the_log_lacks_is_told(thermaltool, files):
    names, values = table(files.log.read_text())
    kept = [k for k, name in enumerate(names) if name != "d_x_um"]
    rows = [[names[k] for k in kept], *values[:, kept].tolist()]
    text = "".join(",".join(map(str, row)) + "\n" for row in rows)
    result = thermaltool("simulate", files.model, stdin=text)
    assert result.code == 0
    assert "<stdin>: not in the log, so simulated and not judged: d_x_um\n" in result.err
    assert "not judged" not in thermaltool("simulate", files.model, files.log).err


def test_what_drives_do_over_a_pause():
    held, straight = drives_over_pauses(["zero"]), drives_over_pauses(["first", "first"])
    assert held == "the drive is taken as held over it"
    assert straight == "the drive is taken along a straight line over it"
    both = drives_over_pauses(["zero", "first"])
    assert both == "commands are taken as held over it, what is measured along a straight line"
