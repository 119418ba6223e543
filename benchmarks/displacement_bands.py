"""How often ``estimate --smooth --bands`` holds a displacement of machines in a hall.

    python benchmarks/displacement_bands.py [--draws 30] [--seed 4100] [--source ../old_checkout]
        [--models FOLDER]

Every draw is a machine of its own: a nose, a head, a column and a bed, coupled, in the hall's air,
and heated by a spindle (estimated), an axis (logged) and the hall (logged), in Euler substeps. It
is calibrated by default on a noisy log of 10 h and estimated on two other days, on which the
displacement is known without noise. Errors count from the first rows, as the displacement has no
zero; of each day the share of rows within one and two standard errors is printed, and of all days
the mean. With --models calibrations are kept there, to be used again (by another checkout, too).
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
PERIOD, SUBSTEPS, ROWS, DAY_ROWS = 60.0, 12, 600, 480
DRIVES = ["n_spindle_rpm", "Q_axis_W", "T_hall_degC"]
SENSORS, DISPLACEMENT = ["T_nose_degC", "T_column_degC"], "d_z_um"
WHITE, PROBE = {"T_nose_degC": 0.03, "T_column_degC": 0.02, "T_hall_degC": 0.03}, 0.3
FIRST_ROWS = 20


class Machine:
    """Four bodies: capacities [J/K], links in a row, losses to the air [W/K], growth [µm/K]."""

    def __init__(self, generator: np.random.Generator) -> None:
        def near(values: list[float]) -> np.ndarray:
            return np.array(values) * np.exp(0.25 * generator.standard_normal(len(values)))

        self.capacity = near([2.5e3, 1.4e4, 6e4, 1.1e5])
        self.links, self.losses = near([12.0, 9.0, 6.0]), near([1.5, 4.0, 9.0, 14.0])
        self.growth = near([1.2, 2.5, 4.0, -2.0])
        self.per_turn = 0.04

    def run(self, spindle: np.ndarray, axis: np.ndarray, air: np.ndarray) -> np.ndarray:
        """Temperatures of all bodies [°C], shape (n, 4), soaked in the air at first."""
        body, out = np.full(4, air[0]), np.empty((len(air), 4))
        for k, (turns, power) in enumerate(zip(spindle, axis, strict=True)):
            out[k] = body
            for j in range(SUBSTEPS):
                ahead = air[min(k + 1, len(air) - 1)]
                here = air[k] + (ahead - air[k]) * j / SUBSTEPS
                flow = self.links * (body[:-1] - body[1:])
                heat = self.per_turn * turns * np.array([0.85, 0.15, 0.0, 0.0])
                heat = heat + power * np.array([0.0, 0.0, 0.1, 0.9]) + self.losses * (here - body)
                heat = heat - np.append(flow, 0.0) + np.append(0.0, flow)
                body = body + PERIOD / SUBSTEPS * heat / self.capacity
        return out


def schedule(generator: np.random.Generator, rows: int, levels: list[float]) -> np.ndarray:
    """Levels that are held for 20 to 90 min, after 10 min of none."""
    found = np.zeros(rows)
    at = 10
    while at < rows:
        length = int(generator.integers(20, 90))
        found[at : at + length] = generator.choice(levels)
        at += length
    return found


def day(machine: Machine, seed: int, rows: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A log, and the displacement without noise [µm], from a hall of 20 °C."""
    generator = np.random.default_rng(seed)
    at = PERIOD * np.arange(rows)
    spindle = schedule(generator, rows, [0.0, 1500.0, 3000.0, 4500.0, 6000.0, 8000.0])
    axis = schedule(generator, rows, [0.0, 80.0, 150.0, 300.0])
    air = 20.5 + 1.5 * np.sin(2 * np.pi * (at / 72e3 + generator.uniform()))
    air += generator.uniform(0.4, 1.0) * np.sin(at / generator.uniform(1200, 2400))
    bodies = machine.run(spindle, axis, air)
    truth = (bodies - 20.0) @ machine.growth
    columns = {"time_s": at, "n_spindle_rpm": spindle, "Q_axis_W": axis, "T_hall_degC": air,
               "T_nose_degC": bodies[:, 0], "T_column_degC": bodies[:, 2]}  # fmt: skip
    for name, white in WHITE.items():
        columns[name] = np.round(columns[name] + white * generator.standard_normal(rows), 2)
    columns[DISPLACEMENT] = np.round(truth + PROBE * generator.standard_normal(rows), 1)
    return columns, truth


def write(path: Path, columns: dict[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.10g", ",", header=",".join(columns), comments="")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--seed", type=int, default=4100)
    parser.add_argument("--source", type=Path, default=HERE.parent)
    parser.add_argument("--models", type=Path)
    options = parser.parse_args()
    environment = {**os.environ, "PYTHONPATH": str(options.source.resolve())}
    shares = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.models or Path(scratch)
        folder.mkdir(exist_ok=True)

        def run(*arguments: str) -> None:
            command = [sys.executable, "-m", "thermaltool", *arguments]
            subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)

        for draw in range(options.seed, options.seed + options.draws):
            machine, begun = Machine(np.random.default_rng(draw)), time.monotonic()
            if not (folder / f"{draw}.json").exists():
                write(folder / f"{draw}.csv", day(machine, 10 * draw + 1, ROWS)[0])
                still, _ = day(machine, 10 * draw + 2, 240)
                for name in SENSORS:
                    still[name] = 20 + WHITE[name] * np.random.default_rng(draw).normal(size=240)
                write(folder / f"{draw}_still.csv", {k: still[k] for k in ["time_s", *SENSORS]})
                drives = [each for name in DRIVES for each in ("--drive", name)]
                outputs = [each for name in SENSORS for each in ("--sensor", name)]
                run("calibrate", f"{draw}.csv", *drives, *outputs, "--deflection", DISPLACEMENT,
                    "-o", f"{draw}.json")  # fmt: skip
                run("noise", f"{draw}_still.csv", "-o", f"{draw}_noise.json")
            run("regularize", f"{draw}.json", "--noise", f"{draw}_noise.json", "--form", "kalman",
                "--measured", "Q_axis_W", "--measured", "T_hall_degC",
                "-o", f"{draw}_design.json")  # fmt: skip
            for number in (3, 4):
                log, truth = day(machine, 10 * draw + number, DAY_ROWS)
                del log["n_spindle_rpm"], log[DISPLACEMENT]
                write(folder / "day.csv", log)
                run("estimate", f"{draw}_design.json", "day.csv", "--smooth", "--bands",
                    "-o", "found.csv")  # fmt: skip
                found = np.genfromtxt(folder / "found.csv", delimiter=",", names=True)
                off = found[DISPLACEMENT] - truth
                off -= np.median(off[:FIRST_ROWS])
                sigma = found[f"sigma_{DISPLACEMENT}"]
                size, band = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(sigma**2)))
                shares.append(
                    [*(float(np.mean(np.abs(off) < k * sigma)) for k in (1, 2)), size, band]
                )
                told = "%.2f within 1, %.2f within 2, error %.2f µm, standard error %.2f µm"
                print(f"machine {draw}, day {number}: {told % tuple(shares[-1])}; "
                      f"{time.monotonic() - begun:.0f} s", flush=True)  # fmt: skip
    mean = np.mean(shares, axis=0)
    print(f"{len(shares)} days: {100 * mean[0]:.0f} % within 1, {100 * mean[1]:.0f} % within 2 "
          f"standard errors; error {mean[2]:.2f} µm, standard error {mean[3]:.2f} µm on the mean; "
          f"{sum(each[1] < 0.5 for each in shares)} days with less than half within 2")  # fmt: skip


if __name__ == "__main__":
    main()
