"""AR models of every order in one pass: Burg, Yule-Walker, least squares.

Each pass gives the coefficients of every order and its innovation variance. The criterion of these
tables is that of R's `ar`: N ln(variance) + 2 (order + 1), the innovation variance without the
correction for degrees of freedom.

Own recursions, because one pass has to serve every order and any number of runs:
`statsmodels.tsa.stattools.pacf_burg` takes one series without a hole, and 118 ms for orders up to
30 of 10⁵ samples where this takes 14; its `acovf` takes 25 ms where this takes 0.8. Its
`levinson_durbin` is as fast as the recursion here, but the import adds 0.6 s and 78 MB to an
`order` that computes for 0.1 s. The tests hold all of them together.

Sources: J. P. Burg (1967) by way of S. L. Marple, Digital Spectral Analysis (1987), 8.5;
P. J. Brockwell, R. A. Davis, Introduction to Time Series and Forecasting (2002), 5.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.record import Record
from thermaltool.signals.criteria import Criteria
from thermaltool.timeseries.lagged import inner, lagged_products
from thermaltool.timeseries.runs import pieces, places, runs, samples

Array = NDArray[np.float64]

# Periods per sample above which a series is so sparse that pairs across its holes are too few.
MAX_PERIODS_PER_SAMPLE = 4


@dataclass(frozen=True)
class ArOrders:
    """AR fits of order 0, 1, ..., P.

    Attributes
    ----------
    coefficients : tuple of ndarray (k,)
        One per order k.
    variance : ndarray (P + 1,)
        Innovation variance [unit²].
    samples : int
        N.
    """

    coefficients: tuple[Array, ...]
    variance: Array
    samples: int

    @property
    def criteria(self) -> tuple[Criteria, ...]:
        """Of every order, with a mean: AIC is N ln(variance) + 2 (order + 1)."""
        deviance = (self.samples * np.log(self.variance)).tolist()
        return tuple(Criteria(d, k, self.samples) for k, d in enumerate(deviance, 1))

    @property
    def best(self) -> int:
        """Order of the least AIC."""
        return int(np.argmin([each.aic for each in self.criteria]))

    def whitening(self, order: int) -> Array:
        """1 - ar B ..., ndarray (order + 1,): the filter that leaves the innovations."""
        return np.concatenate(([1.0], -self.coefficients[order]))


def burg(record: Record, max_order: int) -> ArOrders:
    """Burg's method: reflections from forward and backward errors of all runs together.

    Parameters
    ----------
    record : Record
        Even, of one channel without mean; runs shorter than an order do not count for it.
    max_order : int
        At least 0, below the length of the longest run.

    Raises
    ------
    FitError
        No run is longer than `max_order`.
    """
    all_runs = _long_enough(record, max_order)
    forward = [run.copy() for run in all_runs]
    backward = [run.copy() for run in all_runs]
    size = sum(run.size for run in all_runs)
    orders = _Levinson(sum(inner(run, run) for run in all_runs) / size)
    for _ in range(max_order):
        forward = [f[1:] for f in forward if f.size > 1]
        backward = [b[:-1] for b in backward if b.size > 1]
        cross = sum(inner(f, b) for f, b in zip(forward, backward, strict=True))
        power = sum(inner(f, f) + inner(b, b) for f, b in zip(forward, backward, strict=True))
        r = 2.0 * cross / power if power > 0.0 else 0.0
        for f, b in zip(forward, backward, strict=True):
            before = f * r
            f -= r * b
            b -= before
        orders.reflect(r)
    return _orders(orders.coefficients, orders.variance, size)


def yule_walker(record: Record, max_order: int) -> ArOrders:
    """Levinson-Durbin recursion on the autocovariances (sums over pairs, divided by N).

    Parameters
    ----------
    record : Record
        Even, of one channel without mean.
    max_order : int
        At least 0, below the length of the longest run.

    Raises
    ------
    FitError
        No run is longer than `max_order`.
    """
    size = sum(run.size for run in _long_enough(record, max_order))
    covariance = autocovariance(record, max_order)
    orders = _Levinson(float(covariance[0]))
    for k in range(1, max_order + 1):
        predicted = orders.coefficients[-1] @ covariance[k - 1 : 0 : -1]
        orders.reflect((covariance[k] - predicted) / orders.variance[-1])
    return _orders(orders.coefficients, orders.variance, size)


def least_squares(record: Record, max_order: int) -> ArOrders:
    """Regression on the last k values and a constant, on the samples that have all of them.

    As R's `ar.ols`, order k uses the samples after the first k of each run, and its criterion
    counts all N. All Gram matrices come from one of the largest order by taking the ends in.

    Parameters
    ----------
    record : Record
        Even, of one channel.
    max_order : int
        At least 0, below the length of the longest run.

    Raises
    ------
    FitError
        No run is longer than `max_order`; a regression has no unique answer.
    """
    all_runs = _long_enough(record, max_order)
    gram = np.zeros((max_order + 2, max_order + 2))
    for run in all_runs:
        if run.size <= max_order:
            continue
        gram[1:, 1:] += lagged_products(run, run, max_order, max_order, max_order)
        ones = np.ones(run.size)
        gram[0, 1:] += lagged_products(ones, run, 0, max_order, max_order)[0]
        gram[0, 0] += run.size - max_order
    gram[1:, 0] = gram[0, 1:]
    coefficients, variance = [], []
    for k in range(max_order, -1, -1):
        if k < max_order:
            # Lower orders see one more sample of each run.
            gram = gram[:-1, :-1]
            rows = [np.concatenate(([1.0], run[k::-1])) for run in all_runs if run.size > k]
            gram = gram + sum(np.outer(row, row) for row in rows)
        index = np.r_[0, 2 : k + 2]
        try:
            beta = np.linalg.solve(gram[np.ix_(index, index)], gram[index, 1])
        except np.linalg.LinAlgError as error:
            raise FitError(f"least squares of order {k} has no unique answer") from error
        coefficients.append(beta[1:])
        variance.append(float(gram[1, 1] - beta @ gram[index, 1]) / gram[0, 0])
    size = sum(run.size for run in all_runs)
    return _orders(coefficients[::-1], variance[::-1], size)


def autocovariance(record: Record, lags: int) -> Array:
    """Autocovariances of a record without mean, divided by N, ndarray (lags + 1,) [unit²].

    Pairs across a hole count, those across segments do not; where samples are missing each lag is
    weighted by its pairs, so that the estimate is not drawn to zero.

    Parameters
    ----------
    record : Record
        Even, of one channel without mean.
    lags : int
    """
    values, rows = samples(record), runs(record)
    size, lag = sum(run.stop - run.start for run in rows), range(lags + 1)
    clock = places(record)
    span = float(clock[rows[-1].stop - 1] - clock[rows[0].start]) + 1.0
    if len(rows) == 1 or span > MAX_PERIODS_PER_SAMPLE * size:
        return np.array([sum(_lagged(values[run], k) for run in rows) for k in lag]) / size
    parts = [values[part] for part in record.segments]
    known = [np.isfinite(part).astype(float) for part in parts]
    filled = [np.nan_to_num(part) for part in parts]
    sums = np.array([sum(_lagged(part, k) for part in filled) for k in lag])
    pairs = np.array([max(sum(_lagged(part, k) for part in known), 1.0) for k in lag])
    return np.asarray(sums / pairs * (span - np.arange(lags + 1.0)) / span)


def _lagged(x: Array, lag: int) -> float:
    return inner(x[lag:], x[: x.size - lag]) if lag < x.size else 0.0


class _Levinson:
    """Coefficients and innovation variance of orders 0, 1, ..., by one reflection after another."""

    def __init__(self, variance: float) -> None:
        self.coefficients, self.variance = [np.empty(0)], [variance]

    def reflect(self, r: float) -> None:
        """Go on to the next order, whose last coefficient is `r`."""
        phi = self.coefficients[-1]
        self.coefficients.append(np.append(phi - r * phi[::-1], r))
        self.variance.append(self.variance[-1] * (1.0 - r * r))


def _orders(coefficients: list[Array], variance: list[float], size: int) -> ArOrders:
    return ArOrders(tuple(coefficients), np.maximum(variance, np.finfo(float).tiny), size)


def _long_enough(record: Record, max_order: int) -> list[Array]:
    """All runs, of which at least one has to be longer than `max_order`."""
    all_runs = pieces(record)
    longest = max(run.size for run in all_runs)
    if max_order >= longest:
        raise FitError(
            f"order {max_order} needs more than {max_order} samples in a row; there are {longest}"
        )
    return all_runs
