"""The search for the denominators: refined instrumental variables, and a fallback."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.transfer.output_error import Orders, Problem, Projection
from thermaltool.fitting.transfer.starts import Grid, grid
from thermaltool.signals.gauss_newton import minimize, solve

# A loss that changes by less than this many error variances: a hundredth of a standard error.
SETTLED = 1e-4
# A loss below this share of the signal is rounding.
EXACT = 1e-22
REFINED = "refined instrumental variables"
SEPARATE = f"{REFINED} of each input"
GAUSS_NEWTON = "Gauss-Newton"
# Where refined instrumental variables alone do not lead to the end.
FALLBACK = f"{GAUSS_NEWTON} from {REFINED}"
# Starts are compared on a record of at most so many samples.
SHORT = 20000
# Times that each of several inputs is searched wholly, where roughly is not enough.
SWEEPS = 2
# Inputs are fitted one by one for a start, until the loss changes by so few error variances.
ROUGH = 1.0
# A start counts as nearly as good up to this multiple of the loss.
NEAR = 1.01
# A minimum is another one where its loss differs by so many error variances.
APART = 1e-2
# Steps of refined instrumental variables without a better point, after which they are lost.
PATIENCE = 5
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
    Where they do not converge Gauss-Newton takes over from the best points seen. Several
    denominators are refined one by one, and by Gauss-Newton together.

    Raises
    ------
    FitError
        No start has a finite error.
    """
    if not any(problem.orders.nf):
        return Found(_plain(problem.orders), problem.project(_plain(problem.orders)),
                     "least squares", True, 0)  # fmt: skip
    several = len(problem.orders.groups) > 1
    short = problem
    if problem.data.rows > 2 * SHORT and problem.data.longest > SHORT:
        short = replace(problem, data=problem.data.excerpt(SHORT))
    best = _together(short) if several else _single(short)
    if short is not problem:
        best = _at_full_length(problem, best)
        if not best.converged and not several:
            best = gauss_newton(problem, best)
    return best


def _at_full_length(problem: Problem, short: Found) -> Found:
    """Go on with the whole record, also from slower poles than a short one shows."""
    whole = _gone_on(problem, short, short.F)
    for tau in np.geomspace(SHORT, problem.data.longest, 3)[:2]:
        F = tuple(_with_slow_pole(problem, f, float(tau)) if len(f) > 1 else f for f in short.F)
        if problem.project(F, keep=False).loss < whole.loss:
            whole = min(whole, _gone_on(problem, short, F), key=lambda found: found.loss)
    return whole


def _gone_on(problem: Problem, short: Found, F: tuple[Array, ...]) -> Found:
    """The last search of a shorter record, over this one."""
    if len(F) == 1:
        return refine(problem, F)
    return gauss_newton(problem, Found(F, problem.project(F), SEPARATE, False, short.steps))


def _with_slow_pole(problem: Problem, F: Array, tau: float) -> Array:
    """The slowest pole replaced by a time constant in samples, the others by theirs."""
    size = np.sort(np.abs(np.roots(problem.recursion(F))))[:-1]
    lags = -1 / np.log(np.clip(size, 1e-9, 1 - 1e-9))
    return problem.start(np.append(lags, tau))


def refine(
    problem: Problem, F: tuple[Array, ...], most: int = 20, settled: float = SETTLED
) -> Found:
    """Refined instrumental variables from one start.

    Settled is a loss that changes by less than `settled` error variances. A rough search is given
    up where it has not come below its best point for a while.
    """
    here = problem.project(F)
    best = Found(F, here, REFINED, False, 0)
    floor = EXACT * sum(float(y @ y) for y in (problem.data.y[k][0] for k in problem.used))
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
        if change <= settled * here.loss / problem.rows or here.loss <= floor:
            return replace(best, converged=here.loss <= best.loss * (1 + 1e-2 / problem.rows))
        if settled > SETTLED and k >= best.steps + PATIENCE:
            break
    return best


def gauss_newton(problem: Problem, start: Found, most: int = 40) -> Found:
    """Damped Gauss-Newton on the projected error from the best point of another search."""

    def moved(here: Found, step: Array) -> Found:
        F = problem.moved(here.F, step)
        return replace(here, F=F, projection=problem.project(F))

    end = minimize(
        start,
        lambda here: here.loss,
        lambda here: _reduced(problem, here.F, here.projection),
        moved,
        lambda here: SETTLED * here.loss / problem.rows,
        most,
    )
    method, steps = f"{GAUSS_NEWTON} from {start.method}", start.steps + end.iterations
    return replace(end.point, method=method, converged=end.converged, steps=steps)


def overdamped(problem: Problem, start: Found, most: int = 60) -> Found:
    """Real, stable poles: damped Gauss-Newton over the logarithms of the time constants.

    A start that is overdamped already is the answer. Else of a pair each pole takes its decay, a
    little apart; and lags of the coarse grid, or with several denominators some that divide the
    record among them, are tried, too, for the pair may have stood for something else.
    """
    roots = [np.roots(problem.recursion(f)) for f in start.F]
    if all(bool(np.all((z.imag == 0) & (z.real > 0))) for z in roots):
        return start
    longest = problem.data.longest
    lags = [_apart(-1 / np.log(np.clip(np.abs(z), 1e-6, 1 - 1e-9))) for z in roots]
    if len(roots) == 1:
        coarse = grid(problem)
        outputs = [problem.output(k) for k in problem.used]
        others = [[-1 / np.log(np.roots(problem.recursion(s.F)).real.clip(1e-6))]
                  for s in coarse.ranked(outputs, 3)]  # fmt: skip
    else:
        others = [[np.geomspace(longest / 6, max(longest / 600, 1.0), len(z)) for z in roots]]
    tries = [_over_lags(problem, each, most) for each in (lags, *others)]
    return min(tries, key=lambda found: found.loss)


def _over_lags(problem: Problem, lags: list[Array], most: int) -> Found:
    """Gauss-Newton from these time constants of each denominator [samples]."""
    bounds = np.log(0.1), np.log(SLOWEST * problem.data.longest)
    theta = np.clip(np.log(np.concatenate(lags)), *bounds)
    edges = np.cumsum([0, *map(len, lags)])

    def denominators(theta: Array) -> tuple[Array, ...]:
        return tuple(problem.start(np.exp(theta[a:b])) for a, b in itertools.pairwise(edges))

    def found(theta: Array) -> tuple[Array, Found]:
        F = denominators(theta)
        method = f"{GAUSS_NEWTON} over real poles"
        return theta, Found(F, problem.project(F), method, False, 0)

    def normal_equations(here: tuple[Array, Found]) -> tuple[Array, Array]:
        reduced, score = _reduced(problem, here[1].F, here[1].projection)
        turn = _by_lags(problem, here[1].F, here[0], denominators)
        return turn.T @ reduced @ turn, turn.T @ score

    end = minimize(
        found(theta),
        lambda here: here[1].loss,
        normal_equations,
        lambda here, step: found(np.clip(here[0] + np.clip(step, -1.0, 1.0), *bounds)),
        lambda here: SETTLED * here[1].loss / problem.rows,
        most,
    )
    return replace(end.point[1], converged=end.converged, steps=end.iterations)


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


def _single(problem: Problem) -> Found:
    """One denominator: refined instrumental variables from the best starts."""
    outputs = [problem.output(k) for k in problem.used]
    ranked = [(s.F,) for s in grid(problem).ranked(outputs, 5)]
    if not ranked:
        raise FitError("no start of the search has a finite error")
    # A second start tells whether the first one was caught beside the minimum.
    tries = [refine(problem, F) for F in ranked[:2]]
    best = min(tries, key=lambda found: found.loss)
    if not best.converged or not all(t.loss < STUCK * best.loss for t in tries):
        tries += [refine(problem, F) for F in ranked[2:5]]
        best = min(tries, key=lambda found: found.loss)
    if not best.converged:
        # Which of the points leads to the least is not seen from their losses.
        best = min((gauss_newton(problem, t) for t in tries), key=lambda found: found.loss)
    return best


def _together(problem: Problem) -> Found:
    """Several denominators: input by input, what the others explain taken off; then together.

    Each input then has the choice of starts of its own, which no coarse grid of all has. Where one
    of them does not settle so, all are searched again with more effort.
    """
    start, settled = _swept(problem)
    best = gauss_newton(problem, Found(start, problem.project(start), SEPARATE, False, 0))
    lower = beside(problem, best)
    if lower is not None:
        other = Found(lower, problem.project(lower), SEPARATE, False, best.steps)
        best = min(best, gauss_newton(problem, other), key=lambda found: found.loss)
    if settled and best.converged:
        return best
    tries = [replace(refine(problem, F), method=SEPARATE) for F in thorough(problem)]
    ends = [best, *(gauss_newton(problem, each) for each in tries)]
    return min(ends, key=lambda found: found.loss)


def _swept(problem: Problem) -> tuple[tuple[Array, ...], bool]:
    """Each input roughly, the one that explains most first; and whether that one settled."""
    whole = [problem.output(k) for k in problem.used]
    parts = [_alone(problem, g, whole) for g in range(len(problem.orders.groups))]
    grids = [grid(part) if any(part.orders.nf) else None for part in parts]
    losses = [_best_loss(each, whole) for each in grids]
    order = sorted(range(len(parts)), key=lambda g: losses[g])
    F, left, settled = [np.ones(1) for _ in parts], whole, []
    for g in order:
        alone = _alone(problem, g, left)
        one = _rough(alone, grids[g], left)
        F[g] = one.F[0]
        settled.append(one.converged)
        left = [
            y - signals[0]
            for y, (_, signals) in zip(left, alone.errors(one.projection), strict=True)
        ]
    return tuple(F), settled[0]


def thorough(problem: Problem) -> list[tuple[Array, ...]]:
    """The same with a whole search for each input, and with what the later ones explain."""
    whole = [problem.output(k) for k in problem.used]
    groups = range(len(problem.orders.groups))
    F = [np.ones(1) for _ in groups]
    shares = [[np.zeros_like(y) for y in whole] for _ in groups]
    found = []
    for _ in range(SWEEPS):
        for g in groups:
            left = [y - sum(shares[h][k] for h in groups if h != g) for k, y in enumerate(whole)]
            alone = _alone(problem, g, left)
            one = search(alone)
            F[g] = one.F[0]
            shares[g] = [signals[0] for _, signals in alone.errors(one.projection)]
        found.append(tuple(F))
    return found


def _best_loss(starts: Grid | None, outputs: list[Array]) -> float:
    ranked = starts.ranked(outputs, 1) if starts else []
    return ranked[0].loss if ranked else float("inf")


def _rough(problem: Problem, starts: Grid | None, outputs: list[Array]) -> Found:
    """One input of several, from the best starts."""
    if starts is None:
        return Found((np.ones(1),), problem.project((np.ones(1),)), REFINED, True, 0)
    tries: list[Found] = []
    for start in starts.ranked(outputs, 3):
        tries.append(refine(problem, (start.F,), settled=ROUGH))
        if tries[-1].converged:
            break
    if not tries:
        raise FitError("no start of the search has a finite error")
    return min(tries, key=lambda found: found.loss)


def beside(problem: Problem, found: Found) -> tuple[Array, ...] | None:
    """Denominators of less loss with another pole of one input, where there are any.

    An input that explains little has several minima nearly as deep: where a start comes near the
    loss that was found, it is refined too.
    """
    F = list(found.F)
    errors = list(problem.errors(found.projection))
    for g, f in enumerate(found.F):
        poles = np.roots(problem.recursion(f))
        if not len(poles) or not np.all((poles.imag == 0) & (poles.real > 0)):
            continue
        left = [error + signals[g] for error, signals in errors]
        alone = _alone(problem, g, left)
        for start in grid(alone, -1 / np.log(poles.real)).ranked(left, 2):
            if start.loss > NEAR * found.loss:
                break
            other = refine(alone, (start.F,), settled=ROUGH)
            if other.loss < found.loss * (1 - APART / problem.rows):
                F[g] = other.F[0]
                break
    return tuple(F) if any(f is not own for f, own in zip(F, found.F, strict=True)) else None


def _alone(problem: Problem, g: int, outputs: list[Array]) -> Problem:
    """One group of inputs, for other outputs of the used records on the rows that count."""
    o = problem.orders
    rows = list(o.groups[g])
    own = Orders(
        tuple(o.nb[i] for i in rows), (o.nf[g],), tuple(o.nk[i] for i in rows),
        (tuple(range(len(rows))),),
    )  # fmt: skip
    data, cut, records = problem.data, o.first - own.first, []
    names = tuple(data.inputs[i] for i in rows)
    for k, y in zip(problem.used, outputs, strict=True):
        columns = {data.inputs[i]: data.u[k][i, cut:] for i in rows}
        columns[data.outputs[0]] = np.concatenate([np.zeros(own.first), y])
        time = data.records[k].time[cut:]
        records.append(replace(data.records[k], time=time, columns=columns, segments=()))
    holds = tuple(data.holds[i] for i in rows)
    return problem.only(replace(data, records=tuple(records), inputs=names, holds=holds), own)
