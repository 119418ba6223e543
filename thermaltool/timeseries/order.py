"""The order of an ARMA model: every pair (p, q) at once, the best ones by exact likelihood.

All pairs are estimated from one Gram matrix (Hannan-Rissanen). From the promising ones a
best-first search goes on by exact maximum likelihood: each fitted model proposes its neighbours
(one coefficient more or less, by the quadratic expansion of its likelihood) and the narrow lines
left in its innovations; the proposal with the least expected criterion is fitted next. A full grid
of maximum-likelihood fits costs some ten times more and, started from regressions alone, misses
those lines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.criteria import CRITERIA, OrderCriteria
from thermaltool.timeseries.hannan import corrected, gram_matrix
from thermaltool.timeseries.lagged import inner
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import Maximum, climb, start
from thermaltool.timeseries.narrow import narrow_factors, with_line
from thermaltool.timeseries.polynomials import (
    MAX_CANCELLING_DISTANCE,
    cancelling,
    is_stationary_and_invertible,
    without_root,
)
from thermaltool.timeseries.runs import pieces
from thermaltool.timeseries.starts import all_starts, as_difference, summed

Array = NDArray[np.float64]
Pair = tuple[int, int]

# The search. Deviances and criteria are in units of -2 log L.
BUDGET = 55  # slopes of the likelihood, for a search of 0.1 s at 10³ samples
SEED_STEPS = 0  # from a regression: its likelihood and slope already rank it
VISIT_STEPS = 8  # of one visit to a model: most maxima are reached, the others wait their turn
TOLERANCE = 2e-2  # [deviance] of a visit, a hundredth of what tells two models apart
FINAL_STEPS, FINAL_TOLERANCE = 25, 1e-5  # for the best model, whose criteria are printed
GAIN_MARGIN = 3.0  # [deviance] by which a model may end better than its linear prediction says
LINE_GAIN_MARGIN = 1.5  # [deviance], the same of a narrow line, whose gain is known better
# [deviance] by which a start may miss its prediction and still be climbed from in full; else so
# many steps: the prediction was of another place.
MAX_MISS, MISSED_STEPS = 10.0, 3
MIN_LINE_DISTANCE = 30.0  # [rad samples] between lines: nearer ones take gain from each other
MAX_PARENT_EXCESS = 4.0  # [criterion] above the best: models as near as this propose others
MAX_PROPOSAL_EXCESS = 3.0  # [criterion] above the best: the search ends where none hopes for less
SEEDS_PER_CRITERION = 4  # regressions that are started from, the best of each criterion
MAX_SMALL_ORDER = 7  # p + q: up to this all are looked at, there are 36
MIN_WANDER_CORRELATION = 0.9  # of neighbours: from here the series may be a running sum
SAMPLES_PER_PARAMETER = 3  # with fewer, a maximum means little and AICc has no correction
# Samples below which a record has more maxima, and its best few small models start again.
SHORT_RECORD_SAMPLES, RESTARTED_MODELS = 500, 3
# Each run costs a filter of its own: with more runs, only orders p + q up to this are looked at.
MAX_FEW_RUNS, MAX_ORDER_OF_MANY_RUNS = 20, 2
MIN_VARIANCE_SHARE = 1e-14  # of the mean square: what no regression can reach, rounding leaves


@dataclass(frozen=True)
class OrderTable:
    """What the search has seen.

    Attributes
    ----------
    entries : tuple of OrderCriteria
        One per pair, by p, then q.
    fits : mapping of (p, q) to Maximum
        The exact ones.
    max_p, max_q : int
        The grid as it was asked for.
    cut_short : bool
        The budget ended the search, while orders were left that might be better.
    """

    entries: tuple[OrderCriteria, ...]
    fits: Mapping[Pair, Maximum]
    max_p: int
    max_q: int
    cut_short: bool

    def best(self, criterion: str) -> OrderCriteria:
        """The exact entry of the least `criterion`."""
        return min((e for e in self.entries if e.exact), key=CRITERIA[criterion])

    def at_edge(self, entry: OrderCriteria) -> bool:
        """Whether a larger grid might hold a better model."""
        return (entry.p == self.max_p > 0) or (entry.q == self.max_q > 0)


def select_order(
    record: Record,
    max_p: int = 10,
    max_q: int = 10,
    degree: int = 0,
    criteria: Sequence[str] = ("aic", "aicc", "bic"),
    budget: int = BUDGET,
) -> OrderTable:
    """Criteria of every ARMA order up to (max_p, max_q).

    Parameters
    ----------
    record : Record
    max_p, max_q : int
    degree : int
        Of the trend that is estimated along: 0 for a mean, 1 for a line, -1 for none.
    criteria : sequence of str
        Names in `CRITERIA` whose best models are looked for.
    budget : int
        Slopes of the likelihood that may be taken.

    Raises
    ------
    FitError
        Constant series, or too short for the smallest models.
    """
    search = _OrderSearch(record, max_p, max_q, degree, criteria)
    cut_short = search.run(budget)
    entries = tuple(search.entries[k] for k in sorted(search.entries))
    return OrderTable(entries, search.fits, max_p, max_q, cut_short)


@dataclass(frozen=True)
class _Proposal:
    """A model to be fitted, the deviance and criteria that it may reach; its fit where known."""

    ar: Array
    ma: Array
    expected: float
    values: tuple[float, ...]
    known: Maximum | None = None


class _OrderSearch:
    def __init__(
        self, record: Record, max_p: int, max_q: int, degree: int, criteria: Sequence[str]
    ) -> None:
        self.likelihood, self.criteria = ArmaLikelihood(record, degree), tuple(criteria)
        self.centred = self.likelihood.detrended
        size = self.likelihood.size
        largest = size // SAMPLES_PER_PARAMETER - self.likelihood.regressors - 1
        if largest < 1:
            raise FitError(f"{size} samples are too few to choose an order")
        self.max_p, self.max_q = min(max_p, largest), min(max_q, largest)
        self.largest = largest
        self.fits: dict[Pair, Maximum] = {}
        self.entries: dict[Pair, OrderCriteria] = {}
        self.proposals: list[_Proposal] = []
        self.seen: set[Pair] = set()
        self.finished: set[Pair] = set()
        self.best = dict.fromkeys(self.criteria, np.inf)
        self._regressions()
        self._differences()

    def _regressions(self) -> None:
        """Every pair from the Gram matrix; the promising ones are proposed."""
        centred, all_runs = self.centred, pieces(self.centred)
        power = sum(inner(run, run) for run in all_runs) / self.likelihood.size
        gram = gram_matrix(centred, self.max_p, self.max_q)
        starts: dict[Pair, tuple[Array, Array]] = {}
        for p in range(self.max_p + 1):
            for q in range(min(self.max_q, self.largest - p) + 1):
                ar, ma, sigma2 = gram.solve(p, q)
                sigma2 = max(sigma2, MIN_VARIANCE_SHARE * power)
                starts[p, q] = ar, ma
                self.entries[p, q] = self._entry((p, q), self._deviance(sigma2), sigma2, False)
        autoregressions = burg(centred, self.max_p)
        for p in range(1, self.max_p + 1):
            starts[p, 0] = autoregressions.coefficients[p], np.empty(0)
        few = len(all_runs) <= MAX_FEW_RUNS
        small = MAX_SMALL_ORDER if few else MAX_ORDER_OF_MANY_RUNS
        chosen = {pair for pair in starts if sum(pair) <= small}
        for name in self.criteria:
            value = CRITERIA[name]
            ranked = sorted(starts, key=lambda pair: value(self.entries[pair]))
            chosen |= set(ranked[: SEEDS_PER_CRITERION if few else 1])
            pure = min(range(self.max_p + 1), key=lambda p: value(self.entries[p, 0]))
            chosen.add((pure, 0))
        for pair in sorted(chosen):
            ar, ma = starts[pair]
            if ma.size:  # the third regression comes nearer where roots are close to the circle
                better = corrected(centred, ar, ma)
                ar, ma = better.ar, better.ma
            at, _ = climb(self.likelihood, start(self.likelihood, ar, ma), SEED_STEPS, TOLERANCE)
            self._keep(at)
            expected = at.deviance - max(GAIN_MARGIN, 1.5 * at.predicted_fall)
            self._propose(at.ar, at.ma, expected, at)

    def _differences(self) -> None:
        """Where the series wanders, models with an MA root at 1 from the orders of its sum."""
        x = np.concatenate(pieces(self.centred))
        if self.max_q == 0 or inner(x[1:], x[:-1]) < MIN_WANDER_CORRELATION * inner(x, x):
            return
        sums = summed(self.centred)
        try:
            gram = gram_matrix(sums, self.max_p, self.max_q)
        except FitError:
            return
        found = {}
        for p, q in self.entries:
            if q:
                ar, ma, sigma2 = gram.solve(p, q - 1)
                found[p, q] = ar, ma, self._entry((p, q), self._deviance(sigma2), sigma2, False)
        chosen: set[Pair] = set()
        for name in self.criteria:
            chosen |= set(sorted(found, key=lambda pair: CRITERIA[name](found[pair][2]))[:2])
        for pair in sorted(chosen):
            better = corrected(sums, *found[pair][:2])
            at = start(self.likelihood, better.ar, as_difference(better.ma))
            self._propose(at.ar, at.ma, at.deviance - GAIN_MARGIN)

    def _entry(self, pair: Pair, deviance: float, sigma2: float, exact: bool) -> OrderCriteria:
        size, regressors = self.likelihood.size, self.likelihood.regressors
        return OrderCriteria(*pair, float(deviance), float(sigma2), size, regressors, exact)

    def _keep(self, fit: Maximum) -> None:
        """Keep a fit that is better than what is known of its pair."""
        pair = fit.order
        known = self.fits.get(pair)
        if known is not None and known.deviance <= fit.deviance:
            return
        self.fits[pair] = fit
        entry = self.entries[pair] = self._entry(pair, fit.deviance, fit.at.sigma2, fit.converged)
        for name in self.criteria:
            self.best[name] = min(self.best[name], CRITERIA[name](entry))

    def _propose(self, ar: Array, ma: Array, expected: float, known: Maximum | None = None) -> None:
        pair = ar.size, ma.size
        if pair in self.entries:
            entry = self._entry(pair, expected, self._sigma2(expected), True)
            values = tuple(CRITERIA[name](entry) for name in self.criteria)
            self.proposals.append(_Proposal(ar, ma, expected, values, known))

    def _excess(self, name: str, pair: Pair, deviance: float) -> float:
        """By how much a deviance misses the best in one criterion."""
        entry = self._entry(pair, deviance, self._sigma2(deviance), True)
        return CRITERIA[name](entry) - self.best[name]

    def _deviance(self, sigma2: float) -> float:
        """Deviance of white noise with this variance."""
        return self.likelihood.size * (float(np.log(2.0 * np.pi * sigma2)) + 1.0)

    def _sigma2(self, deviance: float) -> float:
        """Variance of white noise with this deviance."""
        return float(np.exp(min(deviance / self.likelihood.size, 600.0) - 1.0) / (2.0 * np.pi))

    def run(self, budget: int) -> bool:
        """Fit what promises most until nothing is left that could win; criteria take turns.

        Returns whether the budget was spent before.
        """
        cut_short = self._search(budget)
        for name in self.criteria:
            self._finish(CRITERIA[name])
        return cut_short

    def _finish(self, value: Callable[[OrderCriteria], float]) -> None:
        """Climb on until the best model is at its maximum; the best few of a short record anew."""
        count = RESTARTED_MODELS if self.likelihood.size <= SHORT_RECORD_SAMPLES else 1
        while True:
            leading = sorted(self.fits, key=lambda each: value(self.entries[each]))[:count]
            left = [pair for pair in leading if pair not in self.finished]
            if not left:
                return
            self._complete(left[0])

    def _complete(self, pair: Pair) -> None:
        fit = replace(self.fits.pop(pair), converged=sum(pair) == 0)
        few = self.likelihood.runs <= MAX_FEW_RUNS
        if few and self.likelihood.size <= SHORT_RECORD_SAMPLES and sum(pair) <= MAX_SMALL_ORDER:
            others = [climb(self.likelihood, each, VISIT_STEPS, TOLERANCE)[0]
                      for each in all_starts(self.likelihood, *pair)]  # fmt: skip
            fit = min(fit, *others, key=lambda each: each.deviance)
            fit = replace(fit, converged=sum(pair) == 0)
        fit, _ = climb(self.likelihood, fit, FINAL_STEPS, FINAL_TOLERANCE)
        # A maximum on the unit circle is approached for ever: this near will do.
        self._keep(replace(fit, converged=True))
        self.finished.add(pair)

    def _search(self, budget: int) -> bool:
        idle, names = 0, cycle(enumerate(self.criteria))
        while budget > 0:
            k, name = next(names)
            excess = [each.values[k] - self.best[name] for each in self.proposals]
            first = int(np.argmin(excess)) if excess else 0
            idle = 0 if excess and excess[first] < MAX_PROPOSAL_EXCESS else idle + 1
            if idle == 0:
                budget -= self._visit(self.proposals.pop(first))
            if idle == len(self.criteria):
                return False
        return True

    def _visit(self, proposal: _Proposal) -> int:
        """Fit one proposal and let it propose others; the slopes that it took."""
        begin = proposal.known or start(self.likelihood, proposal.ar, proposal.ma)
        false = begin.deviance > proposal.expected + MAX_MISS
        steps = MISSED_STEPS if false else VISIT_STEPS
        fit, slopes = climb(self.likelihood, begin, steps, TOLERANCE)
        pair = fit.order
        known = self.fits.get(pair)
        fresh = known is None or known.deviance > fit.deviance + TOLERANCE or pair not in self.seen
        self.seen.add(pair)
        self._keep(fit)
        if not fit.converged:
            fall = begin.deviance - fit.deviance
            expected = fit.deviance - min(fall, fit.predicted_fall, MAX_MISS)
            self._propose(fit.ar, fit.ma, expected, fit)
        excess = min(self._excess(name, pair, fit.deviance) for name in self.criteria)
        if fresh and excess < MAX_PARENT_EXCESS:
            self._neighbours(fit)
            slopes += 1
        return slopes * (1 + self.likelihood.runs // MAX_FEW_RUNS)

    def _neighbours(self, fit: Maximum) -> None:
        """Models with one coefficient more or less, and with one narrow line more."""
        p, q = fit.order
        if p + 2 <= self.max_p and q + 2 <= self.max_q:
            self._lines(fit)
        for root, other in cancelling(fit.ar, fit.ma, 2.0 * MAX_CANCELLING_DISTANCE):
            fewer = 1 + (root.imag != 0.0)
            if (p - fewer, q - fewer) in self.seen:
                continue
            less = start(self.likelihood, without_root(fit.ar, root), -without_root(-fit.ma, other))
            self._propose(less.ar, less.ma, less.deviance - GAIN_MARGIN)
        # One slope at the model with a zero coefficient more on both sides serves all.
        wide = self.likelihood.slope(np.append(fit.ar, 0.0), np.append(fit.ma, 0.0))
        own = [*range(p), *range(p + 1, p + 1 + q)]
        both = np.concatenate((fit.ar, [0.0], fit.ma, [0.0]))
        for larger_p, extra in ((p + 1, p), (p, p + q + 1)):
            index = np.array(sorted([*own, extra]))
            step = -np.linalg.solve(_ridged(wide.curvature, index), wide.gradient[index])
            gain = -0.5 * float(wide.gradient[index] @ step)
            more = both[index] + step
            ar, ma = more[:larger_p], more[larger_p:]
            if not is_stationary_and_invertible(ar, ma):
                gain = min(gain, GAIN_MARGIN)  # nothing is known of the likelihood out there
            self._propose(ar, ma, fit.deviance - gain - 0.5)
        if own:
            inverse = np.asarray(np.linalg.inv(_ridged(wide.curvature, np.array(own))), float)
            self._smaller(fit, inverse)

    def _lines(self, fit: Maximum) -> None:
        """Models with one narrow line more, and with the first few lines at once."""
        e = self.likelihood.innovations(fit.ar, fit.ma, fit.at.coefficients)
        several, expected, angles = (fit.ar, fit.ma), fit.deviance - LINE_GAIN_MARGIN, np.empty(0)
        for line in narrow_factors(e):
            ar, ma = with_line(fit.ar, fit.ma, line)
            self._propose(ar, ma, fit.deviance - line.gain - LINE_GAIN_MARGIN)
            if np.any(np.abs(angles - line.angle) < MIN_LINE_DISTANCE / self.likelihood.size):
                continue
            angles = np.append(angles, line.angle)
            several, expected = with_line(*several, line), expected - line.gain
            if angles.size > 1:
                self._propose(*several, expected)

    def _smaller(self, fit: Maximum, inverse: Array) -> None:
        """Models without the last AR or MA coefficient, the others where they are then best."""
        p, q = fit.order
        values = np.concatenate((fit.ar, fit.ma))
        for there, smaller_p, last in ((p, p - 1, p - 1), (q, p, p + q - 1)):
            if there:
                multiplier = values[last] / inverse[last, last]
                rest = np.delete(values - inverse[:, last] * multiplier, last)
                rise = 0.5 * values[last] * multiplier - 0.5
                self._propose(rest[:smaller_p], rest[smaller_p:], fit.deviance + rise)


def _ridged(curvature: Array, index: NDArray[np.intp]) -> Array:
    """A block of the curvature; a ridge in place of what cancelling roots leave undetermined."""
    block = curvature[np.ix_(index, index)]
    return np.asarray(block + 1e-9 * np.trace(block) / index.size * np.eye(index.size))
