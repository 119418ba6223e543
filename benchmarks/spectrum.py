"""Intervals of ``spectrum`` over fresh noise, and the sample log.

    python benchmarks/spectrum.py coverage [--logs 200] [--seed N] [--kinds 0,1]
    python benchmarks/spectrum.py log FILE

The transients are sums of exponentials by their formula in numpy (tests/machines/foster.py), with
white noise of 0.1 % of the range, 50 rows in a decade. `coverage` prints a Markdown table: the
numbers of lines found, the largest error of the curve against the noise-free truth in percent of
its range, and how often 95 % intervals hold: of the cumulative resistance half a decade apart; of
the lines, whatever lies between them; and of the lines alone, where as many were found as there
are. Random spectra have time constants anywhere in their decades, so that many cannot be told
apart.
"""

from __future__ import annotations

import argparse
import itertools
import secrets
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from machines.foster import (
    EIGHT_DECADES,
    THREE_DECADES,
    Foster,
    logarithmic_clock,
    noisy,
    power_of,
)

from thermaltool.fitting.spectrum.bounds import SpectrumBounds
from thermaltool.fitting.spectrum.compressed import compress
from thermaltool.fitting.spectrum.lines import LineFit, candidates, choose
from thermaltool.fitting.spectrum.transient import transient_of
from thermaltool.record import Record

DRIVE, OUTPUT, STEP, PER_DECADE = "P_die_W", "T_die_degC", {0.0: 2.0}, 50
# Cuts at which the cumulative resistance is judged, in a decade; rounding that is forgiven.
CUTS, ROUNDING = 2, 1e-4
# A die on its carrier, heat sink and room, for the sample log.
SAMPLE = Foster(np.array([2e-4, 5e-3, 0.12, 2.5, 60.0, 900.0]),
                np.array([0.12, 0.25, 0.35, 0.3, 0.5, 1.1]))  # fmt: skip
SAMPLE_SEED, SAMPLE_POWER, SAMPLE_NOISE = 20, 10.0, 0.02


def random_plant(count: int, decades: float, rng: np.random.Generator) -> Foster:
    """Time constants anywhere in some decades from 10 ms on."""
    taus = np.sort(1e-2 * 10 ** rng.uniform(0, decades, count))
    return Foster(taus, rng.uniform(0.1, 0.4, count))


def log_of(plant: Foster, rng: np.random.Generator) -> Record:
    """A heating transient with noise."""
    time = logarithmic_clock(plant, PER_DECADE)
    rise = noisy(rng, plant.rise(time, STEP))
    return Record(time, {DRIVE: power_of(time, STEP), OUTPUT: 20 + rise})


def fit_of(log: Record) -> LineFit:
    """The lines of the least BIC."""
    return choose(candidates(compress(transient_of(log, DRIVE, OUTPUT))))


def curve_error(fit: LineFit, plant: Foster) -> float:
    """Largest error of the curve against the truth, in percent of its range."""
    time = logarithmic_clock(plant, PER_DECADE)
    truth = 20 + plant.rise(time, STEP)
    found = fit.offset + Foster(np.exp(fit.logs), fit.resistances).rise(time, STEP)
    return 100 * float(np.max(np.abs(found - truth)) / np.ptp(truth))


class Hits:
    """How often intervals hold."""

    def __init__(self) -> None:
        self.cumulative: list[bool] = []
        self.lines: list[bool] = []
        self.alone: list[bool] = []
        self.counts: list[int] = []
        self.errors: list[float] = []

    def take(self, fit: LineFit, plant: Foster) -> None:
        """Judge the fit of one log."""
        self.counts.append(len(fit.logs))
        self.errors.append(curve_error(fit, plant))
        bounds, logs = SpectrumBounds(fit), np.log(plant.taus)
        forgiven = ROUNDING * bounds.total
        first, last = logs[0] - 1, logs[-1] + 1
        count = int(CUTS * (last - first) / np.log(10))
        for cut in np.linspace(first, last, count).tolist():
            low, high = bounds.resistance(-np.inf, cut)
            truth = plant.up_to(np.exp(cut))
            self.cumulative.append(low - forgiven <= truth <= high + forgiven)
        edges = [-np.inf, *((fit.logs[1:] + fit.logs[:-1]) / 2).tolist(), np.inf]
        for start, stop in itertools.pairwise(edges):
            inside = (logs > start) & (logs <= stop)
            weights = plant.resistances[inside]
            low, high = bounds.resistance(start, stop)
            self.lines.append(low - forgiven <= weights.sum() <= high + forgiven)
            if inside.any():
                low, high = bounds.mean_log(start, stop)
                mean = float(weights @ logs[inside] / weights.sum())
                self.lines.append(low - ROUNDING <= mean <= high + ROUNDING)
        if len(fit.logs) == len(logs):
            errors = np.sqrt(np.diag(fit.covariance()))
            off = np.append(fit.logs - logs, fit.resistances - plant.resistances)
            self.alone += (np.abs(off) < 1.96 * errors).tolist()

    def row(self, name: str) -> str:
        """Of the Markdown table."""
        numbers = ", ".join(f"{n}: {self.counts.count(n)}" for n in sorted(set(self.counts)))
        parts = (self.cumulative, self.lines, self.alone)
        held = " | ".join(f"{100 * np.mean(p):.1f} %" if p else "–" for p in parts)
        return f"| {name} | {numbers} | {max(self.errors):.2f} % | {held} |"


def coverage(logs: int, seed: int, wanted: list[int]) -> None:
    """Print the table."""
    print(f"Seed {seed}, {logs} logs of each kind.\n")
    print("| transient | lines found: logs | curve off by | cumulative R | lines | lines alone |")
    print("|---|---|---|---|---|---|")
    kinds = {
        "8 over 8 decades": lambda rng: EIGHT_DECADES,
        "6 over 3 decades": lambda rng: THREE_DECADES,
        "8 anywhere in 8 decades": lambda rng: random_plant(8, 8.0, rng),
        "6 anywhere in 3 decades": lambda rng: random_plant(6, 3.0, rng),
        "8 anywhere in 3 decades": lambda rng: random_plant(8, 3.0, rng),
    }
    for k, (name, plant_of) in enumerate(kinds.items()):
        if wanted and k not in wanted:
            continue
        hits = Hits()
        for j in range(logs):
            rng = np.random.default_rng([seed, k, j])
            plant = plant_of(rng)
            hits.take(fit_of(log_of(plant, rng)), plant)
        print(hits.row(name), flush=True)


def write_sample(target: str) -> None:
    """A junction heated by 10 W from the row at 0 s on, rows on a logarithmic clock."""
    time = np.concatenate([np.arange(-5.0, 0.5), np.geomspace(1e-5, 5e3, 350)]).round(9)
    steps = {0.0: SAMPLE_POWER}
    rng = np.random.default_rng(SAMPLE_SEED)
    warm = 25 + SAMPLE.rise(time, steps) + SAMPLE_NOISE * rng.standard_normal(len(time))
    rows = [f"{t:.10g},{p:g},{x:.3f}" for t, p, x in
            zip(time, power_of(time, steps), warm, strict=True)]  # fmt: skip
    Path(target).write_text("time_s,P_die_W,T_die_degC\n" + "\n".join(rows) + "\n")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("coverage", "log"))
    parser.add_argument("target", nargs="?")
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=secrets.randbits(64))
    parser.add_argument("--kinds", default="", help="places in the table; all by default")
    given = parser.parse_args()
    if given.what == "log":
        write_sample(given.target)
    else:
        coverage(given.logs, given.seed, [int(k) for k in given.kinds.split(",") if k])


if __name__ == "__main__":
    main()
