"""What a user would pick instead of `diagnose`, on the same logs: held-out error, and what it says.

    python benchmarks/peers.py [--data FOLDER] [--size 5] [--seed N] [--json FILE]

Every method sees the same training log and predicts the held-out rows from the measured drives and
extra channels alone (free run: no past outputs). Measured logs are left out where their folder is
absent. Settings of the peers are chosen by cross-validation over blocks of the training log.

Needs scikit-learn and pysindy (dependency group ``bench``).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers_cases import Case, gantry, heating_system, hidden
from peers_methods import (
    Answer,
    black_box,
    boosters,
    fit_plain,
    forests,
    ours,
    recalibrated,
    residual_tests,
    ridges,
    sparse_regression,
)

from thermaltool.documents import jsonable
from thermaltool.model import Model
from thermaltool.units import parse_channel

HIDDEN = ("drive_nonlinearity", "second_source", "convection_state", "transport_delay")


def rms(case: Case, answer: Answer) -> dict[str, float]:
    """Held-out RMS of every output; of a displacement, which has no zero, about its mean."""
    result = {}
    for k, name in enumerate(case.outputs):
        error = (case.level(case.held_out, name) - answer.predicted[:, k])[case.begin :]
        if parse_channel(name).dimension in ("length", "angle"):
            error = error - error.mean()
        result[name] = float(np.sqrt(np.mean(error**2)))
    return result


def compare(case: Case, seed: int) -> list[dict[str, Any]]:
    """Every method on one case: what the table and the JSON hold."""
    plain = fit_plain(case, [case.calibration])
    methods: dict[str, Callable[[Case, Model], Answer]] = {
        "model, residual tests": residual_tests,
        "model, calibrated again": recalibrated,
        "linear regression on lags": partial(black_box, choices=ridges(), seed=seed),
        "random forest on lags": partial(black_box, choices=forests(seed), seed=seed),
        "boosting on lags": partial(black_box, choices=boosters(seed), seed=seed),
        "model + boosting on lags": partial(
            black_box, choices=boosters(seed), seed=seed, on_model=True
        ),
        "sparse regression": sparse_regression,
        "thermaltool diagnose": ours,
    }
    if case.calibration is case.training:
        del methods["model, calibrated again"]
    rows: list[dict[str, Any]] = []
    for name, method in methods.items():
        begin = time.perf_counter()
        answer = method(case, plain)
        seconds = time.perf_counter() - begin
        found = rms(case, answer)
        reference = rows[0]["rms"] if rows else found
        row = {
            "case": case.name,
            "cause": case.cause,
            "method": name,
            "rms": found,
            # Geometric mean over the outputs.
            "over_plain": float(np.exp(np.mean([np.log(found[o] / reference[o]) for o in found]))),
            "says": answer.says,
            "named": answer.named,
            "seconds": round(seconds, 2),
        }
        rows.append(row)
        print(f"{case.name}, {name}: {seconds:.1f} s", file=sys.stderr, flush=True)
    return rows


def told(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "diverged"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="measured logs")
    parser.add_argument("--size", type=float, default=5.0, help="of hidden effects, over noise")
    parser.add_argument("--seed", type=int, help="of machines, effects, forests; drawn if absent")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every output's figures")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with TEXT in their name")
    options = parser.parse_args()
    seed = options.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}", file=sys.stderr)
    makers: dict[str, Callable[[], Case]] = {
        f"hidden {effect}": partial(hidden, effect, options.size, seed + k)
        for k, effect in enumerate(HIDDEN)
    }
    if options.data.is_dir():
        measured = {f.__name__: partial(f, options.data) for f in (gantry, heating_system)}
        makers = {**measured, **makers}
    else:
        print(f"measured logs: left out, there is no {options.data}", file=sys.stderr)
    rows: list[dict[str, Any]] = []
    print("| log | known cause | method | held-out RMS | over the plain model | says | names |")
    print("|---" * 7 + "|")
    for name, make in makers.items():
        if options.only not in name:
            continue
        for row in compare(make(), seed):
            rows.append(row)
            figures = ", ".join(f"{o} {told(v, '.3g')}" for o, v in row["rms"].items())
            cells = [row["case"], row["cause"], row["method"], figures]
            cells += [told(row["over_plain"], ".2f"), row["says"], ", ".join(row["named"]) or "–"]
            print(f"| {' | '.join(cells)} |", flush=True)
    if options.json:
        document = {"seed": seed, "rows": jsonable(rows)}
        options.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
