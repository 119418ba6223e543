"""What a calibration knows of a response beyond its kind, and how surely.

No kind of response is exact. What is left of a calibration is explained by lags of the drives,
which all make as much a priori, by moves of the fitted parameters as far as the noise leaves them
open, by what wanders beside the drives (a room that nobody logs, which a machine follows smoothly),
and by white noise with a slow drift; sizes by marginal likelihood. Mean and covariance of moves and
weights are what later data have to contradict before a model counts as wrong (Kennedy & O'Hagan
2001). Whether the kind is wrong or something wandered one record tells badly. So the mean is that
without any wandering, and the covariance covers both; of sizes that are as likely it covers the
largest.

The noise is that of signals/drift.py, with the same factors; but weights and moves are integrated
out beside it, which moves the maximum, and that is only looked for on a grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from thermaltool.fitting.gaussian_columns import beside, information_of, inverse_of, marginal
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
# What wanders bends at so many instants of a record, and by all records at no more than those; each
# bend makes so many times the white noise at the end of its record, a priori.
BENDS, MAX_BENDS = 16, 96
WANDER_SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
# 95 % limit of a profile of the likelihood.
AS_LIKELY = 1.92
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


@dataclass(frozen=True)
class Discrepancy:
    """Posterior of parameter moves and lag weights.

    Attributes
    ----------
    mean : ndarray, shape (p + q,)
        Moves of the parameters (of logarithms, gains), then weights of the lags.
    covariance : ndarray, shape (p + q, p + q)
    white, drift : float
        Standard deviations of noise and of a discrepancy beside it [unit of the output], where
        nothing wanders: of what a later log leaves, not of what this posterior took apart.
    drift_time : float
        Time constant of the discrepancy [s].
    size : ndarray, shape (q,)
        Prior standard deviation of each lag's weight [unit of the output per unit of its drive].
    spread : ndarray, shape (m, q)
        Weights of the lags by which m other fits differ that come as near: of other kinds of
        response, or of one where drives share what they do in another way.
    instants : ndarray, shape (s,)
        How early each switch between the rows most likely is, over its standard deviation.
    taken_up : ndarray, shape (p, p)
        Covariance that parameters have beside that of the noise, the kind being right: of what
        wandered, and of what of it the fit took for theirs.
    """

    mean: Float
    covariance: Float
    white: float
    drift: float
    drift_time: float
    size: Float
    spread: Float
    instants: Float
    taken_up: Float


@dataclass(frozen=True)
class _Level:
    """Sizes of what a residual is made of, those of lags and of wandering over the white noise.

    Its negative log marginal likelihood is `value`.
    """

    ratio: float
    tau: float
    wander: float
    lags: float
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
    fitted: Float,
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
    fitted : ndarray, shape (p, f)
        Which of the parameters that the fit has each one is: several share a rate.
    """
    # The prior is one of what is seen, whatever the unit of a drive.
    level = _largest(lags, levels[len(gains) :])
    late = np.empty((len(residual), 0)) if instants is None else instants.columns
    left = residual if instants is None else instants.left(residual, np.ones(len(residual)))
    # What stands alone is no noise, and would pass for much of it.
    kept = np.concatenate(
        [
            np.flatnonzero(record == k)[~find_outliers(own_rows, difference_sigma(own_rows))]
            for k in np.unique(record)
            for own_rows in [left[record == k]]
        ]
    )
    time, record, residual = time[kept], record[kept], residual[kept]
    own, free, lags, late = own[kept], free[kept], (lags / level)[kept], late[kept]
    members = [record == k for k in np.unique(record)]
    groups = RowGroups.of([Record(time[each], {}) for each in members])
    assert groups is not None
    bends = _bends(time, members)
    table = np.column_stack([residual, own, lags, late, bends, free])
    rows, noise = groups.means([table[each] for each in members]), groups.noise
    p, q, m, w = own.shape[1], lags.shape[1], late.shape[1], bends.shape[1]
    sigma = max(difference_sigma(left[kept]), 1e-3 * float(np.std(residual)), 1e-12)
    tried: list[_Level] = []
    taus = np.geomspace(5 * noise.period, max(noise.span / 2, 10 * noise.period), DRIFT_TIMES)
    for ratio in DRIFT_RATIOS:
        for tau in taus.tolist() if ratio else taus[:1].tolist():
            factor = noise.factor(ratio, tau)
            # Beside the instants, whose prior is the same all over the grid.
            whole, cost = beside(rows.T @ factor.solve(rows), 1 + p + q, m, 1 / sigma)
            for wander in (0.0, *WANDER_SIZES):
                gram, logdet = beside(whole, 1 + p + q, w, wander)
                for size in LAG_SIZES:
                    prior = information_of(len(gram) - 1, p, (q, size))
                    offset = factor.logdet + cost + logdet
                    value, white = marginal(gram, offset, len(rows), prior)
                    tried.append(_Level(ratio, tau, wander, size, white, value))
    still = min((level for level in tried if not level.wander), key=attrgetter("value"))
    limit = min(level.value for level in tried) + AS_LIKELY
    wandering = max((e for e in tried if e.value <= limit), key=lambda e: (e.wander, -e.value))
    span = _sizes(own, gains, levels[: len(gains)])
    linear = _linear_moves(own * span, still.white)

    def posterior(at: _Level) -> _Posterior:
        gram = rows.T @ noise.factor(at.ratio, at.tau).solve(rows)
        groups = (q, at.lags), (m, 1 / at.white), (w, at.wander)
        return _Posterior.of(gram, at.white, fitted, span, linear, groups)

    here, there = posterior(still), posterior(wandering)
    # Whether the kind is wrong or something wandered one record cannot tell: either may be true.
    off = there.mean - here.mean
    covariance = (here.covariance + there.covariance + np.outer(off, off)) / 2
    # The fit itself, of least squares, takes up what wanders.
    fitted_off = np.outer(there.mean_alone, there.mean_alone)
    more = _positive(there.covariance_alone - here.covariance_alone, span)
    unit = np.append(np.ones(p), level)
    lag_size = np.hypot(still.white * still.lags, wandering.white * wandering.lags) / np.sqrt(2)
    return Discrepancy(
        here.mean / unit,
        covariance / np.outer(unit, unit),
        still.white,
        still.white * float(np.sqrt(still.ratio)),
        still.tau,
        lag_size / level,
        spread,
        here.instants,
        (more + fitted_off) / 2,
    )


@dataclass(frozen=True)
class _Posterior:
    """Of moves of the parameters and weights of the lags, shape (p + q,); of moves beside no lags.

    And of the instants the likeliest, shape (m,).
    """

    mean: Float
    covariance: Float
    mean_alone: Float
    covariance_alone: Float
    instants: Float

    @staticmethod
    def of(
        gram: Float,
        white: float,
        fitted: Float,
        span: Float,
        linear: Float,
        groups: tuple[tuple[int, float], ...],
    ) -> _Posterior:
        """From products of the residual, sensitivities, lags, instants, bends and free columns.

        Parameters
        ----------
        gram : ndarray, shape (1 + p + q + m + w + f,) * 2
        white : float
        fitted : ndarray, shape (p, f)
        span, linear : ndarray, shape (p,)
            Sizes of the parameters, and what of those is linear.
        groups : tuple of (int, float)
            Numbers and prior sizes of lags, instants and bends, over the white noise.
        """
        p, ((q, _), *others) = len(span), groups
        prior = information_of(len(gram) - 1, p, *groups)
        # Beside no lags: what the noise alone leaves open of the parameters stays open beside them,
        # and what it does not show at all is open to the most.
        lagless = np.delete(np.arange(len(gram)), slice(1 + p, 1 + p + q))
        bare = gram[np.ix_(lagless, lagless)]
        prior[:p] = (white / (PARAMETER_MOVES[1] * span)) ** 2
        without = np.delete(prior, slice(p, p + q))
        alone = inverse_of(bare, without)
        # As the fit has them.
        f = fitted.shape[1]
        ties = block_diag(1.0, fitted, np.eye(len(bare) - 1 - p))
        tied = ties.T @ bare @ ties
        own = inverse_of(tied, np.append(np.max(fitted.T * prior[:p], axis=1), without[p:]))
        errors = white * np.sqrt(np.maximum(np.diag(alone)[:p], 0.0)) / span
        least, most = PARAMETER_MOVES
        moves = np.clip(MOVE_ERRORS * errors, np.minimum(least, linear), np.minimum(most, linear))
        prior[:p] = (white / (moves * span)) ** 2
        inverse = inverse_of(gram, prior)
        keep, fit = slice(0, p + q), slice(1, 1 + p + q)
        return _Posterior(
            (inverse @ gram[1:, 0])[keep],
            white**2 * inverse[keep, keep],
            fitted @ (own @ tied[1:, 0])[:f],
            white**2 * fitted @ own[:f, :f] @ fitted.T,
            _instants(np.delete(np.delete(gram, fit, 0), fit, 1), others),
        )


def _positive(difference: Float, size: Float) -> Float:
    """Of a difference of covariances what is more, in units of each parameter's size."""
    values, vectors = np.linalg.eigh(difference / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root @ root.T)


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


def _bends(time: Float, members: Sequence[NDArray[np.bool_]]) -> Float:
    """Ramps that begin at bends of a smooth course of each record, one at its end, (n, bends)."""
    each = max(1, min(BENDS, MAX_BENDS // len(members)))
    found = np.zeros((len(time), len(members) * each))
    for k, own in enumerate(members):
        first, last = time[own][[0, -1]]
        at = np.linspace(first, last, each, endpoint=False)
        ramps = np.maximum(time[own][:, None] - at, 0.0) / max(last - first, 1e-300)
        found[np.flatnonzero(own)[:, None], k * each + np.arange(each)] = ramps
    return found


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


def _instants(gram: Float, groups: Sequence[tuple[int, float]]) -> Float:
    """The likeliest of the first group beside the fit as it stands: no parameter, no lag moves."""
    inverse = inverse_of(gram, information_of(len(gram) - 1, 0, *groups))
    return np.asarray((inverse @ gram[1:, 0])[: groups[0][0]])
