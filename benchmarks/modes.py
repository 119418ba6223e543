"""Thermal modes: large bodies in time and memory, and intervals of time constants from logs.

    python benchmarks/modes.py body [--divisions N]
    python benchmarks/modes.py logs [--draws 60] [--seed N]

`body` runs `thermaltool modes` on a steel block of N x N x N elements with one heat and one
deflection, and with ``--model``. `logs` draws logs of a simulated spindle (tests/machines), whose
time constants are 363.6, 61.7 and 27.0 min (Zhu, Ni, Shih 2008), and counts how often the 95 %
intervals hold them.
"""

from __future__ import annotations

import argparse
import os
import secrets
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.append(str(Path(__file__).parents[1] / "tests"))

import numpy as np
from machines.shared_modes import SPINDLE_GAINS, SPINDLE_TAUS, SharedModes

from thermaltool.placement.mode_identification import identify_modes
from thermaltool.record import Record

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=["body", "logs"])
    parser.add_argument("--divisions", type=int, default=46)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, help="drawn if absent")
    given = parser.parse_args()
    if given.what == "body":
        body(given.divisions)
    else:
        logs(given.draws, secrets.randbelow(2**31) if given.seed is None else given.seed)


if __name__ == "__main__":
    main()
