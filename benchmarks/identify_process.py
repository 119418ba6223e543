"""``identify`` on processes of several inputs and outputs, beside open peers.

``python benchmarks/identify_process.py`` (in make bench), ``coverage`` (in make study). The first
60 % of each record are fitted with nothing given but the names of the channels; the free run goes
on from the state at their end over the other 40 %, and is held against the outputs without noise.
Peers get every order (SIPPY's N4SID and CVA and nfoursid up to twelve, SysIdentPy and ARX up to
eight), about the mean and about the first rows, and of these the one that is best on the held-out
rows themselves, which no user knows; the state at the start and the offset of the subspace methods
are found by least squares, and the others run freely from the first readings. Seeds are drawn fresh
and printed; --seed repeats a run, --only names a process.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import itertools
import os
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from identify_cases import fit_percent, sampled
from process_plants import PLANTS, Array, Run
from scipy.signal import lfilter, lfiltic

import thermaltool as tt
from thermaltool.fitting.data import even_training_data
from thermaltool.fitting.identification import Plan, identify
from thermaltool.fitting.network.plan import NetworkPlan
from thermaltool.fitting.subspace.identify import identify_subspace
from thermaltool.fitting.subspace.plan import SubspacePlan
from thermaltool.fitting.transfer.plan import TransferPlan
from thermaltool.fitting.transfer.registry import structure_of
from thermaltool.record import Record

FITTED_SHARE, MAX_ORDER = 0.6, 12
# Rows at the start that stand still, in every plant but one.
IDLE = 5
# What a peer may take for all of its orders [s].
PEER_LIMIT_S = 240.0
# Lags of the equation-error peers at most.
MAX_LAGS = 8
# Their packages; and how many inputs `identify` takes for many (no transfer function for each).
PACKAGES, MANY_INPUTS = ("sippy_unipi", "nfoursid", "sysidentpy"), 6


def record(run: Run, rows: int) -> Record:
    """The log, outputs missing beyond `rows`."""
    y = run.y.copy()
    y[:, rows:] = np.nan
    ins, outs = names(run)
    return sampled(ins, run.u, outs, y, run.period)


def names(run: Run) -> tuple[list[str], list[str]]:
    drive, output = ("Q_{}_W", "dT_{}_K") if run.heat else ("U_{}_V", "d_{}_mm")
    ins, outs = range(len(run.u)), range(len(run.y))
    return [drive.format(k) for k in ins], [output.format(k) for k in outs]


def held_fits(run: Run, computed: Array, rows: int) -> list[float]:
    """Fit of every output without noise over the rows held out [%]."""
    pairs = zip(run.clean[:, rows:], computed[:, rows:], strict=True)
    return [fit_percent(clean, own) for clean, own in pairs]


def ours(run: Run, plan: Plan | None) -> tuple[float, list[float], str]:
    """With a plan, or with nothing but the names of the channels."""
    rows, (ins, outs) = round(FITTED_SHARE * run.y.shape[1]), names(run)
    whole = record(run, rows)
    fitted = whole.rows(slice(0, rows))
    begun = time.perf_counter()
    if plan is None:
        fits = tt.identify(fitted, ins, outs, warn=lambda message: None).fits
    else:
        fits = identify([fitted], ins, outs, plan)
    seconds = time.perf_counter() - begun
    models = [fit.model for fit in fits]
    at_rest = fits[0].data.records[0].at_rest
    going_on = Record(whole.time, whole.columns, at_rest=at_rest)
    computed = np.array([fit.model.simulate(going_on) for fit in fits])
    orders = ", ".join(str(n) for n in dict.fromkeys(model.order for model in models))
    kind = f"{models[0].method}, " if plan is None else ""
    found = f"{kind}order {orders}" + " with feedthrough" * getattr(models[0], "has_direct", False)
    return seconds, held_fits(run, computed, rows), found


Found = tuple[float, list[float], str]
# Takes inputs, fitted outputs, order, whether with feedthrough, period; gives the whole free run.
Peer = Callable[[Array, Array, int, bool, float], Array]


def sippy(method: str, u: Array, y: Array, order: int, direct: bool, period: float) -> Array:
    from sippy_unipi import system_identification

    found = system_identification(
        y, u[:, : y.shape[1]], method, SS_fixed_order=order,
        SS_f=20, SS_p=20, SS_D_required=direct, tsample=period,
    )  # fmt: skip
    return _state_space([getattr(found, name) for name in "ABCD"], u, y)


def nfoursid(u: Array, y: Array, order: int, direct: bool, period: float) -> Array:
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    ins, outs = [f"u{k}" for k in range(len(u))], [f"y{k}" for k in range(len(y))]
    frame = pd.DataFrame(np.vstack([u[:, : y.shape[1]], y]).T, columns=[*ins, *outs])
    method = NFourSID(frame, output_columns=outs, input_columns=ins, num_block_rows=12)
    method.subspace_identification()
    found, _ = method.system_identification(rank=order)
    return _state_space([found.a, found.b, found.c, found.d], u, y)


def sysidentpy(u: Array, y: Array, order: int, direct: bool, period: float) -> Array:
    """A linear NARX for each output, terms chosen by FROLS and its information criterion."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    lags = list(range(1, order + 1))
    runs = []
    for own in y:
        found = FROLS(order_selection=True, n_info_values=min(40, order * (len(u) + 1)), ylag=lags,
                      xlag=[lags] * len(u) if len(u) > 1 else lags, info_criteria="bic",
                      estimator=LeastSquares(), basis_function=Polynomial(degree=1))  # fmt: skip
        found.fit(X=u[:, : len(own)].T, y=own[:, None])
        runs.append(np.ravel(found.predict(X=u.T, y=own[: found.max_lag, None])))
    return np.array(runs)


def plain_arx(u: Array, y: Array, order: int, direct: bool, period: float) -> Array:
    """Least squares for each output, run freely from its first readings."""
    runs, first = [], 0 if direct else 1
    for own in y:
        n = len(own)
        past = [np.roll(own, j) for j in range(1, order + 1)]
        past += [np.roll(row[:n], j) for row in u for j in range(first, order + 1)]
        X = np.vstack([*past, np.ones(n)])[:, order:]
        theta = np.linalg.lstsq(X.T, own[order:], rcond=None)[0]
        a, b = theta[:order], theta[order:-1].reshape(len(u), -1)
        driven = np.full(u.shape[1], theta[-1])
        for row, weights in zip(u, b, strict=True):
            for j, weight in enumerate(weights, start=first):
                driven += weight * np.concatenate([np.full(j, row[0]), row[: len(row) - j]])
        denominator = np.concatenate([[1.0], -a])
        if np.any(np.abs(np.roots(denominator)) >= 1):
            raise ValueError("not stable")
        start = lfiltic([1.0], denominator, own[:order][::-1])
        free = lfilter([1.0], denominator, driven[order:], zi=start)[0]
        runs.append(np.concatenate([own[:order], free]))
    return np.array(runs)


PEERS: dict[str, tuple[Peer, int]] = {
    "SIPPY N4SID": (partial(sippy, "N4SID"), MAX_ORDER),
    "SIPPY CVA": (partial(sippy, "CVA"), MAX_ORDER),
    "nfoursid": (nfoursid, MAX_ORDER),
    "SysIdentPy": (sysidentpy, MAX_LAGS),
    "ARX, simulated": (plain_arx, MAX_LAGS),
}


def best_of(run: Run, peer: Peer, orders: int, limit: float) -> Found:
    """Seconds of the best order; its fits; and which it is."""
    rows = round(FITTED_SHARE * run.y.shape[1])
    best, begun = (np.nan, [-np.inf] * len(run.y), "no stable model"), time.perf_counter()
    for order, about in itertools.product(range(1, orders + 1), (rows, IDLE)):
        if time.perf_counter() - begun > limit:
            break
        centre, level = run.y[:, :about].mean(axis=1), run.u[:, :about].mean(axis=1)
        y, u = run.y - centre[:, None], run.u - level[:, None]
        started = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Whatever a peer refuses is no candidate; a missing one is told by the caller.
            with contextlib.suppress(Exception):
                computed = peer(u, y[:, :rows], order, run.direct, run.period)
                seconds = time.perf_counter() - started
                fits = held_fits(run, computed + centre[:, None], rows)
                if np.mean(fits) > np.mean(best[1]):
                    best = seconds, fits, f"order {order}"
    return best


def _state_space(matrices: Sequence[object], u: Array, y: Array) -> Array:
    """Free run over all inputs from the state that fits the outputs best."""
    A, B, C, D = (np.asarray(each, float) for each in matrices)
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


def processes(seed: int, repeats: int, only: str, limit: float, structures: bool) -> None:
    missing = [package for package in PACKAGES if importlib.util.find_spec(package) is None]
    if missing:
        print(f"no peers: {', '.join(missing)} not installed\n")
    print("| process | program | found | time s | held-out fit of each output % |")
    print("|---|---|---|---|---|")
    for name, plant in PLANTS.items():
        if only not in name:
            continue
        for k in range(repeats):
            run = plant(np.random.default_rng([seed, k]))
            plans: dict[str, Plan | None] = {"defaults": None}
            if structures:
                plans |= {"subspace": SubspacePlan(), "network": NetworkPlan()}
            if structures and len(run.u) < MANY_INPUTS:
                plans["oe"] = TransferPlan(structure=structure_of("oe"))
            programs: dict[str, Callable[[], Found]] = {
                each: partial(ours, run, plan) for each, plan in plans.items()
            }
            if not missing:
                programs |= {each: partial(best_of, run, *peer, limit)
                             for each, peer in PEERS.items()}  # fmt: skip
            for program, fitted in programs.items():
                seconds, fits, found = fitted()
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
    parser.add_argument("--only", default="", help="part of the name of a process")
    parser.add_argument("--structures", action="store_true", help="each by its name, too: minutes")
    parser.add_argument("--limit", type=float, default=PEER_LIMIT_S, help="seconds for a peer")
    given = parser.parse_args()
    print(f"seed {given.seed}\n")
    if given.what == "processes":
        processes(given.seed, given.repeat or 1, given.only, given.limit, given.structures)
    else:
        coverage(given.seed, given.repeat or 500)


if __name__ == "__main__":
    main()
