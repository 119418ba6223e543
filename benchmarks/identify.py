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
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import network
import numpy as np
from identify_cases import NOISE, driven, response, sampled, system
from identify_speed import speed
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.transfer.oe import OeStructure

DATA = Path(__file__).parents[2] / "shared" / "data"
MAPS = Path(__file__).parents[1] / "data_samples" / "maps"
STRUCTURES: dict[str, dict[str, Any]] = {
    "oe": {"real_poles": False},
    "oe, real poles": {"real_poles": True},
    "network": {"structure": "network"},
    "subspace": {"structure": "subspace"},
}


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
    """Measured logs: fitted to the first part, run on over the rest, and the same by `simulate`."""
    if not DATA.exists():
        print(f"left out, there is no {DATA} here (measured logs are not copied into the project)")
        return
    print(
        "| log | structure | inputs | output | orders | training % | validation % "
        "| by simulate % | state estimated % |\n|---|---|---|---|---|---|---|---|---|"
    )
    probes = ["d_ch1_um", "d_ch3_um", "d_ch5_um"]
    _measured("daisy/hairdryer_ljung.csv", "hairdryer", [["U_heater_V"]], ["U_air_V"], 0.5)
    _measured("daisy/heating_system.csv", "heating_system", [["U_lamp_V"]], ["T_plate_degC"], 0.5)
    chosen = [["T_t1_degC"], ["T_t5_degC"], ["T_t9_degC"], ["T_t1_degC", "T_t9_degC"],
              ["n_spindle_rpm"]]  # fmt: skip
    _measured("cnc_spindle/spindle_first_28h.csv", "cnc_spindle", chosen, probes, 0.6)
    network.heating(DATA / "daisy/heating_system.csv")


def _measured(
    log: str, names: str, inputs: Sequence[list[str]], outputs: list[str], share: float
) -> None:
    path, columns = DATA / log, MAPS / f"{names}.toml"
    for some in inputs:
        for title, options in STRUCTURES.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    found = tt.identify(
                        path, some, outputs, split=share, columns=columns, **options
                    )
                except ValueError as error:
                    print(f"| {names} | {title} | {', '.join(some)} | | {error} | | | | |")
                    continue
                for fit in found.fits:
                    print(_row(names, title, some, fit, found, path, columns), flush=True)


def _row(
    log: str, title: str, inputs: list[str], fit: Fit, found: tt.Identification, path: Path,
    columns: Path,
) -> str:  # fmt: skip
    held = fit.validation
    assert held is not None
    try:
        first = held.logs[0]
        run = tt.simulate(
            found.model, path, columns=columns, initial=first.initial, start=first.start
        )
        simulated = f"{run.agreements[fit.model.target].fit_percent:.1f}"
    except ValueError:
        simulated = "no model file"
    orders = getattr(fit.model, "orders", None)
    text = fit.model.order if orders is None else f"{orders.nb[0]},{orders.nf[0]},{orders.nk[0]}"
    return (
        f"| {log} | {title} | {', '.join(inputs)} | {fit.model.target} | {text} | "
        f"{fit.training.fit_percent:.1f} | {held.carried_on.fit_percent:.1f} | {simulated} | "
        f"{held.estimated_state.fit_percent:.1f} |"
    )


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
