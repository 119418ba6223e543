"""Start values for one order: regressions, smaller models enlarged, narrow lines.

The likelihood of an ARMA model has many maxima where roots nearly cancel, and over regular holes it
is flat or a saddle at zero coefficients; a good maximum is found from many places.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.timeseries.ar import yule_walker
from thermaltool.timeseries.hannan import hannan_rissanen
from thermaltool.timeseries.innovations import innovations
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.maximum import Maximum, climb, start
from thermaltool.timeseries.narrow import narrow_factors, with_line
from thermaltool.timeseries.runs import bridged, runs, samples, with_samples

Array = NDArray[np.float64]
Coefficients = tuple[Array, Array]

MAX_RUNS = 20  # each run costs a filter: above, no smaller models are fitted for a start
MAX_STEPS = 20  # of the climb of a smaller model, which only has to be near its maximum
TOLERANCE = 1e-2  # [deviance], a hundredth of what tells two models apart
MAX_LINES = 3  # narrow lines that are tried, those of the largest gain


def all_starts(likelihood: ArmaLikelihood, p: int, q: int) -> list[Maximum]:
    """Every start for (p, q), each at its likelihood.

    Parameters
    ----------
    likelihood : ArmaLikelihood
    p, q : int
    """
    found = _regressions(likelihood.detrended, p, q)
    if likelihood.runs <= MAX_RUNS:
        found += _enlarged(likelihood, p, q)
    return [start(likelihood, ar, ma) for ar, ma in found]


def _regressions(centred: Record, p: int, q: int) -> list[Coefficients]:
    """No correlation, and what each regression finds; over holes also on straight lines.

    Where every second sample is missing, the record itself tells nothing of the odd lags.
    """
    found = [(np.zeros(p), np.zeros(q))]
    methods: list[Callable[[Record], Coefficients]] = [lambda x: innovations(x, p, q)]
    methods += [lambda x, c=c: _hannan(x, p, q, c) for c in (False, True)]  # type: ignore[misc]
    if q == 0:
        methods = [lambda x: (yule_walker(x, p).coefficients[p], np.empty(0))]
    lines = bridged(centred)
    for record in (centred,) if lines is centred else (centred, lines):
        for method in methods:
            try:
                found.append(method(record))
            except (FitError, np.linalg.LinAlgError):
                continue
    if q:
        with suppress(FitError, np.linalg.LinAlgError):
            ar, ma = _hannan(summed(centred), p, q - 1, True)
            found.append((ar, as_difference(ma)))
    if lines is not centred and p and q:  # the lines are smoother than what they bridge
        ar = yule_walker(lines, p).coefficients[p]
        found += [(ar, np.eye(1, q)[0] * rough) for rough in (0.0, -0.5)]
    return found


def summed(record: Record) -> Record:
    """The running sum of each run, less its mean."""
    values = samples(record)
    sums = np.full(values.size, np.nan)
    for run in runs(record):
        total = np.cumsum(values[run])
        sums[run] = total - total.mean()
    return with_samples(record, sums)


def as_difference(ma: Array) -> Array:
    """`ma` of the series whose running sum has `ma`: a root at 1 more."""
    return np.convolve(np.concatenate(([1.0], ma)), [1.0, -0.99])[1:]


def _hannan(record: Record, p: int, q: int, correct: bool) -> Coefficients:
    fit = hannan_rissanen(record, p, q, None, correct)
    return fit.ar, fit.ma


def _enlarged(likelihood: ArmaLikelihood, p: int, q: int) -> list[Coefficients]:
    """The models with one coefficient less and a zero; those with a line less and the line."""
    found = []
    if p and q:
        less, more = _fitted(likelihood, p - 1, q), _fitted(likelihood, p, q - 1)
        found += [(np.append(less.ar, 0.0), less.ma), (more.ar, np.append(more.ma, 0.0))]
    for size in (1, 2):
        if min(p, q) >= size:
            base = _fitted(likelihood, p - size, q - size)
            e = likelihood.innovations(base.ar, base.ma, base.at.coefficients)
            lines = [line for line in narrow_factors(e) if line.ar.size == size]
            found += [with_line(base.ar, base.ma, line) for line in lines[:MAX_LINES]]
    return found


def _fitted(likelihood: ArmaLikelihood, p: int, q: int) -> Maximum:
    begins = [start(likelihood, ar, ma) for ar, ma in _regressions(likelihood.detrended, p, q)]
    best = min(begins, key=lambda each: each.deviance)
    return climb(likelihood, best, MAX_STEPS, TOLERANCE)[0]
