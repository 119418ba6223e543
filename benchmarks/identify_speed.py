"""Speed and fit of `identify` beside open peers, on the same records in one run."""

from __future__ import annotations

import multiprocessing
import os
import resource
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from identify_cases import Case, case, fit_percent, sampled
from identify_peers import PEERS, Array, Delays, Peer, Simulation, loaded

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.output_error import Problem
from thermaltool.fitting.transfer.search import at, gauss_newton, search

# Processor time and memory that one fit may take, and how much longer it may wait.
LIMIT_S, LONG_S, LIMIT_BYTES = 30, 300, 12 << 30
PATIENCE = 10
# A free run of less fit than this [%] grows without bound.
DIVERGED = -1000
# Systems on which the peers are run where that takes long, and peers that take long at 10⁵ rows.
FEW = 4
SLOW = ("SIPPY OE", "nfoursid")


def logged(u: Array, y: Array) -> TrainingData:
    names = tuple(f"u{i}" for i in range(len(u)))
    data = TrainingData((sampled(names, u, ("y",), y, 1.0),), names, ("y",), 1.0)
    return OeStructure().start(data)


def ours(u: Array, y: Array, nk: Delays) -> Simulation:
    """As the command does it, orders and delays given; `method` says how it was found."""
    structure = OeStructure()
    model = structure.fit(logged(u, y), structure.orders((2,) * len(u), 2, nk))

    def simulate(fresh: Array) -> Array:
        return model.respond(fresh)

    simulate.method = model.method  # type: ignore[attr-defined]
    return simulate


@dataclass(frozen=True)
class Outcome:
    """What one program made of one case.

    Attributes
    ----------
    seconds : float
        Processor time of the fit.
    fresh, training : float [%]
        Free run on the fresh record, and on the fitted one with its noise.
    mib : float
        Memory peak of the fit, on top of what was there.
    method : str
        How it was found, or why there is nothing.
    """

    seconds: float = np.nan
    fresh: float = np.nan
    training: float = np.nan
    mib: float = np.nan
    method: str = ""


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def fitted(run: Peer, given: Case) -> Outcome:
    before, begun = peak_mib(), time.process_time()
    simulate = run(given.u, given.y, given.nk)
    seconds, mib = time.process_time() - begun, peak_mib() - before
    with np.errstate(all="ignore"):
        fresh = fit_percent(given.answer, simulate(given.fresh))
        training = fit_percent(given.y, simulate(given.u))
    if not fresh > DIVERGED:
        raise ValueError("the model found is not stable")
    return Outcome(seconds, fresh, training, mib, getattr(simulate, "method", ""))


def apart(run: Peer, given: Case, limit_s: float) -> Outcome:
    """In a process of its own, silent, with so much processor time and memory."""
    receiver, sender = multiprocessing.Pipe(duplex=False)

    def work() -> None:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s)))
        warnings.simplefilter("ignore")
        try:
            sender.send(fitted(run, given))
        except ImportError:
            sender.send(Outcome(method="not installed"))
        except (Exception, SystemExit) as error:
            sender.send(Outcome(method=f"{type(error).__name__}: {error}".splitlines()[0][:60]))

    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    sender.close()
    try:
        # The limit is one of processor time; who only waits is ended, too.
        found = receiver.recv() if receiver.poll(PATIENCE * limit_s) else None
    except EOFError:
        found = None
    child.kill()
    child.join()
    return found or Outcome(method=f"nothing within {limit_s:g} s")


def own_sizes(seed: int, systems: int) -> dict[tuple[int, int], list[Outcome]]:
    """Ours on every system and length."""
    print("| rows | inputs | systems | time s, median (worst) | fit %, median (worst) | "
          "memory MiB, worst | found by |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    found = {}
    for rows, inputs in ((10**4, 1), (10**5, 1), (10**6, 1), (10**4, 3)):
        all_of = [apart(ours, case(seed, k, rows, inputs), LIMIT_S) for k in range(systems)]
        found[rows, inputs] = all_of
        all_methods = [each.method for each in all_of]
        methods = ", ".join(f"{all_methods.count(m)} {m}" for m in dict.fromkeys(all_methods))
        seconds, fresh = [o.seconds for o in all_of], [o.fresh for o in all_of]
        print(f"| {rows} | {inputs} | {systems} | {np.median(seconds):.3f} ({max(seconds):.3f}) | "
              f"{np.median(fresh):.2f} ({min(fresh):.2f}) | {max(o.mib for o in all_of):.0f} | "
              f"{methods} |", flush=True)  # fmt: skip
    return found


def beside(
    seed: int, rows: int, inputs: int, systems: int, limit_s: float, names: Sequence[str]
) -> None:
    """Ours and the peers on the same records."""
    print(f"\n{rows} rows, {inputs} input(s), {systems} systems, at most {limit_s:g} s each:\n")
    print(
        "| program | systems | time s, median (worst) | fit %, median (worst) "
        "| memory MiB, worst | squared error over the bound, mean (median) "
        "| better than ours: fresh | fitted record | left out |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    cases = [case(seed, k, rows, inputs) for k in range(systems)]
    bounds = np.array([each.bound for each in cases])
    own = [apart(ours, each, limit_s) for each in cases]
    mine = np.array([[o.fresh, o.training] for o in own])
    best = np.full(mine.shape, -np.inf)
    print(_row("thermaltool", own, mine, bounds), flush=True)
    for name in names:
        found = [apart(PEERS[name], each, limit_s) for each in cases]
        best = np.fmax(best, [[o.fresh, o.training] for o in found])
        print(_row(name, found, mine, bounds), flush=True)
    for gap, where in zip((best - mine).T, ("fresh data", "the fitted record"), strict=True):
        print(
            f"\nBelow the best peer on {where}: {np.sum(gap > 0)} of {systems} systems, by at "
            f"most {max(gap.max(), 0):.3f} points; above it by up to {max(-gap.min(), 0):.3f}."
        )


def _row(name: str, found: list[Outcome], mine: Array, bounds: Array) -> str:
    fits = np.array([[o.fresh, o.training] for o in found])
    done = np.isfinite(fits).all(axis=1)
    left = "; ".join(dict.fromkeys(o.method for o, d in zip(found, done, strict=True) if not d))
    if not done.any():
        return f"| {name} | 0 | – | – | – | – | – | – | {left} |"
    seconds, fresh = np.array([o.seconds for o in found])[done], fits[done, 0]
    ratio = ((100 - fresh) / bounds[done]) ** 2
    ahead = [f"{np.sum(g > 0)}, by {max(g.max(), 0):.3f}" for g in (fits - mine)[done].T]
    mib = np.array([o.mib for o in found])[done].max()
    return (f"| {name} | {np.sum(done)} | {np.median(seconds):.3f} ({max(seconds):.3f}) | "
            f"{np.median(fresh):.2f} ({min(fresh):.2f}) | {mib:.0f} | {np.mean(ratio):.3g} "
            f"({np.median(ratio):.3g}) | {ahead[0]} | {ahead[1]} | {left or '–'} |")  # fmt: skip


def missed(seed: int, rows: int, inputs: int, systems: int) -> None:
    """Whether the search ends where it would from the true system."""
    above = []
    for k in range(systems):
        given = case(seed, k, rows, inputs)
        orders = OeStructure().orders((2,) * inputs, 2, given.nk)
        problem = Problem(logged(given.u, given.y).about_levels(orders.first), orders)
        least = gauss_newton(problem, at(problem, given.F)).loss
        above.append((search(problem).loss / least - 1) * problem.rows)
    far = np.array(above) > 1
    print(
        f"\n{rows} rows, {inputs} input(s): the search ends more than one error variance above "
        f"the minimum that is next to the true system on {far.sum()} of {systems}, by at most "
        f"{max(*above, 0):.1f}; below it on {np.sum(np.array(above) < -1)}."
    )


def reached(found: dict[tuple[int, int], list[Outcome]]) -> None:
    """What was asked beside what was measured."""
    least = min(o.fresh for each in found.values() for o in each)
    one, three, long = (
        float(np.median([o.seconds for o in found[key]]))
        for key in ((10**4, 1), (10**4, 3), (10**6, 1))
    )
    mib = [max(o.mib for o in found[rows, 1]) for rows in (10**5, 10**6)]
    print("\n| what | asked | measured | reached |\n|---|---|---|---|")
    for what, asked, value, good in (
        ("least fit of all", "≥ 99 %", f"{least:.2f} %", least >= 99),
        ("10⁴ rows, one input, median", "≤ 50 ms", f"{1e3 * one:.1f} ms", one <= 0.05),
        ("10⁴ rows, three inputs, median", "≤ 50 ms", f"{1e3 * three:.1f} ms", three <= 0.05),
        ("10⁶ rows, median", "≤ 1 s", f"{long:.3f} s", long <= 1),
        ("memory of 10⁶ over 10⁵ rows", "≤ 11", f"{mib[1] / mib[0]:.1f}", mib[1] <= 11 * mib[0]),
    ):
        print(f"| {what} | {asked} | {value} | {'yes' if good else 'no'} |")


def speed(seed: int, systems: int, long: bool) -> None:
    """Ours on every system and length; the peers at the lengths that they can do."""
    loaded()
    reached(own_sizes(seed, systems))
    for inputs in (1, 3):
        missed(seed, 10**4, inputs, systems)
    beside(seed, 10**4, 1, systems, LIMIT_S, list(PEERS))
    beside(seed, 10**4, 3, systems if long else FEW, LIMIT_S, list(PEERS))
    beside(seed, 10**5, 1, systems if long else FEW, LIMIT_S, [n for n in PEERS if n not in SLOW])
    if long:
        beside(seed, 10**5, 1, 2, LONG_S, SLOW)
