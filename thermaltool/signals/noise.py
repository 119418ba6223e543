"""Noise of one channel: white level, drift, lines, outliers, all apart from the slow signal."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtr

from thermaltool.errors import counted
from thermaltool.signals.allan import AllanDeviation, allan_deviation
from thermaltool.signals.detrend import (
    block_variance,
    cutoff_per_sample,
    difference_sigma,
    find_outliers,
    longest_level_stretch,
    separate,
    smooth_blocks,
)
from thermaltool.signals.drift import DriftFit, fit_drift, model_allan, model_density
from thermaltool.signals.resolution import resolution_step
from thermaltool.signals.spectrum import Line, Spectrum, find_lines, welch_spectrum

Array = NDArray[np.float64]

MIN_SAMPLES = 50  # readings: with fewer, neither level nor drift has an interval of use
WINDOW = 33  # samples of the local polynomial
MAX_IDLE_RANGE = 12.0  # range of the block medians, in white sigmas, that drift alone may have
MIN_IDLE_SAMPLES = 10 * WINDOW  # shortest stretch that tells drift from a constant
MIN_TIME_CONSTANTS = 5.0  # time constants that a record must hold to tell the size of the drift
MAX_UNEVENNESS = 0.1  # share of the period by which a step may differ and still count as regular
MAX_FILLED_PERIODS = 10.0  # periods of a pause up to which missing readings are interpolated
MAX_BLOCKS = 800  # most blocks looked at
MIN_HELD_READINGS = 10  # readings for which a switch stays, other than the flicker of a last digit
MAX_OUTLIER_SHARE = 0.01  # above it the signal is quick, or the noise far from Gaussian
# Share of unchanged readings above which a channel that jumps is a command.
MIN_UNCHANGED_SHARE = 0.8
MAX_P_VALUE = 0.01  # of a level dependence: one clean channel in a hundred is called so


@dataclass(frozen=True)
class LevelDependence:
    """How the white level changes with the reading's level.

    Attributes
    ----------
    slope : float or None
        dσ/dlevel at the middle of the range [unit/unit]; None where the level hardly changes.
    p_value : float or None
        Of no dependence.
    levels, sigmas : tuple of float, or None
        5 % and 95 % points of the level and the white sigma that the regression gives there.
    significant : bool
    """

    slope: float | None = None
    p_value: float | None = None
    levels: tuple[float, float] | None = None
    sigmas: tuple[float, float] | None = None
    significant: bool = False


@dataclass(frozen=True)
class NoiseEstimate:
    """Everything that a record tells about the noise of its channel.

    Attributes
    ----------
    samples : int
        Readings that are not missing.
    sample_period : float
        Median step [s].
    resolution : float or None
        Step between values [unit].
    drift : DriftFit
        White and drift parameters.
    upper_bound : bool
        The drift cannot be told from the signal on this record, or not its size: `drift.rate` is
        an upper bound, and its size stands for times within the separation window only.
    stretch : tuple of float
        First and last time of the readings that drift and Allan deviation come from [s].
    time, residual : ndarray (m,)
        What is left of the readings without slow signal [s], [unit]; NaN where not separable.
    notes : tuple of str
        What a reader of the figures must know, one line each.
    separation_cutoff : float or None
        Where a signal is present: frequency above which the noise is told from it [Hz].
    allan : AllanDeviation or None
        None where the sampling is uneven.
    allan_model : ndarray or None
        Allan deviation of the fitted white noise and drift at the same times [unit].
    spectrum : Spectrum or None
        Of the residual; None where the sampling is uneven or the record short.
    density_model : ndarray or None
        Density of the fitted model at the spectrum's frequencies [unit²/Hz].
    lines : tuple of Line
    outlier_time, outlier_value : ndarray (k,)
        [s], [unit].
    level_dependence : LevelDependence
    """

    samples: int
    sample_period: float
    resolution: float | None
    drift: DriftFit
    upper_bound: bool
    stretch: tuple[float, float]
    time: Array
    residual: Array
    notes: tuple[str, ...]
    separation_cutoff: float | None = None
    allan: AllanDeviation | None = None
    allan_model: Array | None = None
    spectrum: Spectrum | None = None
    density_model: Array | None = None
    lines: tuple[Line, ...] = ()
    outlier_time: Array = field(default_factory=lambda: np.empty(0))
    outlier_value: Array = field(default_factory=lambda: np.empty(0))
    level_dependence: LevelDependence = LevelDependence()


def estimate_noise(
    time: ArrayLike, values: ArrayLike, *, idle: bool = False, max_gap: float | None = None
) -> NoiseEstimate:
    """Noise of one channel, apart from its slow signal.

    White level and drift come from the longest stretch on which the channel stays level. Without
    one, a local cubic is taken off in blocks of `WINDOW` readings, and the drift is an upper bound.

    Parameters
    ----------
    time : array_like (n,)
        Increasing sample times [s]; gaps and uneven steps are allowed.
    values : array_like (n,)
        Readings; NaN is missing [unit].
    idle : bool
        The caller knows that the record holds no signal: all that is slow is drift.
    max_gap : float, optional
        Pause that ends a run of readings [s]; 10 periods by default.

    Raises
    ------
    ValueError
        Shapes differ, time does not increase, all readings missing, or fewer than `MIN_SAMPLES`.
    """
    t, v = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    if t.ndim != 1 or t.shape != v.shape:
        raise ValueError(f"time {t.shape} and values {v.shape} must be vectors of one length")
    present = np.isfinite(v)
    if v.size and not present.any():
        raise ValueError("every reading is missing")
    t, v = t[present], v[present]
    if v.size < MIN_SAMPLES:
        raise ValueError(
            f"{counted(v.size, 'reading')}: too few, at least {MIN_SAMPLES} are needed"
        )
    if not (np.diff(t) > 0).all():
        raise ValueError("time must increase")

    step = resolution_step(v)
    if step is None and np.ptp(v) == 0.0:
        return _silent(t, v, "constant: no noise seen, its resolution cannot be told")
    changes = np.abs(np.diff(v))
    if step is not None and _is_command(v, changes, step):
        return _silent(t, v, "changes in jumps only, like a command: no noise seen")
    return _noisy(t, v, step, idle, max_gap)


def _noisy(
    t: Array, v: Array, step: float | None, idle: bool, max_gap: float | None
) -> NoiseEstimate:
    notes: list[str] = []
    floor = 0.0 if step is None else step / np.sqrt(12.0)
    rough = max(difference_sigma(v), floor)
    outlier = find_outliers(v, max(rough, step or 0.0))
    if outlier.mean() > MAX_OUTLIER_SHARE:
        notes.append("too many readings stand out for outliers: taken as they are")
        outlier[:] = False
    outlier_time, outlier_value = t[outlier], v[outlier]
    t, v = t[~outlier], v[~outlier]
    period = float(np.median(np.diff(t)))
    gap = MAX_FILLED_PERIODS * period if max_gap is None else max_gap

    part = slice(0, v.size) if idle else longest_level_stretch(v, MAX_IDLE_RANGE * rough, WINDOW)
    level = v[part].size >= min(MIN_IDLE_SAMPLES, v.size)
    starts = _blocks(t, gap)
    if level:
        whole = v[part].size == v.size
        # A stretch found beside a signal may still carry the end of a transient: a line goes off.
        drift = fit_drift(t[part], v[part], np.array([0]), degree=0 if whole else 1)
        centred = v[part] - v[part].mean()
        runs, residual_time, residual = _runs(t[part], centred, period, gap), t[part], centred
        cutoff = None
    else:
        part = slice(0, v.size)
        drift = _fit_blocks(t, v, starts)
        runs, residual_time, residual = _separated(t, v, period, gap)
        cutoff = cutoff_per_sample(WINDOW) / period
        told = drift.time_constant is not None
        means = "the drift rate is an upper bound" if told else "a slow drift would pass for it"
        notes.append(f"the signal is present throughout: {means}")
    span = float(t[part][-1] - t[part][0])
    unresolved = drift.at_bound or span < MIN_TIME_CONSTANTS * (drift.time_constant or 0.0)
    if level and unresolved:
        notes.append("drift is slower than the record tells: its rate holds, its size is a bound")
    if not drift.white_resolved:
        notes.append("no white part is seen beside the drift: white sigma is an upper limit")
    if drift.white_sigma < floor:
        notes.append("resolution-limited: white sigma set to the resolution step / sqrt(12)")
        low, high = drift.white_interval
        drift = replace(drift, white_sigma=floor, white_interval=(low, max(high, floor)))
    if np.unique(v).size == 2:
        notes.append("two values only: flicker between neighbouring steps, or a switched drive")

    allan = _allan(t[part], v[part], period, gap)
    model = None if allan is None else model_allan(np.rint(allan.tau / period), period, drift)
    if allan is None:
        notes.append("sampling is uneven: no Allan deviation, spectrum or lines")
    elif level and model is not None and np.mean((model < allan.low) | (model > allan.high)) > 0.25:
        notes.append("white noise plus one drift does not describe the Allan deviation")
    spectrum = welch_spectrum(runs, period)
    density = None if spectrum is None else model_density(spectrum.frequency, period, drift)
    lines: tuple[Line, ...] = ()
    if spectrum is not None and density is not None:
        lines = find_lines(spectrum, density, 0.0 if cutoff is None else 2.0 * cutoff)
    return NoiseEstimate(
        samples=v.size + outlier_time.size,
        sample_period=period,
        resolution=step,
        drift=drift,
        upper_bound=not level or unresolved,
        stretch=(float(t[part][0]), float(t[part][-1])),
        separation_cutoff=cutoff,
        allan=allan,
        allan_model=model,
        spectrum=spectrum,
        density_model=density,
        lines=lines,
        outlier_time=outlier_time,
        outlier_value=outlier_value,
        level_dependence=_level_dependence(t, v, starts, step, rough),
        time=residual_time,
        residual=residual,
        notes=tuple(notes),
    )


def _is_command(v: Array, changes: Array, step: float) -> bool:
    """Whether a channel is set and not measured: it holds its values and jumps between them.

    Jumps of more than one step tell it, or two values of which neither flickers.
    """
    if np.mean(changes == 0.0) <= MIN_UNCHANGED_SHARE:
        return False
    plateaus = np.diff(np.concatenate(([0], np.flatnonzero(changes) + 1, [v.size])))
    held = plateaus.min() >= MIN_HELD_READINGS and np.unique(v).size == 2
    return bool(held or np.median(changes[changes > 0.0]) > 1.5 * step)


def _silent(t: Array, v: Array, note: str) -> NoiseEstimate:
    """A channel in which no noise is seen."""
    none = DriftFit(0.0, (0.0, 0.0), True, 0.0, (0.0, 0.0), None, None, 0.0, None, False)
    return NoiseEstimate(
        samples=v.size,
        sample_period=float(np.median(np.diff(t))),
        resolution=None,
        drift=none,
        upper_bound=False,
        stretch=(float(t[0]), float(t[-1])),
        time=t,
        residual=np.zeros_like(v),
        notes=(note,),
    )


def _blocks(t: Array, gap: float) -> NDArray[np.int64]:
    """First readings of blocks of `WINDOW` that hold no gap; bursts are taken as they come."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(t) > gap) + 1, [t.size]))
    if np.median(np.diff(edges)) < WINDOW:
        edges = np.array([0, t.size])
    pieces = [np.arange(a, b - WINDOW + 1, WINDOW) for a, b in pairwise(edges)]
    starts = np.concatenate(pieces)
    # Some hundreds of blocks tell the white level to half a percent; more only cost time.
    return starts[np.unique(np.linspace(0, starts.size - 1, MAX_BLOCKS).astype(int))]


def _fit_blocks(t: Array, v: Array, starts: NDArray[np.int64]) -> DriftFit:
    """White noise and drift inside the blocks, whatever the signal does between them."""
    starts = starts[smooth_blocks(t, v, starts, WINDOW)]
    index = (starts[:, None] + np.arange(WINDOW)).ravel()
    return fit_drift(t[index], v[index], WINDOW * np.arange(starts.size), degree=3)


def _even(t: Array, period: float, gap: float) -> list[slice]:
    """Runs of even sampling, longest last; a few missing readings are no end of a run."""
    steps = np.diff(t) / period
    whole = np.rint(steps)
    broken = (np.abs(steps - whole) > MAX_UNEVENNESS) | (whole < 1.0)
    broken |= steps > min(MAX_FILLED_PERIODS, gap / period)
    edges = np.concatenate(([0], np.flatnonzero(broken) + 1, [t.size]))
    runs = [slice(a, b) for a, b in pairwise(edges)]
    return sorted(runs, key=lambda run: run.stop - run.start)


def _fill(t: Array, v: Array, period: float) -> tuple[Array, Array]:
    """Readings on the full grid of a run: missing ones are interpolated."""
    grid = np.rint((t - t[0]) / period)
    full = np.arange(grid[-1] + 1.0)
    return t[0] + full * period, np.interp(full, grid, v)


def _runs(t: Array, v: Array, period: float, gap: float) -> list[Array]:
    return [_fill(t[run], v[run], period)[1] for run in _even(t, period, gap)]


def _allan(t: Array, v: Array, period: float, gap: float) -> AllanDeviation | None:
    """Allan deviation of the longest even run; None where that is under half of the record."""
    run = _even(t, period, gap)[-1]
    if run.stop - run.start < max(0.5 * t.size, MIN_SAMPLES):
        return None
    return allan_deviation(_fill(t[run], v[run], period)[1], period)


def _separated(t: Array, v: Array, period: float, gap: float) -> tuple[list[Array], Array, Array]:
    """Residual of the local cubic: its uninterrupted pieces, and all of it with its times."""
    pieces: list[Array] = []
    times, residuals = [np.empty(0)], [np.empty(0)]
    for run in sorted(_even(t, period, gap), key=lambda run: run.start):
        if run.stop - run.start < WINDOW:
            continue
        grid, filled = _fill(t[run], v[run], period)
        residual = separate(filled, WINDOW).residual
        times.append(grid)
        residuals.append(residual)
        good = np.isfinite(residual)
        edges = np.flatnonzero(np.diff(good)) + 1
        pieces += [p for p in np.split(residual, edges) if np.isfinite(p[0])]
    return pieces, np.concatenate(times), np.concatenate(residuals)


def _level_dependence(
    t: Array, v: Array, starts: NDArray[np.int64], step: float | None, sigma: float
) -> LevelDependence:
    """Regression of the log variance of blocks on their mean level.

    Left undecided where quantization makes the scatter, or where the level hardly changes.
    """
    starts = starts[smooth_blocks(t, v, starts, WINDOW)]
    if starts.size < 12 or (step is not None and sigma < 0.5 * step):
        return LevelDependence()
    level = v[starts[:, None] + np.arange(WINDOW)].mean(axis=1)
    variance = block_variance(t, v, starts, WINDOW)
    usable = variance > 0.0
    low, high = np.quantile(level, (0.05, 0.95))
    if usable.sum() < 12 or high - low < MAX_IDLE_RANGE * sigma:
        return LevelDependence()
    x, y = level[usable] - level[usable].mean(), 0.5 * np.log(variance[usable])
    gain = float(np.dot(x, y) / np.dot(x, x))
    scatter = np.sum((y - y.mean() - gain * x) ** 2) / (y.size - 2)
    p_value = 2.0 * float(stdtr(y.size - 2, -abs(gain) / np.sqrt(scatter / np.dot(x, x))))
    points = np.array([low, 0.5 * (low + high), high]) - level[usable].mean()
    at = np.exp(y.mean() + gain * points)
    return LevelDependence(
        slope=gain * float(at[1]),
        p_value=p_value,
        levels=(float(low), float(high)),
        sigmas=(float(at[0]), float(at[2])),
        significant=p_value < MAX_P_VALUE,
    )
