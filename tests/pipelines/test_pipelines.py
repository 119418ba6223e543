"""The project's own pipelines: demo, measured logs, samples."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from reference.measured import whole_log

ROOT = Path(__file__).parents[2]
TOOLS = (f"THERMALTOOL={Path(sys.executable).with_name('thermaltool')}", f"PYTHON={sys.executable}")


def make(name: str, *arguments: str) -> str:
    done = subprocess.run(
        ["make", "-f", f"pipelines/{name}", *TOOLS, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_demo_runs_one_log_through_one_design(tmp_path: Path) -> None:
    narrowed = ("LOGS=triangle", "DESIGNS=far_kalman", f"OUT={tmp_path}")
    figure = tmp_path / "figures/triangle.far_kalman.png"
    make("demo.mk", "-j2", *narrowed, f"{tmp_path}/setpoints.md", str(figure))
    verdict = (tmp_path / "setpoints.md").read_text().splitlines()[-1]
    assert verdict.startswith("Residual within ±1 µm of the estimation error: holds")
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_measured_logs_that_are_absent_are_left_out(tmp_path: Path) -> None:
    told = make("measured.mk", f"DATA={tmp_path}", f"OUT={tmp_path}/out")
    assert told == (
        f"measured logs: left out, there is no {tmp_path} here "
        "(they are not copied into the project)\n"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_measured_log_is_judged_on_its_second_half(tmp_path: Path) -> None:
    target = tmp_path / "heating_system.held_out.json"
    data = whole_log("daisy/heating_system.csv").parents[1]
    make("measured.mk", f"DATA={data}", f"OUT={tmp_path}", str(target))
    held_out = json.loads(target.read_text())["T_plate_degC"]
    trained = json.loads((tmp_path / "heating_system.model.json").read_text())["outputs"][0]["fit"]
    assert (trained["rows"], held_out["rows"]) == (401, 400)
    # The fastest of its time constants (0.1 to 23 s, a row every 2 s) is not identified: where on
    # that flat stretch the fit ends differs between processors, and this by a percent.
    assert held_out["fit_percent"] > 74


def with_tool() -> dict[str, str]:
    """The environment, with the tool that is tested first on the path."""
    folder = Path(sys.executable).parent
    return os.environ | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def shell(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=folder,
        env=with_tool(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
def test_forecasts_of_a_log_by_its_best_order(tmp_path: Path) -> None:
    shell("thermaltool plant boring-bar --duration 0.5 -o 'my cut.csv'", tmp_path)
    wanted = (f"LOG={tmp_path}/my cut.csv", "COLUMN=e_tool_um", "STEPS=7", f"OUT={tmp_path}/out")
    flags = ("ORDER_FLAGS=--max-p 4 --max-q 2",)
    make("forecast.mk", *wanted, *flags)
    best = json.loads((tmp_path / "out/my_cut.orders.json").read_text())["best"]["bic"]
    model = json.loads((tmp_path / "out/my_cut.arma.json").read_text())
    assert (len(model["ar"]), len(model["ma"])) == (best["p"], best["q"])
    with open(tmp_path / "out/my_cut.forecast.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["time_s"] for row in rows[:2]] == ["0.5", "0.5005"]
    assert len(rows) == 7
    assert (tmp_path / "out/my_cut.orders.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_machine_and_its_control_in_a_loop(tmp_path: Path) -> None:
    shell(f"OUT=. DURATION=1 {ROOT}/pipelines/fcc.sh", tmp_path)
    said = (tmp_path / "fcc.log").read_text().splitlines()[-1]
    left, without = map(float, re.findall(r"([\d.]+) RMS", said))
    assert "2000 samples" in said
    assert left < 0.3 * without
    with open(tmp_path / "cut.csv", newline="") as stream:
        later = [float(row["d_tool_um"]) for row in csv.DictReader(stream)][1000:]
    assert abs(sum(later) / len(later)) < 0.1
    assert not (tmp_path / "commands").exists()


@pytest.mark.slow
def test_the_streams_of_the_readme_run(tmp_path: Path) -> None:
    text = (ROOT / "README.md").read_text()
    section = text.split("## Errors that come again, and delays")[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    assert len(blocks) == 2
    said = [shell(block, tmp_path).stderr for block in blocks][-1]
    with open(tmp_path / "ahead.csv", newline="") as stream:
        ahead = list(csv.DictReader(stream))
    with open(tmp_path / "commands.csv", newline="") as stream:
        commands = [float(row["U_command_V"]) for row in csv.DictReader(stream)]
    low, mean, high = (
        next(float(value) for name, value in ahead[-1].items() if name.startswith(column))
        for column in ("low_", "forecast_", "high_")
    )
    assert low < mean < high
    # One per line, the safe one at the end, and one for each time that the lines were late.
    late = said.count("no usable line")
    assert len(commands) == 2001 + late
    assert late < 10
    assert min(commands) >= -2
    assert max(commands) <= 10
    assert commands[-1] == 0


def test_samples_come_from_the_commands_of_their_readme() -> None:
    text = (ROOT / "data_samples/README.md").read_text()
    documented = re.findall(r"^thermaltool (plant .*)$", text, re.MULTILINE)
    told = make("samples.mk", "-n", "THERMALTOOL=thermaltool").replace("\\\n", "")
    commands = re.findall(r"^thermaltool (plant .*)$", told, re.MULTILINE)
    plain = [" ".join(command.replace("data_samples/", "").split()) for command in commands]
    assert sorted(plain) == sorted(documented)
