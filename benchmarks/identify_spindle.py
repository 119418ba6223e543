"""Displacements from sixteen temperatures, at speeds that were not fitted: Markdown tables.

    python benchmarks/identify_spindle.py [--machines 8] [--seed N] [--defaults]

Choices of `identify --structure components` on averages of 5 min: what the defaults miss in the
rows behind those that were fitted, and what bounds it. The measured spindle
(``shared/data/cnc_spindle``; left out where it is not there) has stretches within its first 60 %
and, last, the rows behind them; simulated ones (``tests/machines/bodies.py``) are fitted to 12 h
(1250 and 2500 rpm) and run on to 5000 rpm. Columns: the root mean square error of the defaults; of
the best of some thousand choices (components, lags, errors, ridge), picked with the rows that judge
it; the median of these choices; and of a static model by least squares that was fitted to all rows,
and to none but those that judge it. No method that looks at the fitted rows alone knows any but the
first; --defaults leaves the others out.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from machines.bodies import NAMES, TRAINED, run_of

from thermaltool.fitting.components.choose import averaged
from thermaltool.fitting.components.model import output_of
from thermaltool.fitting.components.problem import Choice, ComponentProblem
from thermaltool.fitting.components.reduction import Reduction
from thermaltool.fitting.data import even_training_data
from thermaltool.record import Record

Array = NDArray[np.float64]

LOG = Path(__file__).parents[2] / "shared" / "data" / "cnc_spindle" / "spindle_first_28h.csv"
HOUR, TARGET = 3600.0, "d_z_um"
STRETCHES = (6.1, 10.1, 12.1, 14.1)  # fitted up to here [h]
SPEEDS_FITTED = 12.0  # of the simulated [h]
# Variance of errors over that of weights in the choices; zero: by the evidence.
RIDGES = (0.0, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 1.0)
SLOW = (0.0, 1.0)  # of the simulated, slow errors [um]


def errors_of(record: Record, fitted: float, bounds: bool) -> dict[str, float]:
    """Root mean square errors behind the rows that are fitted.

    Parameters
    ----------
    record : Record
        Sixteen temperatures and the displacement, from rest.
    fitted : float [s]
    bounds : bool
        Whether those are told that know the rows which judge them.
    """
    data = even_training_data([record], NAMES, [TARGET], missing="end").from_rest()
    whole = ComponentProblem(data, Reduction())
    late = (whole.first_row + whole.rows / 2) * data.period >= fitted
    rows = int(np.searchsorted(record.elapsed, fitted))
    early = even_training_data([record.rows(slice(0, rows))], NAMES, [TARGET], missing="end")
    problem = ComponentProblem(early.from_rest(), Reduction())
    found, weighed = averaged(problem)
    missed = record.column(TARGET) - output_of(problem, found, weighed).simulate(data.records[0])
    if not bounds:
        return {"defaults": rms(missed[rows:])}
    counts = [rms(whole.errors(each)[late]) for each in _all(whole, ~late)]
    static = np.vstack([whole.inputs[0], np.ones(len(late))])
    return {
        "defaults": rms(missed[rows:]),
        "best choice": min(counts),
        "median choice": float(np.median(counts)),
        "static, all rows": _least(static, whole.output, late | ~late, late),
        "static, those rows": _least(static, whole.output, late, late),
    }


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _all(problem: ComponentProblem, fitted: NDArray[np.bool_]) -> Iterator:
    grid, n = tuple(range(len(problem.times))), int(fitted.sum())
    sets = [(), grid, grid[::2], grid[1::2], *((lag,) for lag in grid)]
    forms = [(lags, beside) for lags in sets for beside in (True, False) if lags or beside]
    for method in ("pca", "pls"):
        problem.reduction = Reduction(method)
        times = (0.0, *problem.error_times.tolist())
        choices = [
            Choice(k, lags, beside, error, n * ridge)
            for error, k, (lags, beside), ridge in itertools.product(
                times, range(1, len(NAMES) + 1), forms, RIDGES
            )
        ]
        yield from problem.fit(fitted, choices, False)


def _least(
    columns: Array, output: Array, fitted: NDArray[np.bool_], late: NDArray[np.bool_]
) -> float:
    weights = np.linalg.lstsq(columns[:, fitted].T, output[fitted], rcond=None)[0]
    return rms(output[late] - weights @ columns[:, late])


def measured() -> Iterator[tuple[str, Record, float]]:
    """Directions 1, 3 and 5: stretches of the first 60 %, then the rows behind."""
    table = np.genfromtxt(LOG, delimiter=",", names=True)
    clock = table["t_s"]
    end = float(clock[int(TRAINED * len(clock))])
    columns = {name: table[f"t{k + 1}_C"] for k, name in enumerate(NAMES)}
    for stops, last in ((tuple(HOUR * h for h in STRETCHES), end), ((end,), np.inf)):
        kept = clock < last
        for channel in (1, 3, 5):
            own = {**columns, TARGET: table[f"ch{channel}_um"]}
            record = Record(clock[kept], {name: v[kept] for name, v in own.items()})
            for stop in stops:
                name = f"direction {channel}, " + ("behind 60 %" if stop == end else "within 60 %")
                yield name, record, stop


def simulated(machines: int, seed: int) -> Iterator[tuple[str, Record, float]]:
    """Machines with white errors and with slow ones."""
    for slow in SLOW:
        for k in range(machines):
            run = run_of(np.random.default_rng([seed, k]), slow)
            known = dict(zip(NAMES, run.temperatures, strict=True))
            for y in run.displacements:
                yield (f"simulated, slow errors of {slow:g} µm",
                       Record(run.time, {**known, TARGET: y}), SPEEDS_FITTED * HOUR)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machines", type=int, default=8)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--defaults", action="store_true", help="no bounds: a minute")
    chosen = parser.parse_args()
    print(f"Seed {chosen.seed}; geometric mean over fits [µm].\n")
    logs = [*(measured() if LOG.exists() else ()), *simulated(chosen.machines, chosen.seed)]
    rows: dict[str, list[dict[str, float]]] = {}
    for name, record, fitted in logs:
        rows.setdefault(name, []).append(errors_of(record, fitted, not chosen.defaults))
    first = next(iter(rows.values()))[0]
    print("| log | fits |", " | ".join(first), "|")
    print("|---|---|" + "---|" * len(first))
    for name, found in rows.items():
        means = np.exp(np.mean(np.log([list(each.values()) for each in found]), axis=0))
        print(f"| {name} | {len(found)} |", " | ".join(f"{mean:.2f}" for mean in means), "|")


if __name__ == "__main__":
    main()
