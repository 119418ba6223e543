"""Stumbles that blocked: logs that no command read, and commands that ended without a model."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stumbles_bench import PERIOD_S, ROWS, SAMPLES, Bench, Stumble, bent, lag, said, steps

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from machines import foreign_logs

# Terms of a fit cancel where one is so many times what they add up to.
MAX_CANCELLATION = 100.0
GANTRY_MAP = """
[time]
column = "time"
format = "%Y/%m/%d-%H:%M:%S"

[columns]
sample = false
z_steps = { name = "d_z_um", scale = 2.5 }
frame_t = { name = "T_frame_degC", missing = [85.0] }
chamber_t = "T_chamber_degC"
bed_t = "T_bed_degC"
bed_target = false
"""


def identified(b: Bench, *call: object) -> tuple[str, bool]:
    """`identify` with its defaults: a model file, no swing, no terms that cancel."""
    done = b.tool("identify", *call, "-q", "-o", "identified.json")
    model = json.loads((b.folder / "identified.json").read_text())
    swings, worst = False, 1.0
    for term in model["terms"]:
        swings |= term["kind"].startswith("oscillation")
        weights = [v for name, v in term["parameters"].items() if name.startswith("K")]
        if total := abs(sum(weights)):
            worst = max(worst, *(abs(weight) / total for weight in weights))
    fit = model["outputs"][0]["fit"]["fit_percent"]
    told = f"fit {fit:.1f} %, {'swings' if swings else 'no swing'}, weights to {worst:.2g} x gain"
    return told, done.code == 0 and not swings and worst < MAX_CANCELLATION


def gantry_frame(b: Bench) -> tuple[str, bool]:
    (b.folder / "gantry.toml").write_text(GANTRY_MAP)
    return identified(
        b, SAMPLES / "gantry_morning.csv", "--columns", "gantry.toml", "--nan-policy", "omit",
        "--input", "T_frame_degC", "--output", "d_z_um",
    )  # fmt: skip


def two_lags(b: Bench) -> tuple[str, bool]:
    """Two time constants within a tenth of each other: a bad case for weights."""
    heat = steps()
    grown = 0.5 * lag(lag(heat, 700.0), 650.0) + 0.3 * b.noise.standard_normal(ROWS)
    b.write("close.csv", time_s=PERIOD_S * np.arange(ROWS), Q_main_W=heat, d_z_um=grown)
    return identified(b, "close.csv", "--input", "Q_main_W", "--output", "d_z_um")


def bursts(b: Bench) -> tuple[str, bool]:
    """Three readings a minute, as a printer's probe makes them."""
    heat = np.repeat(steps(), 4)
    fine = bent(heat)[::6]
    minute = np.arange(len(fine)) * 60.0
    time = (minute[:, None] + np.array([0.0, 4.0, 8.0])).ravel()
    grown = np.repeat(fine, 3) + 0.2 * b.noise.standard_normal(3 * len(fine))
    b.write("bursts.csv", time_s=time, Q_main_W=np.repeat(heat[::6], 3), d_z_um=grown)
    return identified(b, "bursts.csv", "--input", "Q_main_W", "--output", "d_z_um")


def a_negative_pole(b: Bench) -> tuple[str, bool]:
    """An output that is noise from row to row: discrete poles below 0 have no continuous form."""
    heat = steps()
    shown = np.zeros(ROWS)
    for k in range(1, ROWS):
        shown[k] = -0.84 * shown[k - 1] + 0.01 * heat[k - 1] + 0.05 * b.noise.standard_normal()
    b.write("negative.csv", time_s=PERIOD_S * np.arange(ROWS), Q_main_W=heat, d_z_um=shown)
    return identified(b, "negative.csv", "--input", "Q_main_W", "--output", "d_z_um")


def repeated(b: Bench) -> tuple[str, bool]:
    """Stamps of a minute, six rows each."""
    columns = b.columns()
    columns["time_s"] = 60.0 * (np.arange(ROWS) // 6)
    b.write("repeated.csv", **columns)
    refused = b.tool("check", "repeated.csv")
    cured = []
    for cure, rows in (("first", -(-ROWS // 6)), ("mean", -(-ROWS // 6)), ("spread", ROWS)):
        done = b.tool("check", "repeated.csv", "--duplicates", cure, "--json")
        cured.append(json.loads(done.out)["rows"] == rows)
    return (f"{sum(cured)} of 3 cures; \"{said(refused.err + refused.out, 'repeat')[-60:]}\"",
            all(cured) and refused.code == 3)  # fmt: skip


def resampled(b: Bench) -> tuple[str, bool]:
    columns = b.columns()
    columns["time_s"] = columns["time_s"] + np.round(b.noise.uniform(0, 3, ROWS), 2)
    b.write("uneven.csv", **columns)
    b.tool("check", "uneven.csv", "--resample", "10", "-o", "even.csv")
    time = np.genfromtxt(b.folder / "even.csv", delimiter=",", names=True)["time_s"]
    return f"{len(time)} rows every {np.median(np.diff(time)):g} s", np.ptp(np.diff(time)) < 1e-9


def foreign(
    write: Callable[[Path], Path], drive: str, output: str, gain: float
) -> Callable[[Bench], tuple[str, bool]]:
    """Drafted map and calibration by defaults; the plant has one time constant."""

    def look(b: Bench) -> tuple[str, bool]:
        place = b.folder / write.__name__
        place.mkdir(exist_ok=True)
        log, drafted, model = write(place), place / "map.toml", place / "model.json"
        b.tool("check", log, "--write-map", drafted)
        kind = "--sensor" if output.startswith("T") else "--deflection"
        done = b.tool("calibrate", log, "--columns", drafted, "--drive", drive, kind, output,
                      "-q", "-o", model)  # fmt: skip
        (shown,) = json.loads(b.tool("present", model, "--json").out).values()
        fit, (found,) = shown["outputs"][0]["fit_percent"], shown["responses"]
        slowest = found["time_constants_s"][-1][0]
        told = (f"no edit, defaults: {found['gain'][0]:.4g} {found['gain_unit']} of {gain:g}, "
                f"{slowest:.1f} s of {foreign_logs.LAG:g}, fit {fit:.1f} %")  # fmt: skip
        near = abs(found["gain"][0] - gain) < 0.02 * gain
        near &= abs(slowest - foreign_logs.LAG) < 0.05 * foreign_logs.LAG
        return told, done.code == 0 and near and fit > 97

    return look


def trailing_fields(b: Bench) -> tuple[str, bool]:
    lines = [line + ",," for line in b.log.read_text().splitlines()]
    (b.folder / "trailing.csv").write_text("\n".join([*lines, ""]))
    done = b.tool("check", "trailing.csv", "--json")
    return f"exit {done.code}, {json.loads(done.out)['rows']} rows", done.code == 0


def computed(b: Bench) -> tuple[str, bool]:
    (b.folder / "computed.csv").write_text(
        "time_s,Volt,Amp,Ti,To,Flux\n" + "".join(f"{k},12,2,{30 + k},20,50\n" for k in range(5))
    )
    (b.folder / "computed.toml").write_text(
        '[columns]\nVolt = "U_heater_V"\nAmp = "I_heater_A"\nTi = "T_in_degC"\n'
        'To = { name = "T_out_degC", offset = 0.5 }\nFlux = { name = "q_wall_W/m2" }\n'
        '[computed]\nQ_heater_W = { power = ["U_heater_V", "I_heater_A"] }\n'
        'dT_wall_K = { difference = ["T_in_degC", "T_out_degC"] }\n'
    )
    b.tool("check", "computed.csv", "--columns", "computed.toml", "-o", "made.csv")
    made = np.genfromtxt(b.folder / "made.csv", delimiter=",", names=True)
    ok = np.allclose(made["Q_heater_W"], 24) and np.allclose(made["dT_wall_K"], 9.5 + np.arange(5))
    return f"{made['Q_heater_W'][0]:g} W, {made['dT_wall_K'][0]:g} K, W/m2 taken", ok


def make(b: Bench, *more: str) -> tuple[subprocess.CompletedProcess[str], list[dict[str, str]]]:
    """`calibrate.mk` over three logs with blanks in their names, one of them spoiled."""
    logs = b.folder / "logs of a day"
    logs.mkdir(exist_ok=True)
    for seed, name in enumerate(("warm up 1.csv", "warm up 2.csv")):
        b.write(f"{logs.name}/{name}", **b.columns(seed=seed + 30))
    (logs / "bad one.csv").write_text("time_s,Q_main_W,T_head_degC,d_z_um\n0,1,2,broken\n1,1,2,3\n")
    _ = b.idle
    flags = "--response T_head_degC=rational2 --response d_z_um=rational1 --linear"
    root = str(SAMPLES.parent)
    done = subprocess.run(
        ["make", "-C", b.folder, "-f", f"{root}/pipelines/calibrate.mk", f"LOGS={logs.name}",
         "IDLE=idle.csv", "DRIVE=Q_main_W", "SENSORS=T_head_degC", "DEFLECTIONS=d_z_um",
         f"CALIBRATE_FLAGS={flags}", f"THERMALTOOL={sys.executable} -m thermaltool",
         f"PYTHON={sys.executable}", "-k", *more, "out/summary.csv"],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": root},
    )  # fmt: skip
    with open(b.folder / "out/summary.csv", newline="") as stream:
        return done, list(csv.DictReader(stream))


def blanks(b: Bench) -> tuple[str, bool]:
    _, rows = make(b)
    good = [row for row in rows if not row["failure"]]
    bad = [row for row in rows if row["failure"]]
    names = {row["log"] for row in good}
    return (f"{len(names)} logs done, {len(bad)} told: \"{bad[0]['failure'][-44:]}\"",
            names == {"warm_up_1", "warm_up_2"} and len(bad) == 1)  # fmt: skip


def judged_elsewhere(b: Bench) -> tuple[str, bool]:
    _, rows = make(b)
    judged = [row for row in rows if row["output"] == "d_z_um"]
    told = [(row["log"], row.get("judged_on"), row.get("kalman_judged_band")) for row in judged]
    ok = bool(told) and all(on and on != log and band for log, on, band in told)
    shown = "; ".join(f"{log} on {on}: band {band} um" for log, on, band in told)
    return shown if ok else "promised bands alone", ok


WAS_FOREIGN = "not read"
STUMBLES = [
    Stumble("2.1a", "`identify`, defaults, gantry: frame to gap", "an oscillation of 719 s",
            gantry_frame),
    Stumble("2.1b", "`identify`, two time constants nearly equal", "six modes of ± 4e16", two_lags),
    Stumble("2.1c", "`identify`, a log in bursts", "no model", bursts),
    Stumble("2.1d", "`identify`, a pole at z = -0.84", "no model after 46 s", a_negative_pole),
    Stumble("2.2a", "time stamps that repeat", "no cure (2400 errors)", repeated),
    Stumble("2.2b", "an uneven clock: `--resample`", "no cure", resampled),
    *(Stumble(f"2.3{chr(97 + k)}", f"`{write.__name__}`: `check --write-map`, `calibrate`",
              WAS_FOREIGN, foreign(*case))
      for k, case in enumerate(foreign_logs.CASES) for write in case[:1]),
    Stumble("2.3k", "trailing empty fields", WAS_FOREIGN, trailing_fields),
    Stumble("2.3l", "maps that compute power and difference", "not there", computed),
    Stumble("2.4a", "`calibrate.mk`: blanks in names, one bad log", "stops", blanks),
    Stumble("2.4b", "`calibrate.mk`: judged on a log not trained on", "what `regularize` promised",
            judged_elsewhere),
]  # fmt: skip
