"""Transfer functions beside open peers, honest intervals, measured logs: Markdown tables.

``python benchmarks/identify.py speed`` (make bench), ``coverage`` and ``measured`` (make study).
Fits of `speed` are of free runs on fresh data without noise, where the true system reaches 100 %.
Peers that are not installed are left out; --long runs them on all systems with three inputs and at
10⁵ rows, which takes an hour. Seeds are drawn fresh and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import time
from functools import partial
from pathlib import Path

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import network
import numpy as np
from identify_cases import NOISE, driven, response, sampled, system
from identify_peers import Array
from identify_speed import speed
from scipy.signal import lfilter

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.selection import first_that_fits
from thermaltool.fitting.transfer.choose import choose
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.units import Hold

DATA = Path(__file__).parents[2] / "shared" / "data"


def coverage(seed: int, repeats: int) -> None:
    """Share of 95 % intervals that hold the truth, and bias in standard errors."""
    print("| system | noise | parameter | covered % | bias / standard error |")
    print("|---|---|---|---|---|")
    for k in (0, 2):
        truth = system(np.random.default_rng([seed, k]), k)
        u = driven(np.random.default_rng([seed, k, 1]), k, 3000)[None]
        x, known = response(truth, u[0]), np.concatenate([truth[1][1:], truth[0]])
        gain = truth[0].sum() / truth[1].sum()
        for name, colour in (("white", ([1.0], [1.0])), ("AR(1) 0.8", ([0.6], [1.0, -0.8]))):
            inside, errors, labels = [], [], []
            for repeat in range(repeats):
                e = np.random.default_rng([seed, k, 2, repeat]).standard_normal(3000)
                y = x + NOISE * x.std() * lfilter(*colour, e)
                data = TrainingData((sampled(("u",), u, ("y",), y, 1.0),), ("u",), ("y",), 1.0)
                structure = OeStructure()
                model = structure.fit(data, structure.orders((2,), 2, (truth[2],)))
                named = [*model.named(), ("gain", model.gain(0))]
                labels = [label for label, _ in named]
                values = np.array([each.value for _, each in named])
                low = np.array([each.low for _, each in named])
                high = np.array([each.high for _, each in named])
                goal = np.append(known, gain)
                inside.append((low < goal) & (goal < high))
                errors.append((values - goal) / ((high - low) / 2 / 1.96))
            for label, share, bias in zip(labels, np.mean(inside, axis=0),
                                          np.mean(errors, axis=0), strict=True):  # fmt: skip
                print(f"| {k} | {name} | {label} | {100 * share:.1f} | {bias:+.2f} |", flush=True)


def measured() -> None:
    """Free-run fits on the part of each measured log that was not fitted."""
    if not DATA.exists():
        print(f"left out, there is no {DATA} here (measured logs are not copied into the project)")
        return
    print("| log | output | inputs | poles | orders nb,nf,nk | training % | held out % |")
    print("|---|---|---|---|---|---|---|")
    hair = np.genfromtxt(DATA / "daisy/hairdryer_ljung.csv", delimiter=",", skip_header=1)
    heat = np.genfromtxt(DATA / "daisy/heating_system.csv", delimiter=",", skip_header=1)
    _measured("hairdryer", "y", ("u",), hair[:, 0], hair[:, 1], 0.08, True, 0.5)
    _measured("heating_system", "T", ("u",), heat[:, 1], heat[:, 2], 2.0, True, 0.5)
    power = heat[:, 1] ** 1.85
    _measured("heating_system", "T", ("u^1.85",), power, heat[:, 2], 2.0, True, 0.5)
    lines = (DATA / "cnc_spindle/spindle_first_28h.csv").read_text().splitlines()
    names = lines[0].split(",")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    column = dict(zip(names, table.T, strict=True))
    for target in ("ch1_um", "ch3_um", "ch5_um"):
        for inputs in (("t1_C",), ("t5_C",), ("t9_C",), ("t1_C", "t9_C"), ("spindle_rpm",)):
            u = np.array([column[name] - column[name][0] for name in inputs])
            held = inputs == ("spindle_rpm",)
            _measured("cnc_spindle", target, inputs, u, column[target], 15.0, held, 0.6)
    network.spindle(column, 15.0)
    network.heating(DATA / "daisy/heating_system.csv")


def _measured(
    log: str, target: str, inputs: tuple[str, ...], u: Array, y: Array, dt: float, held: bool,
    share: float,
) -> None:  # fmt: skip
    hold: Hold = "zero" if held else "first"
    record = sampled(inputs, u, (target,), y, dt)
    data = TrainingData((record,), inputs, (target,), dt, (hold,) * len(inputs))
    training, rest = data.split(share)
    training = OeStructure().start(training)
    for real in (False, True):
        structure = OeStructure(real_poles=real)
        orders = (c.model.orders for c in choose(training, structure))
        model = first_that_fits(orders, partial(structure.fit, training))
        o, poles = model.orders, "real" if real else "any"
        orders_text = f"{o.nb[0]},{o.nf[0]},{'/'.join(map(str, o.nk))}"
        fits = model.fit(training).fit_percent, model.fit(rest).fit_percent
        print(f"| {log} | {target} | {', '.join(inputs)} | {poles} | {orders_text} | "
              f"{fits[0]:.1f} | {fits[1]:.1f} |", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["speed", "coverage", "measured"])
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--systems", type=int, default=24)
    parser.add_argument("--long", action="store_true")
    parser.add_argument("--repeats", type=int, default=500)
    chosen = parser.parse_args()
    print(f"## Transfer functions: {chosen.what} (seed {chosen.seed})\n")
    if chosen.what == "speed":
        speed(chosen.seed, chosen.systems, chosen.long)
        print("\nThree modes shared by two outputs:\n")
        network.speed(chosen.seed)
    elif chosen.what == "coverage":
        coverage(chosen.seed, chosen.repeats)
        print("\nThree modes shared by two outputs whose errors are correlated (0.6):\n")
        network.coverage(chosen.seed, chosen.repeats)
    else:
        measured()


if __name__ == "__main__":
    main()
