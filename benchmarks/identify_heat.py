"""Oscillations that ``identify`` finds in bodies that conduct heat, where none are.

    python benchmarks/identify_heat.py [--logs 100] [--seed SEED]

Bodies of 8 to 19 nodes in a row with a few bridges, one to three heaters that switch, one to three
temperatures or displacements; 400 or 1000 rows, noise of 0.5 to 10 % in three colours, in three of
ten records a drift. The plant is an exponential of a matrix and shares no code with the tool. The
first 60 % are fitted with nothing given but the names of the channels, and the run, carried on, is
held against the outputs without noise. Seeds are drawn fresh; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import secrets
import time

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from identify_cases import fit_percent
from scipy.linalg import expm
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.errors import ThermalToolError
from thermaltool.record import Record

SHAPES, ROWS, NOISES, COLOURS = ((3, 1), (1, 3), (2, 2), (2, 3)), (400, 1000), (0.005, 0.02, 0.1), (
    0.0, 0.8, 0.97)  # fmt: skip
FITTED_SHARE, DRIFTING = 0.6, 0.3


def body(rng: np.random.Generator, heaters: int):
    """Matrices of the temperatures of a body, by a row."""
    n = int(rng.integers(8, 20))
    mass = rng.uniform(0.5, 2, n) * np.exp(rng.uniform(2, 4.5))
    links = [(k, k + 1, rng.uniform(0.3, 1.5)) for k in range(n - 1)]
    links += [(*rng.choice(n, 2, replace=False), rng.uniform(0.05, 0.5)) for _ in range(n // 3)]
    A = -np.diag(rng.uniform(0, 0.08, n))
    for i, j, conductance in links:
        A[[i, j], [i, j]] -= conductance
        A[[i, j], [j, i]] += conductance
    B = np.zeros((n, heaters))
    B[rng.choice(n, heaters, replace=False), range(heaters)] = 1
    whole = np.zeros((n + heaters, n + heaters))
    whole[:n, :n], whole[:n, n:] = A / mass[:, None], B / mass[:, None]
    stepped = expm(whole)
    return stepped[:n, :n], stepped[:n, n:]


def log(rng: np.random.Generator, heaters: int, outputs: int):
    """Inputs, outputs, outputs without noise, and the names of both."""
    rows = int(rng.choice(ROWS))
    F, G = body(rng, heaters)
    u, x = np.zeros((heaters, rows)), np.zeros((rows, len(F)))
    for row in u:
        at = 20
        while at < rows:
            held = int(rng.integers(rows // 40 + 2, rows // 8))
            row[at : at + held] = rng.choice([0, 20, 50, 100])
            at += held
    for k in range(rows - 1):
        x[k + 1] = F @ x[k] + G @ u[:, k]
    bends = rng.random() < 0.5
    C = rng.standard_normal((outputs, len(F)))
    if not bends:
        C = np.eye(len(F))[rng.choice(len(F), outputs, replace=False)]
    clean, noise, colour = C @ x.T, rng.choice(NOISES), rng.choice(COLOURS)
    size = noise * clean.std(axis=1, keepdims=True)
    y = clean + size * lfilter([np.sqrt(1 - colour**2)], [1, -colour],
                               rng.standard_normal(clean.shape), axis=1)  # fmt: skip
    if rng.random() < DRIFTING:
        y += 2 * size * np.cumsum(rng.standard_normal(clean.shape), axis=1) / np.sqrt(rows)
    names = [f"d_{k}_um" if bends else f"dT_{k}_K" for k in range(outputs)]
    return u, y, clean, [f"Q_{k}_W" for k in range(heaters)], names


def swings(model) -> bool:
    """Whether a model of `identify` has a pair."""
    pairs = any(section.is_pair for section in getattr(model, "sections", ()))
    roots = [np.roots(f) for f in getattr(model, "F", ()) if len(f) > 1]
    return pairs or any(np.any(np.abs(z.imag) > 1e-9 * np.abs(z)) for z in roots)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=secrets.randbits(31))
    given = parser.parse_args()
    print(f"seed {given.seed}\n\n| log | heaters, outputs | pairs | fit, carried on % | CPU s |")
    print("|---|---|---|---|---|")
    found = []
    for k in range(given.logs):
        shape = SHAPES[k % len(SHAPES)]
        u, y, clean, ins, outs = log(np.random.default_rng([given.seed, k]), *shape)
        rows = round(FITTED_SHARE * u.shape[1])
        begun, clock = time.process_time(), np.arange(float(u.shape[1]))
        columns = dict(zip([*ins, *outs], [*u, *y], strict=True))
        whole = Record(clock, columns)
        try:
            fits = tt.identify(whole.rows(slice(0, rows)), ins, outs, warn=lambda said: None).fits
        except ThermalToolError as error:
            print(f"| {k} | {shape} | {error} | | |")
            continue
        seconds = time.process_time() - begun
        unread = {name: np.where(np.arange(len(clock)) < rows, columns[name], np.nan)
                  for name in outs}  # fmt: skip
        going_on = Record(clock, columns | unread, at_rest=fits[0].data.records[0].at_rest)
        runs = [np.ravel(fit.model.simulate(going_on))[rows:] for fit in fits]
        fit = np.mean([fit_percent(y, run) for y, run in zip(clean[:, rows:], runs, strict=True)])
        found.append((any(swings(each.model) for each in fits), fit, seconds))
        print(f"| {k} | {shape} | {found[-1][0]} | {fit:.2f} | {seconds:.1f} |", flush=True)
    pairs, fit, seconds = np.array(found, float).T
    print(f"\npairs in {pairs.sum():.0f} of {len(pairs)}; median fit {np.median(fit):.1f} %; "
          f"geometric mean of 100 % less the fit {np.exp(np.mean(np.log(100 - fit))):.1f}; "
          f"{seconds.sum():.0f} s of CPU time")  # fmt: skip


if __name__ == "__main__":
    main()
