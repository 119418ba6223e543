"""What a calibration knows of a response beyond its kind, and how surely.

No kind of response is exact. What is left of a calibration is explained by lags of the drives,
which all make as much a priori, by moves of the fitted parameters as far as the noise leaves them
open, and by white noise with a slow drift; sizes by marginal likelihood. Mean and covariance of
moves and weights are what later data have to contradict before a model counts as wrong (Kennedy &
O'Hagan 2001).

The noise is that of signals/drift.py, with the same factors; but weights and moves are integrated
out beside it, which moves the maximum, and that is only looked for on a grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from thermaltool.fitting.instants import Instants
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.signals.detrend import difference_sigma, find_outliers
from thermaltool.signals.row_groups import RowGroups

# Prior size of the most that a lag makes, in units of the white noise; drift over white, in
# variance; number of time constants of the drift: the grid of the marginal likelihood.
LAG_SIZES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
DRIFT_RATIOS = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
DRIFT_TIMES = 5
# A record tells how fast a slow drift walks, hardly how far it goes: what parameters may be counts
# under the slowest drift that is as likely, by the 95 % limit of a profile of the likelihood. It may
# be larger than those of the grid, and last so many records.
AS_LIKELY, FAR_RATIOS, SLOW_SPANS = 1.92, (10.0, 30.0), (0.5, 2.0)
# Prior standard deviation of a parameter's move: so many times what the noise leaves open of it,
# but no less than the first and no more than the second share of its size, nor more than what is
# linear to within the noise; the lags say the rest.
MOVE_ERRORS, PARAMETER_MOVES = 3.0, (0.003, 0.3)
# A calibration that leaves more than this many times the noise of a reading has an error of
# structure, and is no measure of what is wrong with a machine.
MAX_OVER_NOISE = 5.0
# Within so much of a reading's noise of the nearest all fits may be true, of one kind or another.
AS_NEAR = 1.0
# Instants at which kinds of response are compared; directions of their lags below this share of the
# largest are rounding.
SPREAD_INSTANTS, MIN_SPREAD_DIRECTION = 100, 1e-4
# Directions of the information below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-13


@dataclass(frozen=True)
class Discrepancy:
    """Posterior of parameter moves and lag weights.

    Attributes
    ----------
    mean : ndarray, shape (p + q,)
        Moves of the parameters (of logarithms, gains), then weights of the lags.
    covariance : ndarray, shape (p + q, p + q)
    white, drift : float
        Standard deviations of noise and of a discrepancy beside it [unit of the output], the
        likeliest. The posterior counts with the slowest that is as likely.
    drift_time : float
        Time constant of the discrepancy [s].
    size : ndarray, shape (q,)
        Prior standard deviation of each lag's weight [unit of the output per unit of its drive].
    spread : ndarray, shape (m, q)
        Weights of the lags by which m other fits differ that come as near: of other kinds of
        response, or of one where drives share what they do in another way.
    instants : ndarray, shape (s,)
        How early each switch between the rows most likely is, over its standard deviation.
    """

    mean: Float
    covariance: Float
    white: float
    drift: float
    drift_time: float
    size: Float
    spread: Float
    instants: Float


@dataclass(frozen=True)
class _Level:
    """White noise beside a drift, and a size of the lags: negative log marginal likelihood."""

    ratio: float
    tau: float
    size: float
    white: float
    value: float


def calibration_error(fit: Mapping[str, Any]) -> float:
    """RMS that a model left of its calibration [unit of the output].

    Beside the instants of commands between the rows where these are part of the fit, else with the
    zero of each log free.

    Parameters
    ----------
    fit : mapping
        Of an output of a model file.
    """
    if "instants" in fit:
        return float(fit["instants"]["rmse"])
    return float(fit.get("rmse_zero_free", fit.get("rmse", 0.0)))


def discrepancy(
    time: Float,
    record: NDArray[np.int64],
    residual: Float,
    own: Float,
    free: Float,
    lags: Float,
    instants: Instants | None,
    gains: Float,
    levels: Float,
    spread: Float,
) -> Discrepancy:
    """Posterior from the residual of a calibration.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
    record : ndarray of int, shape (n,)
    residual : ndarray, shape (n,)
    own, free, lags : ndarray, shape (n, ·)
        Sensitivities to the parameters, columns without a prior (offsets), and lags of the drives
        in their units.
    instants : Instants, optional
        Of switches between the rows.
    gains : ndarray, shape (g,) [unit of the output per unit of a drive]
        Values of the last of the parameters; those before them are logarithms.
    levels : ndarray, shape (g + q,)
        Largest value of the drive of each gain and lag, for those that no row shows.
    spread : ndarray, shape (m, q)
        See `Discrepancy`.
    """
    # The prior is one of what is seen, whatever the unit of a drive.
    level = _largest(lags, levels[len(gains) :])
    late = np.empty((len(residual), 0)) if instants is None else instants.columns
    beside = residual if instants is None else instants.left(residual, np.ones(len(residual)))
    # What stands alone is no noise, and would pass for much of it.
    kept = np.concatenate(
        [
            np.flatnonzero(record == k)[~find_outliers(own_rows, difference_sigma(own_rows))]
            for k in np.unique(record)
            for own_rows in [beside[record == k]]
        ]
    )
    time, record, residual = time[kept], record[kept], residual[kept]
    own, free, lags, late = own[kept], free[kept], (lags / level)[kept], late[kept]
    members = [record == k for k in np.unique(record)]
    groups = RowGroups.of([Record(time[each], {}) for each in members])
    assert groups is not None
    table = np.column_stack([residual, own, lags, late, free])
    rows, noise = groups.means([table[each] for each in members]), groups.noise
    p, q, m = own.shape[1], lags.shape[1], late.shape[1]
    sigma = max(difference_sigma(beside[kept]), 1e-3 * float(np.std(residual)), 1e-12)
    span = noise.span

    def likely(ratio: float, tau: float) -> Iterator[_Level]:
        factor = noise.factor(ratio, tau)
        # Beside the instants, whose prior is the same all over the grid.
        gram, logdet = _beside(rows.T @ factor.solve(rows), 1 + p + q, m, 1 / sigma)
        for size in LAG_SIZES:
            prior = _prior(len(gram) - 1, p, (q, size))
            value, white = _marginal(gram, factor.logdet + logdet, len(rows), prior)
            yield _Level(ratio, tau, size, white, value)

    taus = np.geomspace(5 * noise.period, max(span / 2, 10 * noise.period), DRIFT_TIMES).tolist()
    near = [(ratio, tau) for ratio in DRIFT_RATIOS for tau in (taus if ratio else taus[:1])]
    far = [(r, n * span) for r in (*DRIFT_RATIOS[1:], *FAR_RATIOS) for n in SLOW_SPANS]
    tried = [level for point in near for level in likely(*point)]
    best = min(tried, key=attrgetter("value"))
    tried += [level for point in far for level in likely(*point)]
    as_likely = [level for level in tried if level.value <= best.value + AS_LIKELY]
    slow = max(as_likely, key=lambda level: (level.tau if level.ratio else 0.0, -level.value))
    size, white = slow.size, slow.white
    gram = rows.T @ noise.factor(slow.ratio, slow.tau).solve(rows)
    prior = _prior(len(gram) - 1, p, (q, size), (m, 1 / white))
    makes = _sizes(own, gains, levels[: len(gains)])
    # Beside no lags: what the noise alone leaves open of the parameters stays open beside them, and
    # what it does not show at all is open to the most.
    lagless = np.delete(np.arange(len(gram)), slice(1 + p, 1 + p + q))
    prior[:p] = (white / (PARAMETER_MOVES[1] * makes)) ** 2
    bare = _inverse(gram[np.ix_(lagless, lagless)], np.delete(prior, slice(p, p + q)))
    errors = white * np.sqrt(np.maximum(np.diag(bare)[:p], 0.0)) / makes
    least, most = PARAMETER_MOVES
    linear = _linear_moves(own * makes, white)
    moves = np.clip(MOVE_ERRORS * errors, np.minimum(least, linear), np.minimum(most, linear))
    prior[:p] = (white / (moves * makes)) ** 2
    inverse = _inverse(gram, prior)
    keep, fit = slice(0, p + q), slice(1, 1 + p + q)
    mean = inverse @ gram[1:, 0]
    unit = np.append(np.ones(p), level)
    return Discrepancy(
        mean[keep] / unit,
        white**2 * inverse[keep, keep] / np.outer(unit, unit),
        best.white,
        best.white * float(np.sqrt(best.ratio)),
        best.tau,
        white * size / level,
        spread,
        _instants(np.delete(np.delete(gram, fit, 0), fit, 1), m, white),
    )


def spread(
    rates: Float, lags: NDArray[np.int64], duration: float, others: Sequence[Float], own: Float
) -> Float:
    """What other fits differ by that come as near, as weights of lags, shape (m, drives · lags).

    Of rates slower than the longest record a log shows what the lags can stand for.

    Parameters
    ----------
    rates : ndarray, shape (n,) [1/s]
    lags : ndarray of int
        Which of them are lags.
    duration : float [s]
        Of the longest record.
    others : sequence of ndarray, shape (drives, n)
        Weights of the rates, of every drive.
    own : ndarray, shape (drives · n,)
        Of the fit that was taken.
    """
    time = np.geomspace(1 / rates[-1], duration, SPREAD_INSTANTS)
    steps = -np.expm1(-np.outer(time, rates))
    inverse = np.linalg.pinv(steps[:, lags], rcond=MIN_SPREAD_DIRECTION)
    here = own.reshape(-1, len(rates))
    differ = np.reshape(others, (len(others), *here.shape)) - here
    return np.asarray((differ @ steps.T @ inverse.T).reshape(len(others), len(here) * len(lags)))


def _largest(columns: Float, levels: Float) -> Float:
    """Largest absolute value of each column; that of its drive where no row shows any."""
    largest = np.max(np.abs(columns), axis=0, initial=0.0)
    return np.where(largest > 0, largest, levels)


def _sizes(own: Float, gains: Float, levels: Float) -> Float:
    """Size of each parameter, shape (p,): one for a logarithm, of a gain what it makes at most.

    All gains make as much as the strongest, whatever the units of their drives.
    """
    first = own.shape[1] - len(gains)
    makes = _largest(own[:, first:], levels)
    most = max(float(np.max(makes * np.abs(gains), initial=0.0)), 1e-300)
    return np.append(np.ones(first), most / makes)


def _linear_moves(makes: Float, white: float) -> Float:
    """Moves [1] whose second order is no more than the noise, shape (p,).

    Of a rate by its logarithm, or of a gain beside one, it is about half of the square of the move
    times what the parameter makes, column by column.
    """
    size = np.sqrt(np.mean(np.square(makes), axis=0))
    return np.asarray(np.sqrt(2 * white / np.maximum(size, 1e-300)))


def _beside(gram: Float, first: int, count: int, size: float) -> tuple[Float, float]:
    """Products beside columns with a prior that are integrated out, and what that costs.

    Parameters
    ----------
    gram : ndarray, shape (c, c)
    first, count : int
        Which columns.
    size : float
        Their prior standard deviation over the noise.

    Returns
    -------
    ndarray, shape (c - count, c - count)
    float
        Logarithm of the determinant of their information over that of the prior.
    """
    out = slice(first, first + count)
    if not count:
        return gram, 0.0
    root = np.linalg.cholesky(gram[out, out] * size**2 + np.eye(count))
    through = solve_triangular(root, size * np.delete(gram[out], out, axis=1), lower=True)
    left = np.delete(np.delete(gram, out, axis=0), out, axis=1) - through.T @ through
    return left, 2 * float(np.sum(np.log(np.diag(root))))


def _instants(gram: Float, count: int, white: float) -> Float:
    """The likeliest instants beside the fit as it stands, shape (count,): nothing else moves."""
    inverse = _inverse(gram, _prior(len(gram) - 1, 0, (count, 1 / white)))
    return np.asarray((inverse @ gram[1:, 0])[:count])


def _prior(columns: int, p: int, *groups: tuple[int, float]) -> Float:
    """Prior information of the columns, shape (columns,): p without any, then groups of one size.

    The information is over that of a row; sizes are prior standard deviations over its noise.
    """
    prior, start = np.zeros(columns), p
    for count, size in groups:
        prior[start : start + count] = 1 / size**2
        start += count
    return prior


def _scaled(gram: Float, prior: Float) -> tuple[Float, Float]:
    """Information with the prior, its diagonal scaled to ones, and the roots of the diagonal."""
    information = gram[1:, 1:] + np.diag(prior)
    height = np.sqrt(np.diag(information))
    height[height == 0] = 1.0
    return information / np.outer(height, height), height


def _inverse(gram: Float, prior: Float) -> Float:
    """Inverse of the information of the columns with the prior."""
    scaled, height = _scaled(gram, prior)
    known = np.linalg.pinv(scaled, rcond=MIN_DIRECTION, hermitian=True)
    return np.asarray(known / np.outer(height, height), float)


def _marginal(gram: Float, logdet: float, n: int, prior: Float) -> tuple[float, float]:
    """Negative log marginal likelihood, and white noise, for one prior of the columns."""
    scaled, height = _scaled(gram, prior)
    pull = gram[1:, 0] / height
    values, vectors = np.linalg.eigh(scaled)
    seen = values > MIN_DIRECTION * values[-1]
    explained = float(np.sum((pull @ vectors[:, seen]) ** 2 / values[seen]))
    square = max(float(gram[0, 0]) - explained, 1e-300)
    held = prior > 0
    dof = max(n - int(np.sum(~held)), 1)
    occam = float(np.sum(np.log(np.maximum(values, MIN_DIRECTION))))
    occam += 2 * float(np.sum(np.log(height)))
    occam -= float(np.sum(np.log(prior[held])))
    return 0.5 * (dof * np.log(square / dof) + logdet + occam), float(np.sqrt(square / dof))
