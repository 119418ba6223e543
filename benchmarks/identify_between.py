"""Feedthrough that ``identify`` takes where commands switch between the rows of a log.

    python benchmarks/identify_between.py [--logs 20] [--structure subspace] [--seed SEED]

Each log: a heat that switches at any second, or at a row, rows every 60 s that show the command at
the row; a temperature of one lag of four to twenty rows, in some logs with feedthrough beside it
(a tenth of the lag's gain, or half of it); ten hours, white noise. The plant is a recursion at
every second and shares no code with the tool. Printed: share of logs along straight lines, share
with feedthrough in the model, and the median error of the time constant. Seeds are drawn fresh.
"""

from __future__ import annotations

import argparse
import itertools
import secrets

import numpy as np
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.record import Record

ROWS, ROW, GAIN = 600, 60, 2.0
NOISES, DIRECT = (0.005, 0.02, 0.05, 0.1), (0.0, 0.2, 1.0)


def log(rng: np.random.Generator, noise: float, direct: float, between: bool):
    """A log, and the time constant of its lag [s]."""
    u, at, tau = np.zeros(ROWS * ROW), 5 * ROW, float(rng.uniform(240, 1200))
    while at < len(u):
        u[at:] = rng.choice([0.0, 20.0, 50.0, 100.0])
        step = int(rng.uniform(10, 60) * ROW)
        at += step if between else step // ROW * ROW
    pole = np.exp(-1 / tau)
    y = (GAIN * lfilter([0, 1 - pole], [1, -pole], u) + direct * u)[::ROW]
    y = 20 + y + noise * y.std() * rng.standard_normal(ROWS)
    clock = ROW * np.arange(float(ROWS))
    return Record(clock, {"Q_a_W": u[::ROW], "T_a_degC": y}, name="log"), tau


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--structure", default="subspace")
    parser.add_argument("--seed", type=int, default=secrets.randbits(31))
    given = parser.parse_args()
    print(f"seed {given.seed}, {given.structure}\n")
    print("| switches | feedthrough | noise % | along lines % | with feedthrough % | tau off % |")
    print("|---|---|---|---|---|---|")
    for between, direct, noise in itertools.product((True, False), DIRECT, NOISES):
        found = []
        for k in range(given.logs):
            record, tau = log(np.random.default_rng([given.seed, k]), noise, direct, between)
            model = tt.identify(record, "Q_a_W", "T_a_degC", structure=given.structure,
                                warn=lambda message: None).model  # fmt: skip
            response = model.terms[0].response
            found.append((model.drives[0].hold == "first", "direct" in response.kind,
                          abs(response.slowest() / tau - 1)))  # fmt: skip
        lines, direct_share, off = np.array(found, float).T
        where = "between rows" if between else "at rows"
        shares = f"{100 * lines.mean():.0f} | {100 * direct_share.mean():.0f}"
        print(f"| {where} | {direct:g} | {100 * noise:g} | {shares} | "
              f"{100 * np.median(off):.1f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
