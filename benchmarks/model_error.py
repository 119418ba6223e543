"""Heat with a model that is a little wrong: what is claimed, and whether the bands hold.

A machine of two sensors, each a sum of lags, is calibrated; then one time constant of the machine
is another one, by a percent or so, and the heat is smoothed from a log that begins at rest or warm
(`--initial free`). Printed are the root mean squared error of the heat over its level, the share of
rows within the 95 % band, and on how many logs a loss of heat or a sensor was told to be the cause.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import thermaltool as tt

Array = NDArray[np.float64]
PERIOD, LEVEL, ROWS, BEFORE = 5.0, 200.0, 700, 600
# Gains [K/W] and time constants [s] of both sensors: one lag each, and one that two share.
MACHINES = {
    "a lag each": (((0.1, 0),), ((0.08, 1),)),
    "two lags in one": (((0.05, 0),), ((0.02, 1), (0.01, 0))),
}
TIMES = (600.0, 1500.0)


def rise(heat: Array, gain: float, time_constant: float) -> Array:
    stays, x, found = np.exp(-PERIOD / time_constant), 0.0, np.empty(len(heat))
    for k, q in enumerate(heat):
        found[k] = x
        x = stays * x + (1 - stays) * gain * q
    return found


def log_of(
    machine: tuple, heat: Array, times: tuple[float, float], noise: float, cut: int,
    generator: np.random.Generator,
) -> pd.DataFrame:  # fmt: skip
    columns = {"time_s": PERIOD * np.arange(len(heat) - cut), "Q_main_W": heat[cut:]}
    for k, parts in enumerate(machine, 1):
        read = sum(rise(heat, gain, times[at]) for gain, at in parts)
        columns[f"dT_{k}_K"] = (read + noise * generator.standard_normal(len(heat)))[cut:]
    return pd.DataFrame(columns)


def duty(rows: int, generator: np.random.Generator) -> Array:
    heat, k = np.zeros(rows), int(generator.integers(10, 30))
    while k < rows:
        stop = k + int(generator.uniform(60.0, 600.0) / PERIOD)
        heat[k:stop] = LEVEL * generator.uniform() * (generator.uniform() < 0.75)
        k = stop
    return heat


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=8, help="logs for each line")
    parser.add_argument("--noise", type=float, default=0.01, help="K")
    parser.add_argument("--seed", type=int, help="drawn and printed if absent")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().entropy % 2**32)
    print(f"seed {seed}, {options.draws} logs a line", file=sys.stderr)
    heading = ["machine", "off", "start", "RMSE, % of level", "in 95 % band, % (least log)"]
    heading += ["loss told", "sensor told", "parted"]
    print(f"| {' | '.join(heading)} |\n|{'---|' * len(heading)}", flush=True)
    for number, (name, machine) in enumerate(MACHINES.items()):
        generator = np.random.default_rng([seed, number])
        heat = duty(2400, generator)
        heat[20:1000], heat[1000:1800] = LEVEL, 0.0
        log = log_of(machine, heat, TIMES, options.noise, 0, generator)
        sensors = ["dT_1_K", "dT_2_K"]
        fit = tt.calibrate(log, ["Q_main_W"], sensors=sensors, initial="rest", warn=str)
        idle = log_of(machine, np.zeros(2000), TIMES, options.noise, 0, generator)
        design = tt.regularize(fit, tt.noise(idle, warn=str), form="kalman", warn=str)
        for which, by in ((0, 0.0), (1, -0.01), (1, 0.01), (0, 0.01), (1, 0.03)):
            times = tuple(t * (1 + by * (k == which)) for k, t in enumerate(TIMES))
            for start in ("rest", "warm"):
                squares, inside, loss, sensor, parted = [], [], 0, 0, 0
                for _ in range(options.draws):
                    cut = BEFORE if start == "warm" else 0
                    heat = duty(ROWS + cut, generator)
                    heat[50:cut] = 0.75 * LEVEL
                    log = log_of(machine, heat, times, options.noise, cut, generator)
                    found = tt.estimate(
                        design, log.drop(columns="Q_main_W"), smooth=True, bands=True, warn=str,
                        initial="free" if start == "warm" else "rest",
                    )  # fmt: skip
                    error = found.columns["Q_main_W"] - heat[cut:]
                    squares.append(np.mean(error**2))
                    inside.append(np.mean(np.abs(error) < 1.96 * found.columns["sigma_Q_main_W"]))
                    told = found.found.change
                    if told is not None and told.is_clear:
                        loss += told.kind == "loss"
                        sensor += told.kind != "loss"
                    parted += found.found.alarm.row is not None
                off = f"{100 * by:+.0f} % of {TIMES[which]:.0f} s" if by else "–"
                band = f"{100 * np.mean(inside):.1f} ({100 * min(inside):.0f})"
                error = 100 * np.sqrt(np.mean(squares)) / LEVEL
                cells = [name, off, start, f"{error:.2f}", band, loss, sensor, parted]
                print(f"| {' | '.join(map(str, cells))} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
