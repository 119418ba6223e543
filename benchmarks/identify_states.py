"""``identify`` on machines whose losses, gains or drives go by a state: linear, and by default.

``python benchmarks/identify_states.py``: the first 60 % of each record are fitted, the linear model
by second order, and what is found beside it as by default; the run goes on over the other 40 %.
Seeds are drawn fresh and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from machines.stateful import cooled, steam_heated, turning

from thermaltool.fitting.identification import identify
from thermaltool.fitting.lpv.model import LpvOutput
from thermaltool.fitting.transfer.plan import TransferPlan
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.record import Record
from thermaltool.report.lpv import described

ORDERS = ((2, 2, 1),)
MACHINES = {
    "tube in steam that a flow crosses": steam_heated,
    "body that a fan cools": cooled,
    "friction by speed^1.5": turning,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--rows", type=int, default=3000)
    given = parser.parse_args()
    print(f"seed {given.seed}\n")
    print("| machine | linear % | found | carried on % | CPU time s |")
    print("|---|---|---|---|---|")
    for name, machine in MACHINES.items():
        period, columns, _ = machine(np.random.default_rng(given.seed), given.rows)
        *inputs, output = columns
        record = Record(period * np.arange(given.rows), columns)
        fits, seconds = [], 0.0
        for linear in (True, False):
            plan = TransferPlan(
                structure=structure_of("oe"), orders=ORDERS, linear=linear, split=0.6
            )
            begun = time.process_time()
            fits += identify([record], inputs, [output], plan)
            seconds = time.process_time() - begun
        model = fits[1].model
        found = "linear"
        if isinstance(model, LpvOutput):
            found = f"{described(model.form)}, {model.order} modes"
            found += "".join(f", exponent {e.value:.3f} ({e.low:.3f} to {e.high:.3f})"
                             for e in model.exponent_estimates().values())  # fmt: skip
        fit = [f"{each.validation.carried_on.fit_percent:.1f}" for each in fits if each.validation]
        print(f"| {name} | {fit[0]} | {found} | {fit[1]} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
