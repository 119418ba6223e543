"""``identify --structure subspace`` on processes of several inputs and outputs, beside SIPPY.

``python benchmarks/identify_process.py`` (in make bench), ``coverage`` (in make study). The first
60 % of each record are fitted, with nothing given; the free run goes on from the state at their end
over the other 40 %, and is held against the outputs without noise. SIPPY gets every order up to
twelve, about the mean and about the first rows, and of these the one that is best on the held-out
rows themselves, which no user knows; its state at the start and its offset are found by least
squares. Seeds are drawn fresh and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import os
import time
import warnings

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from identify_cases import fit_percent, sampled
from process_plants import PLANTS, Array, Run
from scipy.signal import lfilter

from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.identification import Plan, identify
from thermaltool.fitting.network.plan import NetworkPlan
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.record import Record

FITTED_SHARE, MAX_ORDER = 0.6, 12
# Rows at the start that stand still, in every plant but one.
IDLE = 5
# What a peer may take for all of its orders [s].
PEER_LIMIT_S = 240


def record(run: Run, rows: int) -> Record:
    """The log, outputs missing beyond `rows`."""
    y = run.y.copy()
    y[:, rows:] = np.nan
    ins, outs = names(run)
    return sampled(ins, run.u, outs, y, run.period)


def names(run: Run) -> tuple[list[str], list[str]]:
    return [f"Q_{k}_W" for k in range(len(run.u))], [f"dT_{k}_K" for k in range(len(run.y))]


def held_fits(run: Run, computed: Array, rows: int) -> list[float]:
    """Fit of every output without noise over the rows held out [%]."""
    pairs = zip(run.clean[:, rows:], computed[:, rows:], strict=True)
    return [fit_percent(clean, own) for clean, own in pairs]


def ours(run: Run, plan: Plan) -> tuple[float, list[float], str]:
    rows, (ins, outs) = round(FITTED_SHARE * run.y.shape[1]), names(run)
    whole = record(run, rows)
    begun = time.perf_counter()
    fits = identify([whole.rows(slice(0, rows))], ins, outs, plan)
    seconds = time.perf_counter() - begun
    model = fits[0].model
    at_rest = fits[0].data.records[0].at_rest
    going_on = Record(whole.time, whole.columns, at_rest=at_rest)
    computed = np.array([fit.model.simulate(going_on) for fit in fits])
    found = f"order {model.order}" + " with feedthrough" * getattr(model, "has_direct", False)
    return seconds, held_fits(run, computed, rows), found


def sippy(run: Run, method: str) -> tuple[float, list[float], str]:
    """Seconds of the best order; its fits; and which it is."""
    from sippy_unipi import system_identification

    rows = round(FITTED_SHARE * run.y.shape[1])
    best, begun = (np.nan, [-np.inf] * len(run.y), "no stable model"), time.perf_counter()
    for order, about in itertools.product(range(1, MAX_ORDER + 1), (rows, IDLE)):
        if time.perf_counter() - begun > PEER_LIMIT_S:
            break
        centre, level = run.y[:, :about].mean(axis=1), run.u[:, :about].mean(axis=1)
        y, u = run.y - centre[:, None], run.u - level[:, None]
        started = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(Exception):
                found = system_identification(
                    y[:, :rows], u[:, :rows], method, SS_fixed_order=order,
                    SS_f=20, SS_p=20, SS_D_required=run.direct, tsample=run.period,
                )  # fmt: skip
                seconds = time.perf_counter() - started
                computed = _state_space(found, u, y[:, :rows]) + centre[:, None]
                fits = held_fits(run, computed, rows)
                if np.mean(fits) > np.mean(best[1]):
                    best = seconds, fits, f"order {order}"
    return best


def _state_space(model: object, u: Array, y: Array) -> Array:
    """Free run over all inputs from the state that fits the outputs best."""
    A, B, C, D = (np.asarray(getattr(model, name), float) for name in "ABCD")
    n, rows = len(A), u.shape[1]
    x, own, free = np.zeros(n), np.empty((len(C), rows)), np.empty((rows, len(C), n))
    power = np.eye(n)
    for k in range(rows):
        own[:, k], x = C @ x + D @ u[:, k], A @ x + B @ u[:, k]
        free[k], power = C @ power, A @ power
    seen = y.shape[1]
    offsets = np.broadcast_to(np.eye(len(C)), (rows, len(C), len(C)))
    free = np.concatenate([free, offsets], axis=2)
    columns = free[:seen].reshape(-1, free.shape[2])
    found = np.linalg.lstsq(columns, (y - own[:, :seen]).T.ravel(), rcond=None)[0]
    return own + (free @ found).T


def processes(seed: int, repeats: int) -> None:
    print("| process | program | found | time s | held-out fit of each output % |")
    print("|---|---|---|---|---|")
    for name, plant in PLANTS.items():
        for k in range(repeats):
            run = plant(np.random.default_rng([seed, k]))
            rows = [("subspace", ours(run, SubspacePlan())), ("network", ours(run, NetworkPlan()))]
            with contextlib.suppress(ImportError):
                rows += [(f"SIPPY {m}", sippy(run, m)) for m in ("N4SID", "CVA")]
            for program, (seconds, fits, found) in rows:
                each = " ".join(f"{fit:.2f}" for fit in fits)
                print(f"| {name} | {program} | {found} | {seconds:.2f} | {each} |", flush=True)


def coverage(seed: int, repeats: int) -> None:
    """Share of 95 % intervals of time constants and gains that hold the truth."""
    print("| noise | start | parameter | covered % | bias / standard error |")
    print("|---|---|---|---|---|")
    A = np.array([[-0.2, 0, 0, 0], [0, -0.01, 0.06, 0], [0, -0.06, -0.01, 0], [0, 0, 0, -0.004]])
    taus = np.array([250.0, 100.0, 100.0, 5.0])
    for colour in (0.0, 0.8):
        for free in (False, True):
            found = [_once(np.random.default_rng([seed, k]), A, colour, free)
                     for k in range(repeats)]  # fmt: skip
            truth = np.array([[*taus, *gains] for gains, _ in found])
            each = [[(e.value, e.low, e.high) for e in estimates] for _, estimates in found]
            value, low, high = np.array(each).transpose(2, 0, 1)
            held = 100 * np.mean((low < truth) & (truth < high), axis=0)
            bias = np.mean((value - truth) / ((high - low) / 3.92), axis=0)
            labels = ["tau 250 s", "pair 100 s", "pair 100 s", "tau 5 s"]
            labels += [f"gain {i + 1}{o + 1}" for o in range(2) for i in range(2)]
            for label, share, off in zip(labels, held, bias, strict=True):
                print(f"| {'AR(1) 0.8' if colour else 'white'} | {'free' if free else 'rest'} | "
                      f"{label} | {share:.1f} | {off:.2f} |", flush=True)  # fmt: skip
            print(f"| | | mean | {held.mean():.1f} | |", flush=True)


def _once(rng: np.random.Generator, A: Array, colour: float, free: bool) -> tuple[Array, list]:
    rows, forgotten = 1500, 400 if free else 0
    B, C = np.ones((4, 2)) * -np.diag(A)[:, None], rng.uniform(0.5, 1.5, (2, 4))
    B[1:3] = [[0.06, -0.06], [0.03, 0.06]]
    B[3] *= -1.0
    C *= rng.choice([-1, 1], C.shape)
    u = np.repeat(rng.standard_normal((2, (rows + forgotten) // 25 + 1)), 25, axis=1)
    u = u[:, : rows + forgotten]
    values, vectors = np.linalg.eig(A)
    F = ((vectors * np.exp(values)) @ np.linalg.inv(vectors)).real
    G = np.linalg.solve(A, F - np.eye(4)) @ B
    if not free:
        u[:, :25] = 0.0
    x, y = np.zeros(4), np.empty((2, u.shape[1]))
    for k in range(u.shape[1]):
        y[:, k], x = C @ x, F @ x + G @ u[:, k]
    white = rng.standard_normal((2, u.shape[1] + 200))
    white[1] = 0.6 * white[0] + 0.8 * white[1]
    y += 0.1 * lfilter([np.sqrt(1 - colour**2)], [1, -colour], white, axis=1)[:, 200:]
    run = Run(1.0, u[:, forgotten:], y[:, forgotten:], y[:, forgotten:])
    ins, outs = names(run)
    data = even_training_data([record(run, rows)], ins, outs)
    model = identify_subspace(data if free else data.from_rest(), 4)
    gains = -C @ np.linalg.solve(A, B)
    estimates = [*model.outputs[0].time_constant_estimates()]
    estimates += [output.gain(i) for output in model.outputs for i in range(2)]
    return gains.ravel(), estimates


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("processes", "coverage"), nargs="?", default="processes")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--repeat", type=int)
    given = parser.parse_args()
    print(f"seed {given.seed}\n")
    if given.what == "processes":
        processes(given.seed, given.repeat or 1)
    else:
        coverage(given.seed, given.repeat or 500)


if __name__ == "__main__":
    main()
