"""correct, schedule, superpose: from logs of the C-frame to one model that simulates it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from thermaltool.cli import group

MAP = Path(__file__).parents[2] / "data_samples" / "maps" / "c_frame.toml"
ANGLE = ("--columns", MAP, "--output", "phi_x_urad", "--orders", "2,2,1", "--real-poles",
         "--initial", "rest")  # fmt: skip
C, S = "Q_causal_W", "Q_stabilization_W"


TOOL = [sys.executable, "-c", "from thermaltool.cli import main; main()"]


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """Calibrations of both heaters, one of both at once, and an unseen spectrum."""

    def make(*arguments):
        done = CliRunner().invoke(group, [str(each) for each in arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output

    folder = tmp_path_factory.mktemp("heaters")
    for name, arguments in {
        "causal": (),
        "high": ("--heater", "stabilization", "--power", 60),
        "low": ("--heater", "stabilization", "--power", 30),
        "mixed": ("--heater", "both", "--input", "mixed"),
        "unseen": ("--heater", "stabilization", "--input", "B", "--duration", 90000, "--seed", 9),
    }.items():
        target = folder / f"{name}.csv"
        make("plant", "c-frame", *arguments, "-o", target)
    for name, drive in (("causal", C), ("high", S), ("low", S)):
        target = folder / f"{name}.json"
        make("identify", folder / f"{name}.csv", "--input", drive, *ANGLE, "-o", target)
    drives = ("--input", C, "--input", S)
    make("identify", folder / "mixed.csv", *drives, *ANGLE, "-o", folder / "mixed.json")
    return folder


def fit(thermaltool, model, log):
    done = thermaltool("simulate", model, log, "--columns", MAP, "-o", log.with_suffix(".out"),
                       "--json", "-q")  # fmt: skip
    assert done.code == 0, done.err
    return done.json["phi_x_urad"]["fit_percent"]


def test_a_log_that_begins_with_the_power_on_is_told(thermaltool, runs):
    lines = (runs / "mixed.csv").read_text().splitlines(keepends=True)
    at = lines[0].strip().split(",").index(S)
    late = next(k for k, line in enumerate(lines[1:], 1) if float(line.split(",")[at]) > 20)
    log = runs / "late.csv"
    log.write_text("".join([lines[0], *lines[late:]]))
    call = ("--columns", MAP, "--at", S, "-o", runs / "late.json")
    done = thermaltool("correct", runs / "mixed.json", log, *call)
    assert done.code == 0, done.err
    assert f"late.csv: begins with {S}" in done.err
    done = thermaltool("correct", runs / "mixed.json", runs / "mixed.csv", *call)
    assert "begins with" not in done.err


@pytest.mark.slow
def test_one_run_corrected_foretells_another(thermaltool, runs):
    target = runs / "corrected.json"
    done = thermaltool("correct", runs / "mixed.json", runs / "mixed.csv", "--columns", MAP,
                       "--at", C, "--at", S, "--refit", "--validate", runs / "unseen.csv",
                       "-o", target, "--json")  # fmt: skip
    assert done.code == 0, done.err
    told = done.json["outputs"]["phi_x_urad"]
    assert told["after"]["fit_percent"] > 95
    assert told["validation"]["after"]["fit_percent"] > told["validation"]["before"]["fit_percent"]
    assert [c["channel"] for c in done.json["curves"]] == [C, S]
    document = json.loads(target.read_text())
    assert [log["name"] for log in document["provenance"]["logs"]] == [str(runs / "mixed.csv")] * 2
    # The zero of a simulation is its first row, that of the report is the best one.
    validated = told["validation"]["after"]["fit_percent"]
    assert 80 < fit(thermaltool, target, runs / "unseen.csv") <= validated


def test_the_table_is_on_stderr_and_the_model_on_stdout(thermaltool, runs):
    done = thermaltool("correct", runs / "high.json", runs / "high.csv", runs / "low.csv",
                       "--columns", MAP, "--size", 2)  # fmt: skip
    assert done.code == 0, done.err
    assert json.loads(done.out)["effects"][0]["name"] == "drive_curve"
    assert "after %" in done.err
    assert "Q_stabilization_W  drive_curve" in done.err


def test_a_schedule_holds_at_both_levels_and_streams(thermaltool, runs):
    target, design = runs / "scheduled.json", runs / "design.json"
    done = thermaltool("schedule", runs / "high.json", runs / "low.json", "--by", S, "-o", target)
    assert done.code == 0, done.err
    for name in ("high", "low"):
        own = fit(thermaltool, runs / f"{name}.json", runs / f"{name}.csv")
        both = fit(thermaltool, target, runs / f"{name}.csv")
        assert both == pytest.approx(own, abs=1e-6)
    assert thermaltool("regularize", target, "-o", design).code == 0
    told = thermaltool("estimate", design, runs / "unseen.csv", "--columns", MAP, "-q")
    simulated = thermaltool("simulate", target, runs / "unseen.csv", "-q")
    pairs = zip(told.out.splitlines()[1:], simulated.out.splitlines()[1:], strict=True)
    for ours, theirs in pairs:
        assert float(ours.split(",")[1]) == pytest.approx(float(theirs.split(",")[1]), abs=1e-7)
    with (runs / "unseen.csv").open("rb") as lines:
        stream = subprocess.run(
            [*TOOL, "compensate", str(design), "--also", "estimates"],
            stdin=lines,
            capture_output=True,
        )
    assert stream.returncode == 0, stream.stderr
    rows, expected = (text.splitlines()[1:] for text in (stream.stdout.decode(), told.out))
    assert len(rows) == len(expected) + 1  # the safe setpoint at the end
    for ours, theirs in zip(rows, expected, strict=False):
        assert float(ours.split(",")[-1]) == pytest.approx(float(theirs.split(",")[1]), abs=1e-6)


def test_the_sum_of_both_heaters(thermaltool, runs):
    target = runs / "sum.json"
    done = thermaltool("superpose", runs / "causal.json", runs / "high.json", "-o", target)
    assert done.code == 0, done.err
    assert [d["channel"] for d in json.loads(target.read_text())["drives"]] == [C, S]
    assert fit(thermaltool, target, runs / "causal.csv") > 95


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("correct", "mixed.json", "mixed.csv"), 2, "several drives: name one with --at"),
        (("correct", "high.json", "high.csv", "--json"), 2, "give the model a file"),
        (("correct", "high.json", "high.csv", "--at", C), 1, "no drive or output Q_causal_W"),
        (("correct", "high.json", "high.csv", "-o", "high.json"), 2, "would replace the input"),
        (("correct", "high.json", "high.csv", "--size", "40"), 1, "a spline of 40"),
        (("schedule", "high.json", "low.json", "--by", "T_a_degC"), 1, "--levels"),
        (("schedule", "high.json", "low.json", "--by", S, "--levels", "1,x"), 2, "not x1,x2"),
        (("schedule", "high.json", "high.json", "--by", S), 1, "two models of one level"),
        (("superpose", "high.json", "low.json"), 1, "it counts twice"),
    ],
)
def test_what_is_refused(thermaltool, runs, arguments, code, message):
    given = [runs / a if a.endswith((".json", ".csv")) else a for a in arguments]
    mapped = ("--columns", MAP) if arguments[0] == "correct" else ()
    done = thermaltool(*given, *mapped)
    assert done.code == code, done.err
    assert message in done.err
