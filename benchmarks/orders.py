"""Order selection beside the full grid of exact fits, and beside the peers: Markdown tables.

``python benchmarks/orders.py speed`` (make bench), ``study`` (make study). Seeds are drawn fresh
and printed; --seed repeats a run.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
import warnings
from collections.abc import Callable

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.criteria import CRITERIA, OrderCriteria
from thermaltool.timeseries.hannan import gram_matrix
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import climb, start
from thermaltool.timeseries.order import select_order
from thermaltool.timeseries.runs import even_record

Array = NDArray[np.float64]
Pair = tuple[int, int]

REPEATS = 5
# The orders that the issue names: Gao's identified bar, an ARMA(3,2) and an AR(3).
PROCESSES: dict[Pair, tuple[list[float], list[float]]] = {
    (2, 1): ([0.7575, -0.6874], [-0.2743]),
    (3, 2): ([0.3, -0.4, 0.7], [0.9, 0.8]),
    (3, 0): ([0.6, -0.3, 0.4], []),
}
MORE: dict[Pair, tuple[list[float], list[float]]] = {
    (1, 1): ([0.9], [-0.5]),
    (0, 1): ([], [0.8]),
    (2, 2): ([1.8, -0.9], [-0.5, 0.3]),
}
# Sizes at which the peers run, and how often: the longest takes them minutes.
PEERS = {1_000: REPEATS, 10_000: REPEATS, 100_000: 1}
LIMITS = {1_000: 0.1, 10_000: 0.3, 100_000: 3.0, 1_000_000: 30.0}


def simulated(process: tuple[list[float], list[float]], size: int, seed: list[int]) -> Array:
    ar, ma = map(np.array, process)
    noise = np.random.default_rng(seed).standard_normal(size + 500)
    return np.asarray(lfilter(np.r_[1.0, ma], np.r_[1.0, -ar], noise)[500:])


def full_grid(x: Array, max_p: int, max_q: int) -> list[OrderCriteria]:
    """Every order by exact maximum likelihood, each from its own regression."""
    likelihood = ArmaLikelihood(even_record(x), 0)
    gram = gram_matrix(likelihood.detrended, max_p, max_q)
    entries = []
    for p in range(max_p + 1):
        for q in range(max_q + 1):
            fit, _ = climb(likelihood, start(likelihood, *gram.solve(p, q)[:2]), 100, 1e-2)
            entries.append(OrderCriteria(p, q, fit.deviance, fit.at.sigma2, x.size, 1, True))
    return entries


def median_time(action: Callable[[], object], repeats: int = REPEATS) -> float:
    """CPU time of the one thread [s]."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return float(np.median(times))


def speed(seed: int) -> None:
    """The 11 × 11 grid and AR orders to 100, beside what peers there are."""
    print("| samples | 11 × 11 grid [s] | asked below | peak memory [MB] |\n|---|---|---|---|")
    for size, limit in LIMITS.items():
        x = simulated(PROCESSES[2, 1], size, [seed, size])
        took = median_time(lambda x=x: select_order(even_record(x)))  # type: ignore[misc]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"| {size} | {took:.3f} | {limit:g} | {memory:.0f} |", flush=True)
    x = simulated(PROCESSES[2, 1], 100_000, [seed])
    took = median_time(lambda: burg(even_record(x - x.mean()), 100))
    print(f"\nAR orders 0 to 100 of 100 000 samples: {1e3 * took:.1f} ms (asked below 50)\n")
    print("| peer, stepwise to (10, 10) | samples | [s] | its AIC above ours |\n|---|---|---|---|")
    for name, peer in (("statsforecast", statsforecast), ("pmdarima", pmdarima)):
        for size, repeats in PEERS.items():
            x = simulated(PROCESSES[2, 1], size, [seed, size])
            ours = select_order(even_record(x)).best("aic").criteria.aic
            found: list[float] = []
            try:
                took = median_time(lambda p=peer, x=x, f=found: f.append(p(x)), repeats)  # type: ignore[misc]
            except ImportError:
                print(f"| {name} | not installed here | | |")
                break
            print(f"| {name} | {size} | {took:.2f} | {found[-1] - ours:.2f} |", flush=True)


def statsforecast(x: Array) -> float:
    warnings.simplefilter("ignore")
    from statsforecast.arima import auto_arima_f

    fit = auto_arima_f(x, d=0, max_p=10, max_q=10, max_order=20, seasonal=False, ic="aic")
    return float(fit["aic"])


def pmdarima(x: Array) -> float:
    warnings.simplefilter("ignore")
    from pmdarima import auto_arima

    fit = auto_arima(x, d=0, max_p=10, max_q=10, max_order=20, seasonal=False,
                     information_criterion="aic", suppress_warnings=True)  # fmt: skip
    return float(fit.aic())


def study(seed: int, replications: int, sizes: list[int]) -> None:
    """How often BIC finds the order, and the best AIC beside the full grid's."""
    print(f"{replications} replications of 400 samples, orders to (5, 5), by BIC\n")
    print("| process | found | found by the full exact grid | BIC higher than the grid's by 0.1 |")
    print("|---|---|---|---|")
    for order, process in PROCESSES.items():
        ours = judged = worse = 0
        for k in range(replications):
            x = simulated(process, 400, [seed, k, *order])
            best = select_order(even_record(x), 5, 5, criteria=("bic",)).best("bic")
            judge = min(full_grid(x, 5, 5), key=CRITERIA["bic"])
            ours += (best.p, best.q) == order
            judged += (judge.p, judge.q) == order
            worse += best.criteria.bic > judge.bic + 0.1
        print(f"| ARMA{order} | {ours} | {judged} | {worse} |", flush=True)
    for size in sizes:
        print(f"\nBest exact AIC of {size} samples above the best of the full 11 × 11 grid\n")
        print("| process | seed | grid | here | above |\n|---|---|---|---|---|")
        near = 0
        cases = [(o, p, k) for k in range(4) for o, p in {**PROCESSES, **MORE}.items()]
        for order, process, k in cases:
            x = simulated(process, size, [seed, k, size, *order])
            judge = min(full_grid(x, 10, 10), key=CRITERIA["aic"])
            best = select_order(even_record(x)).best("aic")
            above = best.criteria.aic - judge.aic
            near += above <= 1.0
            print(f"| ARMA{order} | {k} | {judge.p},{judge.q} | {best.p},{best.q} | {above:.2f} |",
                  flush=True)  # fmt: skip
        print(f"\nwithin 1: {near} of {len(cases)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["speed", "study"])
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--replications", type=int, default=2000)
    parser.add_argument("--sizes", type=int, nargs="*", default=[1_000, 10_000])
    options = parser.parse_args()
    seed = (
        options.seed if options.seed is not None else int(np.random.SeedSequence().entropy % 2**32)
    )  # type: ignore[operator]
    print(f"seed {seed}\n", file=sys.stdout, flush=True)
    if options.what == "speed":
        speed(seed)
    else:
        study(seed, options.replications, options.sizes)


if __name__ == "__main__":
    main()
