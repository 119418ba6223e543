"""The search for the denominators: refined instrumental variables, and a fallback."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.identification.transfer.data import Array
from thermaltool.identification.transfer.output_error import Orders, Problem, Projection, solve

# A loss that changes by less than this many error variances: a hundredth of a standard error.
SETTLED = 1e-4
# A loss below this share of the signal is rounding.
EXACT = 1e-22
REFINED = "refined instrumental variables"
GAUSS_NEWTON = "Gauss-Newton"
# Starts are compared on a record of at most so many samples.
SHORT = 20000
# Times that several inputs are fitted one by one for a start.
SWEEPS = 2
# Longest time constant of an overdamped model, in lengths of the record.
SLOWEST = 10
# Loss by which a fit may lie above the best one known before it counts as stuck.
STUCK = 1.001


@dataclass(frozen=True)
class Found:
    """Where a search ended.

    Attributes
    ----------
    F : tuple of ndarray
    projection : Projection
    method : str
        The search that led there.
    converged : bool
    steps : int
    """

    F: tuple[Array, ...]
    projection: Projection
    method: str
    converged: bool
    steps: int

    @property
    def loss(self) -> float:
        return self.projection.loss


def search(problem: Problem) -> Found:
    """The denominators of least output error.

    Starts are compared on a short record; refined instrumental variables go on from the best.
    Where they do not converge, or stay above a loss that is known to be within reach,
    Gauss-Newton takes over from the best of all points seen.

    Raises
    ------
    FitError
        No start has a finite error.
    """
    if not any(problem.orders.nf):
        return Found(_plain(problem.orders), problem.project(_plain(problem.orders)),
                     "least squares", True, 0)  # fmt: skip
    short = problem
    if problem.data.size > 2 * SHORT and problem.data.longest > SHORT:
        short = replace(problem, data=problem.data.head(SHORT))
    ranked = _ranked(short) if len(problem.orders.groups) == 1 else _swept(short)
    if not ranked:
        raise FitError("no start of the search has a finite error")
    tries = [refine(short, F) for _, F in ranked[:1]]
    # A second start tells whether the first one was caught beside the minimum.
    tries += [refine(short, F) for _, F in ranked[1:2]]
    best = min(tries, key=lambda found: found.loss)
    if not best.converged or not all(t.loss < STUCK * best.loss for t in tries):
        tries += [refine(short, F) for _, F in ranked[2:5]]
        best = min(tries, key=lambda found: found.loss)
    if short is not problem:
        best = _at_full_length(problem, best)
    known = best.loss
    if best.converged and len(problem.orders.groups) == 1:
        return best
    polished = gauss_newton(problem, best)
    if best.converged and polished.loss > known * (1 - SETTLED / problem.rows):
        return best
    return polished


def _at_full_length(problem: Problem, best: Found) -> Found:
    """Go on with the whole record, also from slower poles than a short one shows."""
    whole = refine(problem, best.F)
    for tau in np.geomspace(SHORT, problem.data.longest, 3)[:2]:
        F = tuple(_with_slow_pole(problem, f, float(tau)) if len(f) > 1 else f for f in best.F)
        if problem.project(F, keep=False).loss < whole.loss:
            other = refine(problem, F)
            whole = min(whole, other, key=lambda found: found.loss)
    return whole


def _with_slow_pole(problem: Problem, F: Array, tau: float) -> Array:
    """The slowest pole replaced by a time constant in samples, the others by theirs."""
    size = np.sort(np.abs(np.roots(problem.recursion(F))))[:-1]
    lags = -1 / np.log(np.clip(size, 1e-9, 1 - 1e-9))
    return problem.start(np.append(lags, tau))


def refine(problem: Problem, F: tuple[Array, ...], most: int = 20) -> Found:
    """Refined instrumental variables from one start."""
    here = problem.project(F)
    best = Found(F, here, REFINED, False, 0)
    floor = EXACT * sum(float(s.output @ s.output) for s in problem.used())
    for k in range(1, most + 1):
        slopes = problem.slopes(F, here)
        n = slopes.searched
        step = solve(slopes.mixed, slopes.score)[:n]
        F = problem.moved(F, step)
        if not all(np.isfinite(f).all() for f in F):
            break
        there = problem.project(F)
        change, here = abs(there.loss - here.loss), there
        if here.loss < best.loss:
            best = Found(F, here, REFINED, False, k)
        if change <= SETTLED * here.loss / problem.rows or here.loss <= floor:
            return replace(best, converged=here.loss <= best.loss * (1 + 1e-2 / problem.rows))
    return best


def gauss_newton(problem: Problem, start: Found, most: int = 40) -> Found:
    """Damped Gauss-Newton on the projected error from the best point of another search."""
    F, here, damping = start.F, start.projection, 1e-3
    for k in range(1, most + 1):
        reduced, pull = _reduced(problem, F, here)
        while True:
            step = solve(reduced + damping * np.diag(np.diag(reduced)), pull)
            tried = problem.moved(F, step)
            there = problem.project(tried)
            if there.loss < here.loss or damping > 1e8:
                break
            damping *= 10
        gained = here.loss - there.loss
        if gained <= SETTLED * here.loss / problem.rows:
            return Found(F, here, f"{GAUSS_NEWTON} from {start.method}", True, start.steps + k)
        F, here, damping = tried, there, max(damping / 10, 1e-12)
    return Found(F, here, f"{GAUSS_NEWTON} from {start.method}", False, start.steps + most)


def overdamped(problem: Problem, start: Found, most: int = 60) -> Found:
    """Real, stable poles: damped Gauss-Newton over the logarithms of the time constants.

    A start that is overdamped already is the answer. Of a pair each pole takes its decay, a little
    apart.
    """
    roots = [np.roots(problem.recursion(f)) for f in start.F]
    if all(bool(np.all((z.imag == 0) & (z.real > 0))) for z in roots):
        return start
    lags = [_apart(-1 / np.log(np.clip(np.abs(z), 1e-6, 1 - 1e-9))) for z in roots]
    theta, edges = np.log(np.concatenate(lags)), np.cumsum([0, *map(len, lags)])

    def denominators(theta: Array) -> tuple[Array, ...]:
        return tuple(problem.start(np.exp(theta[a:b])) for a, b in itertools.pairwise(edges))

    bounds = np.log(0.1), np.log(SLOWEST * problem.data.longest)
    F, damping = denominators(theta), 1e-3
    here = problem.project(F)
    for k in range(1, most + 1):
        reduced, pull = _reduced(problem, F, here)
        turn = _by_lags(problem, F, theta, denominators)
        inner, right = turn.T @ reduced @ turn, turn.T @ pull
        while True:
            step = solve(inner + damping * np.diag(np.diag(inner)), right)
            tried = np.clip(theta + np.clip(step, -1.0, 1.0), *bounds)
            there = problem.project(denominators(tried))
            if there.loss < here.loss or damping > 1e8:
                break
            damping *= 10
        gained = here.loss - there.loss
        if gained <= SETTLED * here.loss / problem.rows:
            return Found(F, here, f"{GAUSS_NEWTON} over real poles", True, k)
        theta, here, damping = tried, there, max(damping / 10, 1e-12)
        F = denominators(theta)
    return Found(F, here, f"{GAUSS_NEWTON} over real poles", False, most)


def _apart(lags: Array) -> Array:
    """Time constants within a third of each other are drawn apart, the slowest first."""
    lags = np.sort(np.clip(lags, 0.3, None))[::-1]
    for k in range(1, len(lags)):
        lags[k] = min(lags[k], lags[k - 1] / 1.5)
    return lags


def _by_lags(
    problem: Problem,
    F: tuple[Array, ...],
    theta: Array,
    denominators: Callable[[Array], tuple[Array, ...]],
) -> Array:
    """How steps of the denominators follow the logarithms of the time constants."""
    columns = []
    for k in range(len(theta)):
        beside = theta.copy()
        beside[k] += 1e-5
        steps = [problem.step_between(f, g) for f, g in zip(F, denominators(beside), strict=True)]
        columns.append(np.concatenate(steps) / 1e-5)
    return np.array(columns).T


def _reduced(problem: Problem, F: tuple[Array, ...], here: Projection) -> tuple[Array, Array]:
    """Gauss-Newton matrix and score of the denominators, the linear parameters projected out."""
    slopes = problem.slopes(F, here, mixed=False)
    n = slopes.searched
    inner = slopes.gram[:n, n:]
    taken = solve(slopes.gram[n:, n:], np.column_stack([inner.T, slopes.score[n:]]))
    return slopes.gram[:n, :n] - inner @ taken[:, :n], slopes.score[:n] - inner @ taken[:, n]


def _plain(orders: Orders) -> tuple[Array, ...]:
    return tuple(np.ones(1) for _ in orders.groups)


def _ranked(problem: Problem) -> list[tuple[float, tuple[Array, ...]]]:
    """Starts by their loss, the best first."""
    found = []
    for F in _starts(problem):
        loss = problem.project(F, keep=False).loss
        if np.isfinite(loss):
            found.append((loss, F))
    return sorted(found, key=lambda pair: pair[0])


def _swept(problem: Problem) -> list[tuple[float, tuple[Array, ...]]]:
    """Starts of several denominators, the best first: input by input, the others taken off.

    Each input then has the choice of starts of its own, which no coarse grid of all has.
    """
    o = problem.orders
    F = [np.eye(1, n + 1)[0] for n in o.nf]
    shares = [[np.zeros(len(s)) for s in problem.used()] for _ in o.groups]
    found: list[tuple[float, tuple[Array, ...]]] = []
    for _ in range(SWEEPS):
        for g, group in enumerate(o.groups):
            others = [
                np.sum([each[k] for h, each in enumerate(shares) if h != g], axis=0)
                for k in range(len(shares[g]))
            ]
            alone = _alone(problem, group, g, others)
            one = search(alone)
            F[g] = one.F[0]
            skip = alone.orders.first
            for k, (_, signals) in enumerate(alone.errors(one.projection)):
                shares[g][k] = np.concatenate([np.zeros(skip), signals[0]])
        loss = problem.project(tuple(F), keep=False).loss
        if np.isfinite(loss):
            found.append((loss, tuple(F)))
    return sorted(found, key=lambda pair: pair[0])


def _alone(problem: Problem, group: tuple[int, ...], g: int, others: list[Array]) -> Problem:
    """One group of inputs, and what the others leave of the output."""
    o = problem.orders
    rows = list(group)
    stretches = tuple(
        replace(s, inputs=s.inputs[rows], output=s.output - other)
        for s, other in zip(problem.used(), others, strict=True)
    )
    names = tuple(problem.data.names[i] for i in group)
    orders = Orders(
        tuple(o.nb[i] for i in group), (o.nf[g],), tuple(o.nk[i] for i in group),
        (tuple(range(len(group))),),
    )  # fmt: skip
    return replace(problem, data=replace(problem.data, stretches=stretches, names=names),
                   orders=orders)  # fmt: skip


def _starts(problem: Problem) -> Iterator[tuple[Array, ...]]:
    """Real poles on a coarse grid of time constants, and those of a least-squares ARX model."""
    longest = max(problem.data.longest / 2.0, 8.0)
    # Poles with a time constant below a sample are as good as delays.
    count = max(3, min(7, round(np.log(longest) / np.log(4)) + 1))
    tau = np.geomspace(0.7, longest, count)
    largest = max(problem.orders.nf)
    for chosen in itertools.combinations(tau, min(largest, 2)):
        lags = [*chosen, *[chosen[0] * 0.5**k for k in range(1, largest - 1)]]
        yield tuple(problem.start(np.array(lags[:n])) for n in problem.orders.nf)
