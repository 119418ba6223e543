"""Seconds that ``estimate --bands --smooth`` takes on 1260 rows of four sensors, clock even or not.

    python benchmarks/smooth_uneven.py [--source ../old_checkout] [--keep FOLDER]

Two heaters on four coupled masses, in Euler steps, noise of 0.02 K; calibrated on one log (seed 1),
estimated on another with an even clock (seed 2) and one of whole seconds from 6 to 14 (seed 3).
With --keep the estimates stay, to be compared between two checkouts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROWS, PERIOD = 1260, 10
LOSS = np.array([[-1 / 300, 1 / 600, 0, 0], [1 / 900, -1 / 500, 1 / 1500, 0],
                 [0, 1 / 900, -1 / 600, 1 / 2000], [0, 0, 1 / 1500, -1 / 1200]])  # fmt: skip
HEATED = np.array([[1 / 6000, 0], [0, 0], [0, 1 / 8000], [0, 0]])
SENSORS = [f"T_{place}_degC" for place in "abcd"]


def write_log(path: Path, seed: int, even: bool) -> None:
    """A log of the machine, both heaters at random."""
    rng = np.random.default_rng(seed)
    heat = np.array([np.repeat(rng.choice([0.0, 100.0, 200.0], ROWS // 30), 30) for _ in "ab"])
    clock = np.arange(ROWS) * PERIOD if even else np.cumsum(rng.integers(6, 15, ROWS))
    rise, lines = np.zeros(4), []
    noise = rng.standard_normal((ROWS, 5)) * [0.02, 0.02, 0.02, 0.02, 0.2]
    for k in range(ROWS):
        read = [*(20 + rise), 3 * rise[1] + 2 * rise[3]] + noise[k]
        lines.append(",".join(f"{x:.4f}" for x in (clock[k], *heat[:, k], *read)))
        for _ in range(4 if k + 1 < ROWS else 0):
            rise = rise + (clock[k + 1] - clock[k]) / 4 * (LOSS @ rise + HEATED @ heat[:, k])
    names = ",".join(["time_s", "Q_a_W", "Q_b_W", *SENSORS, "d_z_um"])
    path.write_text("\n".join([names, *lines]) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--source", type=Path, default=HERE.parent)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(exist_ok=True)
        environment = {**os.environ, "PYTHONPATH": str(options.source.resolve())}

        def run(*arguments: str) -> float:
            start = time.monotonic()
            command = [sys.executable, "-m", "thermaltool", *arguments]
            subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
            return time.monotonic() - start

        for name, seed, even in (("first", 1, True), ("even", 2, True), ("uneven", 3, False)):
            write_log(folder / f"{name}.csv", seed, even)
        sensors = [word for name in SENSORS for word in ("--sensor", name)]
        run("calibrate", "first.csv", "--drive", "Q_a_W", "--drive", "Q_b_W", *sensors,
            "--deflection", "d_z_um", "-o", "model.json")  # fmt: skip
        run("noise", "first.csv", "-o", "noise.json")
        run("regularize", "model.json", "--noise", "noise.json", "--form", "kalman", "-o", "e.json")
        for name in ("even", "uneven"):
            took = run("estimate", "e.json", f"{name}.csv", "--bands", "--smooth", "-o",
                       f"{name}_estimates.csv")  # fmt: skip
            print(f"{name} clock: {took:.1f} s")


if __name__ == "__main__":
    main()
