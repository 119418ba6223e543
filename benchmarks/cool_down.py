"""What a cool-down says of a model that was calibrated on a warm-up: is the cause named?

    python benchmarks/cool_down.py [--machines N] [--seed N]

Spindles of tests/machines/turning_spindle.py (lumps, no code of the package), calibrated on a
warm-up at one speed, with the speed as the only drive. Their bearing cools by the speed, or a fan
of their motor stops with them: convection that changes with a state at a known place. Or a pump
heats the housing, on and off by itself: a second source. `diagnose` sees a log of two warm-ups and
cool-downs, and another one to judge by.
"""

from __future__ import annotations

import argparse
import os
import secrets
import sys
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.append(str(Path(__file__).parents[1] / "tests"))

import numpy as np
import pandas as pd
from machines.turning_spindle import PLACES, TurningSpindle, spells, warm_and_cool, warm_up

import thermaltool as tt

DRIVE = "n_spindle_rpm"
TRUTH = {
    "speed": ("convection_state", DRIVE, "T_bearing_degC"),
    "fan": ("convection_state", DRIVE, "T_motor_degC"),
    "pump": ("second_source", "x_pump_1", None),
}


def quiet(message):
    """Nothing is told."""


def diagnosed(seed: int, kind: str):
    """Causes that are named on one machine, as (name, channel, place)."""
    machine, rng = TurningSpindle.drawn(seed), np.random.default_rng([seed, 1])
    cooled = kind if kind in ("speed", "fan") else None

    def log(k, speeds, pumped=False):
        pump = spells(rng, len(speeds)) if pumped else None
        return pd.DataFrame(machine.log(seed + k, speeds, cooled, pump))

    model = tt.calibrate(
        log(1, warm_up(5.0)),
        DRIVE,
        sensors=[f"T_{place}_degC" for place in PLACES],
        deflections="d_z_um",
        warn=quiet,
    )
    logs = [log(k, warm_and_cool(rng, 9.0), kind == "pump") for k in (2, 3)]
    found = tt.diagnose(model, logs[0], validate=[logs[1]], warn=quiet).diagnosis
    return [(c.effect.name, c.effect.channel, c.effect.partner) for c in found.causes]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machines", type=int, default=6)
    parser.add_argument("--seed", type=int)
    given = parser.parse_args()
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    print(f"seed {seed}\n\n| machine | cool-down differs by | cause named first | beside it | s |")
    print("|---|---|---|---|---|")
    for k in range(given.machines):
        for kind in TRUTH:
            begin = time.monotonic()
            named = [" ".join(filter(None, each)) for each in diagnosed(seed + 10 * k, kind)]
            first, *others = named or ["none"]
            print(f"| {k} | {kind} | {first} | {'; '.join(others)} | "
                  f"{time.monotonic() - begin:.0f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
