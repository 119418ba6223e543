"""How often a stream that does not know its start has an alarm: warm, or blind for a while.

    python benchmarks/warm_stream.py [--draws 20] [--seed 100] [--source ../old_checkout]

A part with three sensors, a lag each in air of 20 °C, is calibrated from rest; heats are drawn, and
held for 20 to 50 min. Some streams begin after the first 50 min of the machine, some have a pause
of 43 min; of each half are of a machine that loses heat faster (half of the slowest sensor's rate
more). Printed is how many of them have an alarm, and after how many rows on the median.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd

PERIOD, NOISE = 20.0, 0.02
LAGS, RISES = np.array([300.0, 900.0, 2500.0]), np.array([5.0, 4.0, 3.0])
SENSORS = ["T_a_degC", "T_b_degC", "T_c_degC"]
DURATIONS = [150, 60, 90, 120, 80, 100]
LOSS = 0.5 / LAGS[-1]


def log(heat: np.ndarray, generator: np.random.Generator, loss: float = 0.0) -> pd.DataFrame:
    """Readings of a heat, and a displacement; `loss` adds to each rate [1/s]."""
    rates = np.append(1 / LAGS, 1 / 1200.0) + loss
    gains = np.append(RISES / LAGS, 30.0 / 1200.0) / rates
    stays, rise = np.exp(-rates * PERIOD), np.zeros((len(heat), 4))
    for k, q in enumerate(heat[:-1]):
        rise[k + 1] = stays * rise[k] + (1 - stays) * gains * q
    read = rise + np.array([NOISE] * 3 + [0.1]) * generator.normal(size=rise.shape)
    table = {"time_s": PERIOD * np.arange(len(heat)), "Q_main_1": heat}
    table |= dict(zip(SENSORS, 20.0 + read[:, :3].T, strict=True))
    return pd.DataFrame(table | {"d_z_um": read[:, 3]})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--source", type=Path, default=Path(__file__).resolve().parent.parent)
    options = parser.parse_args()
    sys.path.insert(0, str(options.source.resolve()))
    import thermaltool as tt
    from thermaltool.runtime.compensation import offsets
    from thermaltool.runtime.messages import Messages
    from thermaltool.runtime.rows.row import Row
    from thermaltool.runtime.settings import Settings

    generator = np.random.default_rng(options.seed - 1)
    heat = np.repeat([0.0, 1.0, 0.0, 0.6, 0.2], [20, 180, 120, 100, 80])
    kinds = dict.fromkeys([*SENSORS, "d_z_um"], "rational1")
    fit = tt.calibrate(log(heat, generator), ["Q_main_1"], sensors=SENSORS, deflections=["d_z_um"],
                       initial="rest", kinds=kinds, linear=True, warn=str)  # fmt: skip
    noise = tt.noise(log(0 * heat, generator)[["time_s", *SENSORS]], warn=str)
    model = tt.regularize(fit, noise, form="kalman", warn=str).model

    def first_alarm(rows: pd.DataFrame) -> int | None:
        process = offsets(model, Settings(bands=True, step=0.0), Messages(str, "rows"))
        at = process.names.index("alarm")
        for k, (time, *readings) in enumerate(rows[["time_s", *SENSORS]].to_numpy().tolist()):
            if process.take(Row(time, readings, [""] * len(SENSORS)))[1][at] == "parted":
                return k
        return None

    for name, blind in (("begins warm", slice(0, 150)), ("pause of 43 min", slice(200, 330))):
        for machine, loss in (("as calibrated", 0.0), ("loses more heat", LOSS)):
            found = []
            for draw in range(options.draws):
                generator = np.random.default_rng(options.seed + draw)
                heat = np.repeat(generator.uniform(0, 1, len(DURATIONS)), DURATIONS)
                heat = heat if blind.start == 0 else np.append(np.zeros(20), heat)
                rows = log(heat, generator, loss)
                found.append(first_alarm(rows.drop(index=rows.index[blind])))
            alarms = [k for k in found if k is not None]
            after = f", after {np.median(alarms):.0f} rows" if alarms else ""
            print(f"{name}, {machine}: {len(alarms)} of {options.draws} have an alarm{after}")


if __name__ == "__main__":
    main()
