"""What must be known of a series before its order is believed: outliers, and unit roots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtri

from thermaltool.errors import FitError
from thermaltool.timeseries.ar import burg
from thermaltool.timeseries.lagged import lagged_products, lagged_sums
from thermaltool.timeseries.record import Record

Array = NDArray[np.float64]

_MAD_TO_SIGMA = 1.482602218505602  # 1 / Φ⁻¹(3/4)
_CLIPPED = 5.0  # sigmas of the level at which samples are cut for the robust fit
_MARGIN = 1.25  # over the largest of so many Gaussian innovations
_SHARE = 0.01  # of the samples that may stand out; more is the nature of the series
_LARGEST_ORDER = 20

LARGEST = 1e100

# 5 % points of the t statistic of the level for long records: J. G. MacKinnon, Critical values for
# cointegration tests (1991), by the degree of the trend.
DICKEY_FULLER = {-1: -1.94, 0: -2.86, 1: -3.41}


# A sample that the few before it give to this share of the deviation is computed, not measured.
PREDICTED, _BEFORE = 1e-9, 8


def check_size(record: Record) -> None:
    """Refuse numbers whose squares are none.

    Raises
    ------
    FitError
    """
    largest = float(np.abs(record.values).max())
    spread = float(np.ptp(record.values))
    if largest > LARGEST or 0.0 < spread < 1.0 / LARGEST:
        told = largest if largest > LARGEST else spread
        raise FitError(f"sums of squares of {told:.3g} are out of range: take another unit")


def is_computed(record: Record) -> bool:
    """Whether every sample follows from the eight before it to rounding: a line, a sine, a period.

    There is no innovation then, and no order of a noise model.
    """
    runs = [run for run in record.runs if run.size > 4 * _BEFORE]
    # A constant has a message of its own.
    if not any(np.ptp(run) for run in runs):
        return False
    for run in sorted(runs, key=len):
        windows = np.lib.stride_tricks.sliding_window_view(run - run.mean(), _BEFORE + 1)
        before = np.column_stack([windows[:, :-1], np.ones(len(windows))])
        # A short stretch tells of most records at once that they are measured.
        for part in (slice(0, 50 * _BEFORE), slice(None)):
            rows, after = before[part], windows[part, -1]
            left = after - rows @ np.linalg.lstsq(rows, after, rcond=None)[0]
            if np.abs(left).max() > PREDICTED * max(float(np.std(run)), 1e-300):
                return False
    return True


def find_outliers(record: Record) -> NDArray[np.intp]:
    """Samples that stand alone against a robust AR model; rows of `record.values`.

    An additive outlier at t shows in the innovations as the AR weights from t on; its size is
    estimated from all of them, and the largest of outliers and shocks is taken out first (Chang,
    Tiao, Chen, Technometrics 30 (1988) 193). A shock, which the series follows, is no outlier.
    Where more than a hundredth stands out, none is reported: that is what the series is like.
    """
    if record.size < 20:
        return np.empty(0, np.intp)
    x = record.values - np.median(record.values)
    scale = _MAD_TO_SIGMA * float(np.median(np.abs(x)))
    limit = max(1, int(_SHARE * record.size))
    if scale == 0.0:  # most samples are the same: the others stand out, if they are few
        other = np.flatnonzero(x)
        return other if other.size <= limit else np.empty(0, np.intp)
    clipped = record.with_values(np.clip(x, -_CLIPPED * scale, _CLIPPED * scale))
    longest = max(run.size for run in record.runs)
    model = burg(clipped, min(_LARGEST_ORDER, longest // 4))
    weights = np.concatenate(([1.0], -model.coefficients[model.best]))
    e = np.concatenate([lfilter(weights, [1.0], run) for run in record.with_values(x).runs])
    # The first samples of a run are predicted by nothing: they vary as the series does.
    unpredicted = _first_samples(record, weights.size - 1)
    e[unpredicted] *= min(_MAD_TO_SIGMA * float(np.median(np.abs(e))) / scale, 1.0)
    threshold = -_MARGIN * float(ndtri(0.005 / record.size))
    found: list[int] = []
    shocks = 0
    # Near the end fewer of its consequences are there.
    power = np.cumsum(weights**2)[np.minimum(np.arange(e.size)[::-1], weights.size - 1)]
    while True:
        sigma = _MAD_TO_SIGMA * float(np.median(np.abs(e)))
        if sigma == 0.0:
            return np.empty(0, np.intp)
        padded = np.concatenate((e, np.zeros(weights.size - 1)))
        effect = np.correlate(padded, weights, "valid") / power
        additive, shock = np.abs(effect) * np.sqrt(power) / sigma, np.abs(e) / sigma
        worst, largest = int(np.argmax(additive)), int(np.argmax(shock))
        if additive[worst] <= threshold or worst in found or shocks > limit:
            return np.sort(np.array(found, np.intp))
        if shock[largest] > additive[worst]:
            # The series follows it; what it explains must not be laid on a sample beside it.
            e[largest], shocks = 0.0, shocks + 1
            continue
        if len(found) == limit:
            return np.empty(0, np.intp)
        found.append(worst)
        end = min(worst + weights.size, e.size)
        e[worst:end] -= effect[worst] * weights[: end - worst]


def _first_samples(record: Record, count: int) -> NDArray[np.bool_]:
    """Whether a row is one of the first `count` of its run, ndarray (size,)."""
    return np.concatenate([np.arange(run.size) < count for run in record.runs])


def unit_root_statistic(record: Record, degree: int = 0) -> float:
    """Augmented Dickey-Fuller t statistic on the longest run; NaN where it is too short.

    Δx_t on a constant (and t), x_{t-1} and lagged differences, as many as the AR order of the
    differences by AIC. Below `DICKEY_FULLER` a unit root is rejected at 5 %.
    """
    run = max(record.runs, key=lambda each: each.size)
    if run.size < 30 or np.ptp(run) == 0.0:
        return float("nan")
    x = run - run.mean()
    if degree == 1:
        t = np.linspace(-1.0, 1.0, x.size)
        x = x - t * float(t @ x) / float(t @ t)
    change = np.diff(x)
    scale = float(np.abs(x).max())
    lags = burg(Record((change,), (0,), (-1,)), min(12, x.size // 10)).best
    first = max(lags, 1)
    # Products of (Δ_t, Δ_{t-1}, ..., Δ_{t-k}), of x_{t-1}, and a constant.
    dd = lagged_products(change, change, lags, lags, first)
    level = x[:-1]
    dx = lagged_products(change, level, lags, 0, first)[:, 0]
    xx = lagged_products(level, level, 0, 0, first)[0, 0]
    sums = lagged_sums(change, lags, first)
    rows = change.size - first
    size = lags + 2
    gram, right = np.empty((size, size)), np.empty(size)
    gram[0, 0], right[0] = xx, dx[0]
    gram[0, 1 : lags + 1] = gram[1 : lags + 1, 0] = dx[1:]
    gram[1 : lags + 1, 1 : lags + 1], right[1 : lags + 1] = dd[1:, 1:], dd[0, 1:]
    gram[-1, 0] = gram[0, -1] = level[first:].sum()
    gram[-1, 1:-1] = gram[1:-1, -1] = sums[1:]
    gram[-1, -1], right[-1] = rows, sums[0]
    gram[np.diag_indices(size)] += 1e-14 * scale**2 * rows
    inverse = np.linalg.inv(gram)
    beta = inverse @ right
    variance = max(float(dd[0, 0] - beta @ right), 0.0) / max(rows - size, 1)
    error = np.sqrt(variance * abs(inverse[0, 0]))
    return float(beta[0] / error) if error > 0.0 else float("nan")
