"""Coverage of calibrate's 95 % intervals where commands switch between the rows of a coarse log.

    python benchmarks/calibrate_between.py [--machines 30] [--seed SEED] [--on-row]

Each machine: two heaters that switch at any second, rows every 60 s that show the command at the
row; a temperature of one lag and one of two lags for each heater, a tenth of an hour to an hour;
ten hours to calibrate on, ten others to simulate. The plant is a sum of lags at every second and
shares no code with the tool. Printed: share of gains and time constants inside their intervals,
the median width of these, the error of `simulate` on the other log.
"""

from __future__ import annotations

import argparse
import secrets
import time as clock

import numpy as np
from scipy.signal import lfilter

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import characteristics
from thermaltool.record import Record

HEATS, DURATION, ROW, NOISE = ("Q_a_W", "Q_b_W"), 36000, 60, 0.02
KINDS = {"T_head_degC": "rational1", "T_col_degC": "rational2"}


def command(rng, top, shortest, longest, on_row):
    """A heat at every second."""
    level, at = np.zeros(DURATION + 1), rng.uniform(60, 200)
    while at < DURATION:
        start = int(-(-at // ROW) * ROW) if on_row else int(at)
        level[start:] = top * rng.choice([0.0, 0.3, 0.6, 1.0])
        at += rng.uniform(shortest, longest)
    return level


def log_of(rng, lags, on_row):
    """A log of a machine, a row a minute."""
    heats = [command(rng, 200, 70, 400, on_row), command(rng, 150, 90, 500, on_row)]
    rows = np.arange(0, DURATION + 1, ROW)
    columns = {name: heat[rows] for name, heat in zip(HEATS, heats, strict=True)}
    for output, terms in lags.items():
        y = np.full(DURATION + 1, 20.0)
        for heat, own in zip(heats, terms, strict=True):
            for gain, tau in own:
                a = np.exp(-1 / tau)
                y[1:] += gain * lfilter([1 - a], [1, -a], heat[:-1])
        columns[output] = y[rows] + NOISE * rng.standard_normal(len(rows))
    return Record(rows.astype(float), columns, digest=secrets.token_hex(8))


def machine(rng):
    """(gain, time constant) of each lag of each heat of each output."""
    one = [
        [(rng.uniform(0.02, 0.08), np.exp(rng.uniform(np.log(360), np.log(3600))))] for _ in "ab"
    ]
    two = [
        [
            (rng.uniform(0.02, 0.06), np.exp(rng.uniform(np.log(300), np.log(600)))),
            (rng.uniform(0.02, 0.06), np.exp(rng.uniform(np.log(1800), np.log(3600)))),
        ]
        for _ in "ab"
    ]
    return {"T_head_degC": one, "T_col_degC": two}


def main():
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--machines", type=int, default=30)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--on-row", action="store_true", help="commands switch at the rows")
    given = parser.parse_args()
    seed = secrets.randbelow(10**6) if given.seed is None else given.seed
    rng = np.random.default_rng(seed)
    inside, widths = {"gain": [], "time constant": []}, {"gain": [], "time constant": []}
    errors, began = [], clock.perf_counter()
    for _ in range(given.machines):
        lags = machine(rng)
        train, test = (log_of(rng, lags, given.on_row) for _ in range(2))
        plan = CalibrationPlan(HEATS, tuple(KINDS), kinds=KINDS, choose=True, linear=True)
        model = calibrate([train], plan)
        simulated = model.simulate(test)
        errors += [np.std(test.columns[o] - simulated[o]) for o in KINDS]
        for term in model.terms:
            own = sorted(lags[term.output][HEATS.index(term.drive)], key=lambda lag: -lag[1])
            told = characteristics(term)
            found = [("gain", told.gain, sum(gain for gain, _ in own))]
            taus = sorted(told.time_constants, key=lambda each: -each.value)
            found += [("time constant", e, tau) for e, (_, tau) in zip(taus, own, strict=True)]
            for name, estimate, truth in found:
                low, high = estimate.low, estimate.high
                inside[name].append(low <= truth <= high)
                widths[name].append((high - low) / truth)
    for name, own in inside.items():
        print(f"{name}: {100 * np.mean(own):.1f} % of {len(own)} inside, "
              f"width {100 * np.median(widths[name]):.2g} %")  # fmt: skip
    print(f"simulate of another log: {np.median(errors):.4g} °C (median)")
    print(f"{clock.perf_counter() - began:.0f} s, --seed {seed}")


if __name__ == "__main__":
    main()
