"""What a user would pick instead of `diagnose`, each method with what it says of a log.

Settings of the peers are chosen by cross-validation over blocks of the training log.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from peers_cases import Case, Float
from pysindy import STLSQ, PolynomialLibrary, SINDy, SmoothedFiniteDifference
from scipy.signal import correlate
from scipy.stats import chi2, norm
from sklearn.ensemble import HistGradientBoostingRegressor, RandomForestRegressor
from sklearn.linear_model import Ridge
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from thermaltool.fitting.calibrate import calibrate
from thermaltool.fitting.calibration_plan import CalibrationPlan
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.units import parse_channel

# Moving averages of every channel; blocks of the cross-validation; level of the residual tests.
AVERAGES, BLOCKS, LEVEL = 6, 4, 0.01
# Longest moving average over the duration of the training log.
REACHES = (0.0, 1 / 30, 1 / 10, 1 / 5, 1 / 2, 1.0)
# A free run this many standard deviations of the training log away has diverged.
DIVERGED = 20.0


@dataclass(frozen=True)
class Answer:
    """Levels of every output on all rows of the held-out record, and what the method says."""

    predicted: Float
    says: str
    named: tuple[str, ...] = ()


# ---------------------------------------------------------------- the model, and residual tests


def fit_plain(case: Case, records: Sequence[Record]) -> Model:
    """The model as `calibrate` fits it, one response for each drive and output."""
    displaced = [parse_channel(o).dimension in ("length", "angle") for o in case.outputs]
    plan = CalibrationPlan(
        case.drives,
        tuple(o for o, d in zip(case.outputs, displaced, strict=True) if not d),
        tuple(o for o, d in zip(case.outputs, displaced, strict=True) if d),
        case.kinds,
        case.reference,
    )
    # A model that was fitted to the log under examination is free to be fitted again.
    return calibrate(records, plan)


def simulated(case: Case, model: Model, record: Record) -> Float:
    """Levels of the outputs by a model."""
    outputs = model.simulate(record)
    rests = {o.channel: o.offset for o in model.outputs}
    columns = []
    for name in case.outputs:
        rest, first = rests[name], record.columns[name][0]
        columns.append(outputs[name] + (0.0 if rest == "first" else rest - first))
    return np.column_stack(columns)


def even(record: Record, table: Float) -> tuple[Float, Float]:
    """Rows at even times: bursts become their means, a row each."""
    steps = np.diff(record.time)
    short = float(np.median(steps))
    burst = np.concatenate([[0], np.cumsum(steps > 3 * short)])
    if burst[-1] == 0:
        return record.time, table
    counts = np.bincount(burst)
    means = [np.bincount(burst, column) / counts for column in (record.time, *table.T)]
    grid = np.linspace(means[0][0], means[0][-1], len(counts))
    return grid, np.column_stack([np.interp(grid, means[0], column) for column in means[1:]])


def autocorrelation(x: Float) -> Float:
    """All lags, up to the first that is no longer outside chance."""
    full = correlate(x - x.mean(), x - x.mean(), method="fft")[len(x) - 1 :]
    r = full / full[0] if full[0] > 0 else np.zeros(len(x))
    small = np.flatnonzero(np.abs(r) < 2 / np.sqrt(len(x)))
    return np.asarray(r[: small[0]] if len(small) else r)


def residual_tests(case: Case, plain: Model) -> Answer:
    """Ljung-Box for whiteness and cross-correlation with every input, with effective sample sizes.

    Bartlett: the autocorrelation of a series with autocorrelation r scatters by Σr²/n, its
    cross-correlation with x by Σ r_x r_e / n. Lags up to the slowest time constant; Bonferroni
    over lags, inputs and outputs.
    """
    record = case.training
    error = case.table(record, case.outputs) - simulated(case, plain, record)
    at, columns = even(record, np.column_stack([error, case.table(record, case.inputs)]))
    errors, inputs = columns[:, : len(case.outputs)].T, columns[:, len(case.outputs) :].T
    n = len(at)
    reach = min(n // 4, int(slowest(plain, record) / (at[1] - at[0])) + 1)
    limit = norm.isf(LEVEL / (2 * reach * inputs.shape[0] * errors.shape[0]))
    coloured, strongest = 0, (0.0, "")
    for e in errors:
        own = autocorrelation(e)
        size = n / (2 * float(np.sum(own**2)) - 1)
        m = min(20, n // 5)
        r = correlate(e - e.mean(), e - e.mean(), method="fft")[n : n + m] / (n * np.var(e))
        statistic = size * (size + 2) * np.sum(r**2) / max(size - 1, 1)
        coloured += bool(statistic > chi2.isf(LEVEL / len(errors), m))
        for name, x in zip(case.inputs, inputs, strict=True):
            if not np.ptp(x) > 0:
                continue
            other = autocorrelation(x)
            common = min(len(own), len(other))
            spread = max(2 * float(own[:common] @ other[:common]) - 1, 1.0)
            cross = correlate(e - e.mean(), x - x.mean(), method="fft")[n - 1 : n - 1 + reach]
            z = float(np.max(np.abs(cross))) / (n * np.std(e) * np.std(x)) * np.sqrt(n / spread)
            strongest = max(strongest, (z, name))
    trace = f"trace of {strongest[1]}" if strongest[0] > limit else "no trace of an input"
    says = f"not white: {coloured} of {len(errors)} outputs; {trace}"
    return Answer(simulated(case, plain, case.held_out), says)


def recalibrated(case: Case, plain: Model) -> Answer:
    """The same model, fitted again with the log under examination."""
    model = fit_plain(case, [case.calibration, case.training])
    return Answer(simulated(case, model, case.held_out), "other parameters")


def slowest(plain: Model, record: Record) -> float:
    """Slowest time constant that the record can show [s]."""
    duration = float(record.time[-1] - record.time[0])
    return min(max(t.response.slowest() for t in plain.terms), duration)


# ---------------------------------------------------------------- black boxes


def features(case: Case, record: Record, reach: float) -> Float:
    """Every input now, and its causal moving averages with time constants up to `reach` [s].

    Returns
    -------
    ndarray, shape (rows, 1 or 1 + AVERAGES, inputs)
    """
    inputs = case.table(record, case.inputs)
    if not reach:
        return inputs[:, None]
    period = float(np.median(np.diff(case.training.time)))
    constants = np.geomspace(2 * period, reach, AVERAGES)
    keep = np.exp(-np.diff(record.time)[:, None, None] / constants[:, None])
    out = np.empty((len(record.time), 1 + AVERAGES, inputs.shape[1]))
    out[:, 0] = inputs
    # At rest before the first row; a channel without a known rest was where it is.
    out[0, 1:] = np.where(np.arange(inputs.shape[1]) < len(case.drives), 0.0, inputs[0])
    for k in range(1, len(inputs)):
        out[k, 1:] = keep[k - 1] * out[k - 1, 1:] + (1 - keep[k - 1]) * inputs[k]
    return out


def ridges() -> list[Any]:
    return [make_pipeline(StandardScaler(), Ridge(alpha)) for alpha in (1.0, 0.01, 100.0)]


def forests(seed: int) -> list[Any]:
    return [
        RandomForestRegressor(100, min_samples_leaf=leaf, max_features=0.4, random_state=seed)
        for leaf in (10, 2, 40)
    ]


def boosters(seed: int) -> list[Any]:
    return [
        HistGradientBoostingRegressor(
            max_iter=rounds,
            learning_rate=0.05,
            max_leaf_nodes=leaves,
            early_stopping=False,
            random_state=seed,
        )
        for rounds, leaves in ((400, 4), (100, 4), (100, 15), (400, 15))
    ]


def blocks(n: int) -> list[NDArray[np.int64]]:
    return np.array_split(np.arange(n), BLOCKS)


def black_box(
    case: Case, plain: Model, choices: Sequence[Any], seed: int, on_model: bool = False
) -> Answer:
    """Regression on lags; `on_model`: of what the plain model leaves, added to it.

    The reach of the lags is chosen first, with the first of the choices, then the choice.
    """
    base = [
        simulated(case, plain, r) if on_model else np.zeros((len(r.time), len(case.outputs)))
        for r in (case.training, case.held_out)
    ]
    target = case.table(case.training, case.outputs) - base[0]
    scale = target.std(axis=0) + 1e-12
    target = target / scale
    # One regression for each output: some kinds take one target, some drop its axis.
    models = [MultiOutputRegressor(model) for model in choices]

    def table(record: Record, reach: float) -> Float:
        lags = features(case, record, reach)
        return lags.reshape(len(lags), -1)

    def left(model: MultiOutputRegressor, lags: Float) -> float:
        total = 0.0
        for block in blocks(len(lags)):
            rest = np.setdiff1d(np.arange(len(lags)), block)
            model.fit(lags[rest], target[rest])
            total += float(np.sum((model.predict(lags[block]) - target[block]) ** 2))
        return total

    duration = float(case.training.time[-1] - case.training.time[0])
    tables = {reach: table(case.training, reach * duration) for reach in REACHES}
    reach = min(REACHES, key=lambda each: left(models[0], tables[each]))
    flat = tables[reach]
    best = min(models, key=lambda model: left(model, flat)).fit(flat, target)
    found = best.predict(table(case.held_out, reach * duration))
    order = np.random.default_rng(seed).permutation(len(flat))
    losses = []
    for k in range(len(case.inputs)):
        mixed = flat.copy()
        mixed[:, k :: len(case.inputs)] = flat[order, k :: len(case.inputs)]
        losses.append(float(np.mean((best.predict(mixed) - target) ** 2)))
    share = np.array(losses) / sum(losses)
    top = np.argsort(share)[::-1][:2]
    leans = ", ".join(f"{case.inputs[k]} {100 * share[k]:.0f} %" for k in top)
    return Answer(base[1] + found * scale, f"lags to {reach * duration:.0f} s; leans on {leans}")


# ---------------------------------------------------------------- sparse regression


@dataclass(frozen=True)
class Sparse:
    """dy/dt = coefficients · monomials of (y, inputs), everything scaled; its free run."""

    powers: NDArray[np.int64]
    coefficients: Float

    def run(self, y: Float, inputs: Float, dt: float) -> Float:
        """Runge-Kutta 4 from `y` over evenly sampled inputs; NaN from where it diverges."""
        out = np.full((len(inputs), len(y)), np.nan)
        middle = (inputs[1:] + inputs[:-1]) / 2

        def slope(y: Float, u: Float) -> Float:
            monomials = np.prod(np.concatenate([y, u]) ** self.powers, axis=1)
            return np.asarray(self.coefficients @ monomials)

        out[0] = y
        for k in range(len(inputs) - 1):
            a = slope(y, inputs[k])
            b = slope(y + dt / 2 * a, middle[k])
            c = slope(y + dt / 2 * b, middle[k])
            d = slope(y + dt * c, inputs[k + 1])
            y = y + dt / 6 * (a + 2 * b + 2 * c + d)
            if not np.all(np.abs(y) < DIVERGED):
                break
            out[k + 1] = y
        return out


def sparse_regression(case: Case, plain: Model) -> Answer:
    """PySINDy: sequentially thresholded least squares on a polynomial library of (y, u, extras).

    Degree, threshold and smoothing by the free run on left-out blocks.
    """
    unit = slowest(plain, case.training)
    levels = np.column_stack(
        [case.table(case.training, case.outputs), case.table(case.training, case.inputs)]
    )
    at, columns = even(case.training, levels)
    scale = columns.std(axis=0)
    scale[scale == 0] = 1.0
    count, dt = len(case.outputs), (at[1] - at[0]) / unit
    measured, inputs = np.split(columns / scale, [count], axis=1)

    def fit(setting: tuple[int, float, int], rows: NDArray[np.int64]) -> tuple[Sparse, Float]:
        degree, threshold, window = setting
        smoother = SmoothedFiniteDifference(smoother_kws={"window_length": window})
        slope = np.asarray(smoother(measured, dt))
        smooth = np.asarray(smoother.smoothed_x_)
        model = SINDy(STLSQ(threshold=threshold, alpha=1e-3), PolynomialLibrary(degree=degree))
        with warnings.catch_warnings():
            # "all coefficients eliminated" and near-singular libraries: judged by their free run.
            warnings.simplefilter("ignore")
            model.fit(smooth[rows], dt, slope[rows], inputs[rows])
        found = Sparse(np.asarray(model.feature_library.powers_), np.asarray(model.coefficients()))
        return found, smooth

    def left(setting: tuple[int, float, int]) -> float:
        total = 0.0
        for block in blocks(len(at)):
            found, smooth = fit(setting, np.setdiff1d(np.arange(len(at)), block))
            run = found.run(smooth[block[0]], inputs[block], dt)
            total += float(np.sum((run - measured[block]) ** 2))
        return total if np.isfinite(total) else np.inf

    settings = list(product((1, 2), (0.01, 0.03, 0.1, 0.3, 1.0), (11, 41)))
    scores = [left(s) for s in settings]
    best = settings[int(np.argmin(scores))]
    found, smooth = fit(best, np.arange(len(at)))
    begin = case.begin
    ahead = case.held_out.rows(slice(begin, None))
    unseen = case.table(case.held_out, case.inputs)[begin:]
    grid, future = even(ahead, unseen)
    # On from the end of the training log, or from rest.
    start = smooth[-1] if begin else np.zeros(count)
    run = found.run(start, future / scale[count:], float(grid[1] - grid[0]) / unit)
    predicted = np.full((len(case.held_out.time), count), np.nan)
    for k in range(count):
        predicted[begin:, k] = np.interp(ahead.time, grid, run[:, k]) * scale[k]
    kept = found.powers[np.any(found.coefficients != 0, axis=0), count:]
    used = np.asarray(kept.any(axis=0))
    terms = int(np.count_nonzero(found.coefficients))
    other = [c for c, u in zip(case.inputs, used, strict=True) if u and c in case.extras]
    says = f"degree {best[0]}, {terms} terms; extra channels: {', '.join(other) or 'none'}"
    if not np.isfinite(min(scores)):
        says = f"every setting diverges on left-out blocks; {says}"
    if not np.all(np.isfinite(run)):
        lost = float(grid[np.flatnonzero(~np.isfinite(run[:, 0]))[0]] - grid[0])
        says = f"diverges after {lost:.0f} s; {says}"
    return Answer(predicted, says)


# ---------------------------------------------------------------- ours


def ours(case: Case, plain: Model) -> Answer:
    """`thermaltool diagnose`: the plain model, extended by the causes that it names."""
    from thermaltool.diagnosis.diagnose import diagnose

    log = case.training
    seen = {c: log.columns[c] for c in (*case.inputs, *case.outputs)}
    found = diagnose(plain, [Record(log.time, seen, digest=log.digest)])
    causes = tuple(f"{c.effect.name} ({c.effect.channel})" for c in found.causes)
    says = "adequate" if found.adequate else "not adequate"
    return Answer(simulated(case, found.model, case.held_out), says, causes)
