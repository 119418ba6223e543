"""The project's own pipelines: demo, measured logs, samples."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared/data"
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


@pytest.mark.skipif(not DATA.exists(), reason="the measured logs are not here")
def test_measured_log_is_judged_on_its_second_half(tmp_path: Path) -> None:
    target = tmp_path / "heating_system.held_out.json"
    make("measured.mk", f"DATA={DATA}", f"OUT={tmp_path}", str(target))
    held_out = json.loads(target.read_text())["T_plate_degC"]
    trained = json.loads((tmp_path / "heating_system.model.json").read_text())["outputs"][0]["fit"]
    assert (trained["rows"], held_out["rows"]) == (401, 400)
    assert held_out["fit_percent"] > 75


def test_samples_come_from_the_commands_of_their_readme() -> None:
    text = (ROOT / "data_samples/README.md").read_text()
    documented = re.findall(r"^thermaltool (plant .*)$", text, re.MULTILINE)
    told = make("samples.mk", "-n", "THERMALTOOL=thermaltool").replace("\\\n", "")
    commands = re.findall(r"^thermaltool (plant .*)$", told, re.MULTILINE)
    plain = [" ".join(command.replace("data_samples/", "").split()) for command in commands]
    assert sorted(plain) == sorted(documented)
