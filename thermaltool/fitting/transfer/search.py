"""The search for the denominators: refined instrumental variables, and Gauss-Newton behind them.

Damped Gauss-Newton from the same starts finds as good models in coloured errors (AR(1) 0.9, as
large as the white ones; 1000 and 10000 rows, one and three inputs; seed 650986): with the right
order the fits of fresh records are the same to 0.01 points on 144 of 160 systems, better on 6 and
worse on 10; with an order too many the same on 36, better on 40 and worse on 20 of 96; where the
orders were chosen the same on 29, better on 4 and worse on 3 of 36. It takes 1.3 to 1.5 times as
long on 10⁴ rows of one input (median; an oscillation is far from the starts, which are real), and
so refined instrumental variables stay.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.transfer.output_error import Orders, Problem, Projection
from thermaltool.fitting.transfer.starts import Grid, grid
from thermaltool.signals.gauss_newton import minimize, solve

# A search ends where a step changes the loss by less than this [error variances]: a hundredth of a
# standard error; one input of several is fitted for a start until it changes by less than the
# second.
TOLERANCE, ROUGH_TOLERANCE = 1e-4, 1.0
# A loss below this share of the squared output is rounding.
MIN_RELATIVE_LOSS = 1e-22
REFINED = "refined instrumental variables"
SEPARATE = f"{REFINED} of each input"
GAUSS_NEWTON = "Gauss-Newton"
# Where refined instrumental variables alone do not lead to the end.
FALLBACK = f"{GAUSS_NEWTON} from {REFINED}"
# Steps of either search, at most; of a rough one without a better point, after which it is lost.
REFINED_STEPS, GAUSS_NEWTON_STEPS, LOST_STEPS = 20, 40, 5
# Starts, and candidates of the choice of orders, are compared on so many samples at most.
MAX_COMPARED_ROWS = 20000
# Starts of one denominator that are always followed, and where these do not agree.
STARTS, MORE_STARTS = 2, 5
# Ends whose losses differ by less than this factor agree.
AGREEING_LOSS = 1.001
# Starts of one input of several that are followed roughly; of another pole of it.
ROUGH_STARTS, OTHER_STARTS = 3, 2
# Rounds in which each of several inputs is searched wholly, where roughly is not enough.
INPUT_ROUNDS = 2
# A start counts as nearly as good up to this multiple of the loss.
NEAR_LOSS = 1.01
# A minimum is another one where its loss differs by so many error variances.
OTHER_MINIMUM = 1e-2


@dataclass(frozen=True)
class SearchResult:
    """Where a search ended.

    Attributes
    ----------
    F : tuple of ndarray
        Denominators.
    projection : Projection
        Everything that is linear for them.
    method : str
        The search that led there.
    converged : bool
    """

    F: tuple[Array, ...]
    projection: Projection
    method: str
    converged: bool = False

    @property
    def loss(self) -> float:
        """Sum of the squared errors [unit²]."""
        return self.projection.loss


def at(problem: Problem, F: tuple[Array, ...], method: str = REFINED) -> SearchResult:
    """These denominators with what is linear for them, as a start of a search or of another one."""
    return SearchResult(F, problem.project(F), method)


def least(results: Iterable[SearchResult]) -> SearchResult:
    """The result of least loss."""
    return min(results, key=lambda result: result.loss)


def search(problem: Problem, rough: bool = False, tolerance: float = TOLERANCE) -> SearchResult:
    """The denominators of least output error.

    Starts are compared on a short record; refined instrumental variables go on from the best.
    Where they do not converge Gauss-Newton takes over from the best points seen. Several
    denominators are refined one by one, and by Gauss-Newton together.

    Parameters
    ----------
    problem : Problem
    rough : bool
        Several denominators are not searched again where the search does not converge: those of
        too high an order never do.
    tolerance : float [error variances]
        Gain by the last step of Gauss-Newton, of one denominator.

    Raises
    ------
    FitError
        No start has a finite error.
    """
    if not any(problem.orders.nf):
        F = tuple(np.ones(1) for _ in problem.orders.groups)
        return replace(at(problem, F, "least squares"), converged=True)
    several = len(problem.orders.groups) > 1
    short = problem
    if problem.data.rows > 2 * MAX_COMPARED_ROWS and problem.data.longest > MAX_COMPARED_ROWS:
        short = replace(problem, data=problem.data.excerpt(MAX_COMPARED_ROWS))
    best = _several(short, rough) if several else _one_denominator(short, tolerance)
    if short is not problem:
        best = _at_full_length(problem, best)
        if not best.converged and not several:
            best = gauss_newton(problem, best, tolerance)
    return best


def _at_full_length(problem: Problem, short: SearchResult) -> SearchResult:
    """Go on with the whole record, also from slower poles than a short one shows."""

    def gone_on(F: tuple[Array, ...]) -> SearchResult:
        if len(F) == 1:
            return refine(problem, F)
        return gauss_newton(problem, at(problem, F, SEPARATE))

    whole = gone_on(short.F)
    for tau in np.geomspace(MAX_COMPARED_ROWS, problem.data.longest, 3)[:2]:
        F = tuple(_with_slow_pole(problem, f, float(tau)) if len(f) > 1 else f for f in short.F)
        if problem.project(F, keep=False).loss < whole.loss:
            whole = least([whole, gone_on(F)])
    return whole


def _with_slow_pole(problem: Problem, F: Array, tau: float) -> Array:
    """The slowest pole replaced by a time constant in samples, the others by theirs."""
    size = np.sort(np.abs(np.roots(problem.recursion(F))))[:-1]
    time_constants = -1 / np.log(np.clip(size, 1e-9, 1 - 1e-9))
    return problem.start(np.append(time_constants, tau))


def refine(
    problem: Problem,
    F: tuple[Array, ...],
    steps: int = REFINED_STEPS,
    tolerance: float = TOLERANCE,
) -> SearchResult:
    """Refined instrumental variables from one start (Young 2011, chapter 7).

    A rough search is given up where it has not come below its best point for a while.

    Parameters
    ----------
    problem : Problem
    F : tuple of ndarray
    steps : int
        At most.
    tolerance : float [error variances]
        Change of the loss by the last step.
    """
    here = problem.project(F)
    best, best_step = SearchResult(F, here, REFINED), 0
    power = sum(float(np.nansum(problem.data.y[k][0] ** 2)) for k in problem.used)
    floor = MIN_RELATIVE_LOSS * power
    for k in range(1, steps + 1):
        slopes = problem.slopes(F, here)
        F = problem.moved(F, solve(slopes.mixed, slopes.score)[: slopes.searched])
        if not all(np.isfinite(f).all() for f in F):
            break
        there = problem.project(F)
        change, here = abs(there.loss - here.loss), there
        if here.loss < best.loss:
            best, best_step = SearchResult(F, here, REFINED), k
        if change <= tolerance * here.loss / problem.rows or here.loss <= floor:
            return replace(best, converged=here.loss <= best.loss * (1 + 1e-2 / problem.rows))
        if tolerance > TOLERANCE and k >= best_step + LOST_STEPS:
            break
    return best


def gauss_newton(
    problem: Problem, start: SearchResult, tolerance: float = TOLERANCE
) -> SearchResult:
    """Damped Gauss-Newton on the projected error from the best point of another search.

    Parameters
    ----------
    problem : Problem
    start : SearchResult
    tolerance : float [error variances]
        Gain by the last step.
    """
    method = f"{GAUSS_NEWTON} from {start.method}"
    end = minimize(
        start,
        lambda here: here.loss,
        lambda here: reduced_equations(problem, here),
        lambda here, step: at(problem, problem.moved(here.F, step)),
        lambda here: tolerance * here.loss / problem.rows,
        GAUSS_NEWTON_STEPS,
    )
    return replace(end.point, method=method, converged=end.converged)


def reduced_equations(problem: Problem, here: SearchResult) -> tuple[Array, Array]:
    """Gauss-Newton matrix and score of the denominators, the linear parameters projected out."""
    slopes = problem.slopes(here.F, here.projection, mixed=False)
    n = slopes.searched
    inner = slopes.gram[:n, n:]
    taken = solve(slopes.gram[n:, n:], np.column_stack([inner.T, slopes.score[n:]]))
    return slopes.gram[:n, :n] - inner @ taken[:, :n], slopes.score[:n] - inner @ taken[:, n]


def _one_denominator(problem: Problem, tolerance: float) -> SearchResult:
    """One denominator: refined instrumental variables from the best starts."""
    outputs = [problem.output(k) for k in problem.used]
    ranked = [(s.F,) for s in grid(problem).ranked(outputs, MORE_STARTS)]
    if not ranked:
        raise FitError("no start of the search has a finite error")
    # A second start tells whether the first one was caught beside the minimum.
    ends = [refine(problem, F) for F in ranked[:STARTS]]
    best = least(ends)
    if not best.converged or not all(end.loss < AGREEING_LOSS * best.loss for end in ends):
        ends += [refine(problem, F) for F in ranked[STARTS:]]
        best = least(ends)
    # Which of the points leads to the least is not seen from their losses.
    if best.converged:
        return best
    return least(gauss_newton(problem, end, tolerance) for end in ends)


def _several(problem: Problem, rough: bool) -> SearchResult:
    """Several denominators: input by input, what the others explain taken off; then together.

    Each input then has the choice of starts of its own, which no coarse grid of all has. Where the
    first of them does not converge so, all are searched again with more effort, unless roughly.
    """
    F, converged = _one_by_one(problem)
    best = gauss_newton(problem, at(problem, F, SEPARATE))
    lower = beside(problem, best)
    if lower is not None:
        best = least([best, gauss_newton(problem, at(problem, lower, SEPARATE))])
    if rough or (converged and best.converged):
        return best
    starts = [replace(refine(problem, F), method=SEPARATE) for F in thorough(problem)]
    return least([best, *(gauss_newton(problem, start) for start in starts)])


def _one_by_one(problem: Problem) -> tuple[tuple[Array, ...], bool]:
    """Each input roughly, the one that explains most first; and whether that one converged."""
    whole = [problem.output(k) for k in problem.used]
    parts = [_alone(problem, g, whole) for g in range(len(problem.orders.groups))]
    grids = [grid(part) if any(part.orders.nf) else None for part in parts]
    losses = [_best_loss(each, whole) for each in grids]
    order = sorted(range(len(parts)), key=lambda g: losses[g])
    F, left, converged = [np.ones(1) for _ in parts], whole, []
    for g in order:
        alone = _alone(problem, g, left)
        one = _rough(alone, grids[g], left)
        F[g] = one.F[0]
        converged.append(one.converged)
        left = [
            y - signals[0]
            for y, (_, signals) in zip(left, alone.errors(one.projection), strict=True)
        ]
    return tuple(F), converged[0]


def thorough(problem: Problem) -> list[tuple[Array, ...]]:
    """The same with a whole search for each input, and with what the later ones explain."""
    whole = [problem.output(k) for k in problem.used]
    groups = range(len(problem.orders.groups))
    F = [np.ones(1) for _ in groups]
    shares = [[np.zeros_like(y) for y in whole] for _ in groups]
    found = []
    for _ in range(INPUT_ROUNDS):
        for g in groups:
            left = [y - sum(shares[h][k] for h in groups if h != g) for k, y in enumerate(whole)]
            alone = _alone(problem, g, left)
            # Gauss-Newton over all together goes on from what is a start here.
            one = search(alone, tolerance=ROUGH_TOLERANCE)
            F[g] = one.F[0]
            shares[g] = [signals[0] for _, signals in alone.errors(one.projection)]
        found.append(tuple(F))
    return found


def _best_loss(starts: Grid | None, outputs: list[Array]) -> float:
    ranked = starts.ranked(outputs, 1) if starts else []
    return ranked[0].loss if ranked else float("inf")


def _rough(problem: Problem, starts: Grid | None, outputs: list[Array]) -> SearchResult:
    """One input of several, from the best starts."""
    if starts is None:
        return replace(at(problem, (np.ones(1),)), converged=True)
    ends: list[SearchResult] = []
    for start in starts.ranked(outputs, ROUGH_STARTS):
        ends.append(refine(problem, (start.F,), tolerance=ROUGH_TOLERANCE))
        if ends[-1].converged:
            break
    if not ends:
        raise FitError("no start of the search has a finite error")
    return least(ends)


def beside(problem: Problem, found: SearchResult) -> tuple[Array, ...] | None:
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
        for start in grid(alone, -1 / np.log(poles.real)).ranked(left, OTHER_STARTS):
            if start.loss > NEAR_LOSS * found.loss:
                break
            other = refine(alone, (start.F,), tolerance=ROUGH_TOLERANCE)
            if other.loss < found.loss * (1 - OTHER_MINIMUM / problem.rows):
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
