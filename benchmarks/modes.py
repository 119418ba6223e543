"""Thermal modes: large bodies in time and memory, and intervals of time constants from logs.

    python benchmarks/modes.py body [--divisions N]
    python benchmarks/modes.py logs [--draws 60] [--seed N]
    python benchmarks/modes.py update [--draws 20] [--seed N]

`body` runs `thermaltool modes` on a steel block of N x N x N elements with one heat and one
deflection, and with ``--model``. `logs` draws logs of a simulated spindle (tests/machines), whose
time constants are 363.6, 61.7 and 27.0 min (Zhu, Ni, Shih 2008), and counts how often the 95 %
intervals hold them. `update` draws rods (tests/machines, finite volumes) whose film and share of
heat differ from those of their mesh, updates the mesh from an hour of noisy readings, and counts
what mesh, logs alone and updated mesh miss over eight hours of another duty.
"""

from __future__ import annotations

import argparse
import os
import secrets
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import replace
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.append(str(Path(__file__).parents[1] / "tests"))

import numpy as np
from machines.expanding_rod import OUTPUT, ROD, random_heat, rod_columns
from machines.shared_modes import SPINDLE_GAINS, SPINDLE_TAUS, SharedModes

from thermaltool import api
from thermaltool.model import agreements
from thermaltool.placement.mode_identification import identify_modes
from thermaltool.record import Record

ROOT = Path(__file__).parents[1]
HOUR, NOISE = 3600.0, 0.05
DUTIES = {
    "8 h on, 16 h off": [(600.0, 0.0), (8 * HOUR, 1.0), (16 * HOUR, 0.0)],
    "on 20, off 15, on 20 min, 12 h off": [
        (600.0, 0.0), (1200.0, 1.0), (900.0, 0.0), (1200.0, 1.0), (12 * HOUR, 0.0),
    ],
}  # fmt: skip
BODY = """
format = "thermaltool-body"
version = 1
[mesh]
block = {{ size = [0.4, 0.3, 0.3], divisions = [{n}, {n}, {n}] }}
[materials.steel]
conductivity = 50
density = 7850
specific_heat = 480
expansion = 12e-6
youngs_modulus = 205e9
[convection]
right = 10
top = 10
front = 10
[heat.Q_heater_W]
on = ["left"]
[points.T_middle_degC]
at = [0.2, 0.15, 0.15]
[deflections.d_x_um]
at = [0.4, 0.15, 0.15]
direction = "x"
[supports]
fixed = ["bottom"]
"""
# A process begins with the peak of the one that started it, so that a small one has to.
MEASURE = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
sys.exit(done.returncode)
"""


def body(divisions: int) -> None:
    print("| command | nodes | CPU s | wall s | peak GB |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "block.toml"
        path.write_text(BODY.format(n=divisions))
        for more in ([], ["--model", str(Path(folder) / "model.json")]):
            command = [sys.executable, "-m", "thermaltool", "modes", str(path), "-q", *more]
            begin = time.monotonic()
            done = subprocess.run([sys.executable, "-c", MEASURE, *command], text=True,
                                  stdout=subprocess.PIPE, check=True)  # fmt: skip
            cpu, peak = map(float, done.stdout.split())
            name = "modes" + " --model" * bool(more)
            print(f"| `{name}` | {(divisions + 1) ** 3} | {cpu:.0f} | "
                  f"{time.monotonic() - begin:.0f} | {peak / 1e6:.2f} |", flush=True)  # fmt: skip


def logs(draws: int, seed: int) -> None:
    print(f"seed {seed}\n\n| duty | logs | three modes found | 363.6 min | 61.7 min | 27.0 min |")
    print("|---|---|---|---|---|---|")
    spindle = SharedModes(SPINDLE_TAUS, SPINDLE_GAINS)
    for (name, duty), source in zip(
        DUTIES.items(), np.random.SeedSequence(seed).spawn(len(DUTIES)), strict=True
    ):
        times = np.arange(0.0, sum(duration for duration, _ in duty), 60.0)
        held = []
        for child in source.spawn(draws):
            readings = spindle.readings(times, duty, NOISE, np.random.default_rng(child))
            found = identify_modes(
                [Record(times, readings)], ["duty_spindle_1"], tuple(SPINDLE_GAINS)
            ).time_constants
            if len(found) == len(SPINDLE_TAUS):
                held.append(
                    [e.low < tau < e.high for e, tau in zip(found, SPINDLE_TAUS, strict=True)]
                )
        shares = 100 * np.mean(held, axis=0)
        print(f"| {name} | {draws} | {len(held)} | "
              + " | ".join(f"{share:.0f} %" for share in shares) + " |", flush=True)  # fmt: skip


def rod_log(rng, rows, held, film, share):
    """Readings of a rod with another film, of which a part of the heat enters."""
    heat = random_heat(rng, rows, held)
    columns = rod_columns(share * heat, 10.0, rng, NOISE, replace(ROD, film=film))
    columns[OUTPUT] = columns[OUTPUT] + 0.3 * rng.standard_normal(rows)
    time = columns.pop("time_s")
    return Record(time, {**columns, "Q_motor_W": heat}, digest=str(rng.integers(1 << 60)))


def update(draws: int, seed: int) -> None:
    document = tomllib.loads((ROOT / "data_samples/bodies/rod.toml").read_text())
    document["mesh"]["rod"]["elements"] = 80
    rows, sensors = [], tuple(document["points"])
    print(f"seed {seed}\n\nRMS over eight hours of another duty, zero free, % of the range: "
          "geometric mean of two temperatures and the expansion\n")  # fmt: skip
    print("| film, declared 20 | by the logs | share of heat | by the logs | mesh | logs alone "
          "| updated | CPU s |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    for child in np.random.SeedSequence(seed).spawn(draws):
        rng = np.random.default_rng(child)
        film, share = 20 * np.exp(rng.uniform(-0.8, 0.8)), rng.uniform(0.75, 1.0)
        hour = rod_log(rng, 360, 60, film, share)
        unseen = rod_log(rng, 2880, 180, film, share)
        begin = time.process_time()
        found = api.calibrate_body(document, hour)
        spent = time.process_time() - begin
        models = (
            api.thermal_modes(document).model,
            api.calibrate(hour, "Q_motor_W", sensors=sensors, deflections=OUTPUT).model,
            found.model,
        )
        missed = []
        for model in models:
            each = agreements(model, [unseen], initial="rest")
            parts = [a.rmse_zero_free / np.ptp(unseen.column(n)) for n, a in each.items()]
            missed.append(100 * float(np.exp(np.mean(np.log(parts)))))
        own = {p.kind: p.estimate for p in found.parameters}
        inside = [own["film"].low < film < own["film"].high,
                  own["heat"].low < share < own["heat"].high]  # fmt: skip
        rows.append((*missed, *inside))
        cells = [f"{film:.2f}", own["film"], f"{share:.3f}", own["heat"],
                 *(f"{m:.2f}" for m in missed), f"{spent:.1f}"]  # fmt: skip
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)
    *missed, films, shares = np.array(rows, float).T
    best = np.mean((missed[2] < missed[0]) & (missed[2] < missed[1]))
    print(f"\nmedian of the errors: mesh {np.median(missed[0]):.2f} %, logs alone "
          f"{np.median(missed[1]):.2f} %, updated {np.median(missed[2]):.2f} %; updated is best in "
          f"{100 * best:.0f} % of {draws}; intervals hold the film in {100 * films.mean():.0f} %, "
          f"the share in {100 * shares.mean():.0f} %")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=["body", "logs", "update"])
    parser.add_argument("--divisions", type=int, default=46)
    parser.add_argument("--draws", type=int, help="60 logs or 20 rods if absent")
    parser.add_argument("--seed", type=int, help="drawn if absent")
    given = parser.parse_args()
    if given.what == "body":
        body(given.divisions)
        return
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    if given.what == "logs":
        logs(given.draws or 60, seed)
    else:
        update(given.draws or 20, seed)


if __name__ == "__main__":
    main()
