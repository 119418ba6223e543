"""CPU time of `diagnose` on a machine whose fan is switched by a thermostat and not logged.

    python benchmarks/thermostat_fan_speed.py SEED [--heats 1|2] [--rows 1800]

A heated chain (tests/machines/cooled_chain.py) with one logged heat or two, a room that swings and
an uneven clock, and four or five outputs: calibrated without the fan, diagnosed on one log with it,
validated on another. Prints the CPU time of the calibration and of the diagnosis, one thread, and
the causes with their evidence.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

# One thread: CPU time is that of the work. Before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import pandas as pd
from machines.cooled_chain import PLACES, CooledChain

import thermaltool as tt

# The clock is off by so much at most [s]; the fan multiplies what the motor loses by so much.
JITTER, FACTOR = 2.0, 2.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seed", type=int)
    parser.add_argument("--heats", type=int, choices=(1, 2), default=2)
    parser.add_argument("--rows", type=int, default=1800)
    options = parser.parse_args()
    machine, two = CooledChain.drawn(options.seed), options.heats == 2

    def log(number: int, **fan: object) -> pd.DataFrame:
        columns = machine.log(
            options.seed + number, options.rows, jitter=JITTER, heated_bed=two, **fan
        )
        return pd.DataFrame({k: v for k, v in columns.items() if not k.startswith("x_")})

    known = log(1)
    warm = known["T_motor_degC"].quantile(0.98) - 20.0
    fan = {"factor": FACTOR, "thermostat": (20.0 + 0.6 * warm, 20.0 + 0.48 * warm)}
    begin = time.process_time()
    model = tt.calibrate(
        known,
        ["P_motor_W", *["P_bed_W"] * two, "T_room_degC"],
        sensors=[f"T_{place}_degC" for place in PLACES],
        deflections=["d_tool_um", *["d_bed_um"] * two],
        warn=lambda message: None,
    )
    calibrated = time.process_time()
    found = tt.diagnose(model, log(2, **fan), validate=[log(3, **fan)], warn=lambda message: None)
    print(
        f"calibrate {calibrated - begin:.0f} s, diagnose {time.process_time() - calibrated:.0f} s"
    )
    for cause in found.diagnosis.causes:
        effect = cause.effect
        print(f"{effect.name} {effect.channel} {effect.partner} evidence {cause.evidence:.9g}")


if __name__ == "__main__":
    main()
