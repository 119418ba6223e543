"""pipelines/calibrate.mk on two short logs: incremental, parallel, whole after an interruption."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import thermaltool as tt
from thermaltool.logs import read_log, write_table

ROOT = Path(__file__).parents[2]
TOOL = Path(sys.executable).with_name("thermaltool")
# A pinned design is not searched for: the files count here, not what is in them.
PINNED = "--regularization 0.005 0.0063 0.139 --cutoff 0.0625 --delay 6.7 --walk 0.01"


# Everything of one log, and of the other what the summary needs: figures cost seconds each.
DOCUMENTS = ("model", "kalman", "kernel")
FIGURES = ("fit.png", "estimate.png", "kernel.png")
WANTED = ("-j2", "out/summary.csv", *(f"out/one.{figure}" for figure in FIGURES))


def make(folder: Path, *arguments: str, **options: str) -> list[str]:
    settings = {
        "LOGS": "logs",
        "IDLE": "idle.csv",
        "DRIVE": "Q_main_1",
        "SENSORS": "dT_pair1_K",
        "DEFLECTIONS": "d_y_um",
        "CALIBRATE_FLAGS": "--starts 1",
        "REGULARIZE_FLAGS": PINNED,
        "THERMALTOOL": str(TOOL),
        "PYTHON": sys.executable,
    } | options
    variables = [f"{name}={value}" for name, value in settings.items()]
    fragment = str(ROOT / "pipelines/calibrate.mk")
    return ["make", "-C", str(folder), "-f", fragment, *variables, *arguments]


def run(folder: Path, *arguments: str, **options: str) -> str:
    done = subprocess.run(
        make(folder, *arguments, **options), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every 16th row of two sample logs, one of them under two names and alone in a folder."""
    folder = tmp_path_factory.mktemp("calibrate")
    for name, targets in (
        ("duty", ("logs/one.csv", "logs/two.parquet", "alone/one.csv")),
        ("idle", ("idle.csv",)),
    ):
        log = read_log(str(ROOT / f"data_samples/frame_{name}.parquet"))
        columns = {"time_s": log.time, **log.columns}
        for target in targets:
            (folder / target).parent.mkdir(exist_ok=True)
            write_table({c: v[::16] for c, v in columns.items()}, str(folder / target), None)
    return folder


@pytest.fixture(scope="module")
def made(logs: Path) -> Path:
    run(logs, *WANTED)
    return logs / "out"


def visible(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


@pytest.mark.slow
def test_a_log_gives_its_products(made: Path) -> None:
    designed = {f"{log}.{what}.json" for log in ("one", "two") for what in DOCUMENTS}
    tables = {"one.kernel.parquet", "one.estimate.parquet", "summary.csv"}
    figures = {f"one.{figure}" for figure in FIGURES}
    assert visible(made) == designed | tables | figures | {"noise.json", "options.txt"}


@pytest.mark.slow
def test_all_is_every_product_of_every_log(logs: Path, made: Path) -> None:
    told = run(logs, "-n")
    written = {line.split(" -o out/")[1] for line in told.splitlines() if " -o out/" in line}
    missing = {f"two.{figure}" for figure in FIGURES} | {"two.kernel.parquet"}
    assert written == missing | {"two.estimate.parquet", "noise.png"}


@pytest.mark.slow
def test_summary_is_what_the_models_say(logs: Path, made: Path) -> None:
    with open(made / "summary.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["log"], row["output"]) for row in rows] == [
        (log, output) for log in ("one", "two") for output in ("dT_pair1_K", "d_y_um")
    ]
    model = json.loads((made / "two.kalman.json").read_text())
    fit = model["outputs"][1]["fit"]
    assert float(rows[3]["rmse"]) == pytest.approx(fit["rmse"], rel=1e-3)
    band = model["design"]["predicted"]["band"][0]
    assert float(rows[3]["kalman_predicted_band"]) == pytest.approx(band, rel=1e-2)
    # What `estimate` finds on the other log, which was not in the fit.
    assert [row["judged_on"] for row in rows] == ["", "two", "", "one"]
    found = tt.estimate(str(made / "two.kalman.json"), str(logs / "logs/one.csv"))
    assert float(rows[3]["kalman_judged_band"]) == pytest.approx(
        found.document()["agreement"]["d_y_um"]["band"], rel=1e-2
    )


@pytest.mark.slow
def test_nothing_reruns_when_nothing_changed(logs: Path, made: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in made.iterdir()}
    told = run(logs, *WANTED)
    assert "thermaltool" not in told
    assert told.count("up to date") == len(WANTED) - 1
    assert {path: path.stat().st_mtime_ns for path in made.iterdir()} == before


@pytest.mark.slow
def test_a_touched_log_redoes_its_own_products(logs: Path, made: Path) -> None:
    log = logs / "logs/one.csv"
    kept = log.stat()
    os.utime(log)
    try:
        told = run(logs, "-n", *WANTED)
    finally:
        os.utime(log, ns=(kept.st_atime_ns, kept.st_mtime_ns))
    assert "out/one.model.json" in told
    # The summary takes all logs.
    assert "two" not in told.replace("one.csv two.parquet", "")
    assert "noise -o" not in told
    assert "idle.csv" not in told


@pytest.mark.slow
def test_other_options_redo_the_models(logs: Path, made: Path) -> None:
    told = run(logs, "-n", *WANTED, CALIBRATE_FLAGS="--starts 2")
    assert "-o out/one.model.json" in told
    assert "-o out/two.model.json" in told


def interrupt(logs: Path, number: signal.Record, product: Path) -> None:
    """Start make and end all of its processes when `product` has appeared."""
    process = subprocess.Popen(
        make(logs, "-j2", "cut/one.kernel.parquet", "cut/summary.csv", LOGS="alone", OUT="cut"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not product.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, number)
    assert process.wait() != 0


@pytest.mark.slow
def test_interrupted_run_leaves_only_whole_files(logs: Path, made: Path) -> None:
    out = logs / "cut"
    for number, product in ((signal.SIGINT, "one.model.json"), (signal.SIGKILL, "one.kalman.json")):
        interrupt(logs, number, out / product)
        assert not (out / "summary.csv").exists()
        for path in out.glob("[!.]*.json"):
            json.loads(path.read_text())
        for path in out.glob("[!.]*.parquet"):
            pq.read_table(path)
    run(logs, "-j2", "cut/one.kernel.parquet", "cut/summary.csv", LOGS="alone", OUT="cut")
    again, whole = (read_log(str(folder / "one.kernel.parquet")) for folder in (out, made))
    assert np.array_equal(again.column("weight_1"), whole.column("weight_1"))


@pytest.mark.slow
def test_a_bad_log_stops_no_other(logs: Path) -> None:
    folder = logs / "logs of a day"
    folder.mkdir()
    good = folder / "warm up 1.csv"
    good.write_bytes((logs / "logs/one.csv").read_bytes())
    (folder / "bad one.csv").write_text(
        "time_s,Q_main_1,dT_pair1_K,d_y_um\n0,1,2,broken\n1,1,2,3\n"
    )
    places = {"LOGS": folder.name, "OUT": "mixed"}
    done = subprocess.run(make(logs, **places), capture_output=True, text=True, check=False)
    assert done.returncode == 2
    with open(logs / "mixed/summary.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["log"], row["output"]) for row in rows] == [
        ("bad_one", ""),
        ("warm_up_1", "dT_pair1_K"),
        ("warm_up_1", "d_y_um"),
    ]
    assert "bad one.csv:2: d_y_um: not a number: 'broken'" in rows[0]["failure"]
    assert rows[1]["failure"] == ""
    for figure in FIGURES:
        assert (logs / f"mixed/warm_up_1.{figure}").exists()
    # With the log mended its failure is gone.
    (folder / "bad one.csv").write_bytes(good.read_bytes())
    assert "bad_one" in run(logs, **places)
    assert not list((logs / "mixed").glob("*.failed"))
    with open(logs / "mixed/summary.csv", newline="") as stream:
        assert [row["failure"] for row in csv.DictReader(stream)] == [""] * 4


@pytest.mark.slow
def test_a_model_without_a_kernel_is_no_failure(logs: Path) -> None:
    flags = "--starts 1 --linear --response dT_pair1_K=rational2 --response d_y_um=rational1"
    places = {"LOGS": "alone", "OUT": "plain", "CALIBRATE_FLAGS": flags}
    done = subprocess.run(make(logs, **places), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "one.kernel.parquet.failed:thermaltool invert: the kernel takes" in done.stderr
    assert (logs / "plain/one.estimate.png").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [({"IDLE": ""}, "IDLE= is missing"), ({"LOGS": "nowhere"}, "no logs in nowhere/")],
)
def test_what_is_missing_is_named(logs: Path, options: dict[str, str], message: str) -> None:
    done = subprocess.run(make(logs, **options), capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
