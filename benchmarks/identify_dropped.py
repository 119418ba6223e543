"""``identify`` of logs that lack rows, beside the same logs with all rows.

``python benchmarks/identify_dropped.py`` (in make study): the processes of `process_plants`, of
which a share of the rows is lost at random, here and there; the first 60 % fitted with nothing
given but the names of the channels, the run carried on over the other 40 % and held against the
outputs without noise. Seeds are drawn fresh and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import time

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from identify_process import FITTED_SHARE, held_fits, names, record
from process_plants import PLANTS

import thermaltool as tt
from thermaltool.record import Record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--share", type=float, default=0.01, help="of the rows that are lost")
    parser.add_argument("--only", default="", help="part of the name of a process")
    given = parser.parse_args()
    print(f"seed {given.seed}, {100 * given.share:g} % of the rows lost\n")
    print("| process | rows | records | CPU s | found | held-out fit of each output % |")
    print("|---|---|---|---|---|---|")
    for name, plant in PLANTS.items():
        if given.only not in name:
            continue
        run = plant(np.random.default_rng([given.seed, 0]))
        rows, (ins, outs) = round(FITTED_SHARE * run.y.shape[1]), names(run)
        whole = record(run, rows)
        fitted = whole.rows(slice(0, rows))
        kept = np.random.default_rng([given.seed, 1]).random(rows) >= given.share
        kept[0] = True
        for label, log in (("all", fitted), ("some lost", fitted.where(kept))):
            begun = time.process_time()
            fits = tt.identify(log, ins, outs, warn=lambda message: None).fits
            seconds = time.process_time() - begun
            records, model = fits[0].data.records, fits[0].model
            going_on = Record(whole.time, whole.columns, at_rest=records[0].at_rest)
            computed = np.array([fit.model.simulate(going_on) for fit in fits])
            each = " ".join(f"{fit:.2f}" for fit in held_fits(run, computed, rows))
            found = f"{model.method}, order {model.order}"
            print(f"| {name} | {label} | {len(records)} | {seconds:.1f} | {found} | {each} |",
                  flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
