"""Moments at which a heat steps, found by evidence: a random walk with rare, large changes.

A machine is switched: its heat steps and stays. A walk whose changes have one size in every row
spreads each step over the rows around it. Here a walk that changes less is joined by steps at a few
rows, each normal with the level's size, as many and wherever the readings make likely (the
Bernoulli-Gaussian input of Kormylo and Mendel 1982). For given rows all is Gaussian, and what a
step more or less adds to the likelihood is known in closed form from the smoother's adjoint, so
the rows are searched one by one (Champagnat, Goussard and Idier 1996). How sure their number and
places are is told by draws from their distribution (reversible jumps, Green 1995).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.pauses import LONG_SAMPLE
from thermaltool.estimation.smoother import Smoothed, predicted, smooth
from thermaltool.estimation.start import Initial
from thermaltool.estimation.step_search import Places, StepSearch, places_of
from thermaltool.responses.modes import Float

# Variance of the walk beside the steps, over that of the walk alone [1]: smaller ones are tried as
# long as they are likelier. What the model gets wrong has to be in the sensors' noise: with a small
# walk steps would follow it.
WALK_SHARES = (0.1, 0.01, 0.001, 0.0001)
# So much less likely than the walk alone, the steps are not looked for with a smaller walk [nats].
HOPELESS = 50.0
# In more rows no steps are looked for, which would take minutes.
MAX_ROWS = 20_000
# A sample may be longer or shorter than the usual one by this share: a longer one is a pause.
MAX_UNEVEN = 0.1
# Steps are looked for in runs of so many rows between pauses, where these are most of the record.
MIN_RUN, MOST = 20, 0.8
# A heat that wanders by less over the record stands still [of its level].
STANDSTILL = 1e-6


@dataclass(frozen=True)
class HeatSteps:
    """What the readings of a record say of the steps of its heat.

    Attributes
    ----------
    evidence : float
        Logarithm of the likelihood of the readings with steps, around the likeliest rows, the prior
        of their number and rows included [nats].
    of_walk : float
        That of the walk alone.
    estimator : KalmanEstimator
        With the walk that is left beside the steps.
    likeliest : ndarray of float, shape (n, n_drives)
        Variance of a step in each row [unit of the drive, squared].
    draws : tuple of ndarray, shape (n, n_drives)
        The same for draws from the distribution of the rows.
    pauses : ndarray, shape (n, n_drives)
        Variance of what a heat may change by in each row of a pause and at its ends [unit of the
        drive, squared].
    start : ndarray, shape (m, m)
        Covariance of the estimator's state at the first reading. Before it a heat has stepped, too:
        it is that of the walk without steps.
    runs : int
        Between pauses.
    """

    evidence: float
    of_walk: float
    estimator: KalmanEstimator
    likeliest: Float
    draws: tuple[Float, ...]
    pauses: Float
    start: Float
    runs: int = 1

    @property
    def are_likelier(self) -> bool:
        """Whether there are steps, and they explain the readings better than the walk alone."""
        return self.count > 0 and self.evidence > self.of_walk

    @property
    def count(self) -> int:
        """Number of steps, where they are likeliest."""
        return int(np.count_nonzero(self.likeliest))


def smooth_with_steps(
    found: HeatSteps, time: Float, readings: Float, level: Sequence[float]
) -> Smoothed:
    """Fixed-interval smoothing over all draws of the steps' rows: estimates, and `sigma`.

    Parameters
    ----------
    found : HeatSteps
    time, readings, level
        As in `smoother.smooth`.
    """
    draws = [
        smooth(
            found.estimator,
            time,
            readings,
            level,
            steps=each + found.pauses,
            start=found.start,
        )
        for each in found.draws
    ]
    estimates = np.array([each.estimates for each in draws])
    # The law of total variance: within the draws and between them.
    within = np.mean([np.square(each.sigma) for each in draws], axis=0)
    sigma = np.sqrt(within + np.var(estimates, axis=0))
    return replace(draws[0], estimates=np.mean(estimates, axis=0), sigma=sigma)


def why_no_steps(
    kalman: KalmanEstimator,
    time: Float,
    readings: Float,
    level: Sequence[float],
    there: NDArray[np.bool_] | None = None,
) -> str:
    """Why steps are not looked for in a record; empty where they are.

    Parameters
    ----------
    kalman : KalmanEstimator
        Walk and noise as the record tells them.
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
    level : sequence of float, one for each drive [unit of the drive]
    there : ndarray of bool, shape (n,), optional
        Which rows are those of the record, not of its pauses. Default: all.
    """
    if len(kalman.drives) > 1:
        # What a model gets wrong of one drive is taken for steps of the other.
        return "several drives are estimated"
    steps = np.diff(time)
    if np.any(steps < (1 - MAX_UNEVEN) * np.median(steps)):
        return "the clock is uneven"
    read = np.count_nonzero(np.isfinite(readings).any(axis=1))
    if sum(run.stop - run.start for run in even_runs(time, readings)) < MOST * read:
        own = slice(None) if there is None else there
        samples = np.diff(time[own]) / np.median(np.diff(time[own]))
        pauses, uneven = samples > LONG_SAMPLE, np.abs(samples - 1) > MAX_UNEVEN
        shares = {
            "too many readings are missing": np.mean(~np.isfinite(readings[own]).all(axis=1)),
            "the clock is uneven": np.mean(uneven & ~pauses),
            "there are too many pauses": np.mean(pauses),
        }
        return max(shares, key=lambda each: shares[each])
    if kalman.walk[0] * math.sqrt(float(np.ptp(time))) < STANDSTILL * level[0]:
        return "the heat stands still"
    if read > MAX_ROWS:
        return f"there are more than {MAX_ROWS} rows"
    return ""


def even_runs(time: Float, readings: Float) -> list[slice]:
    """Rows between pauses: on an even clock, with all readings, and `MIN_RUN` of them at least.

    Parameters
    ----------
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
        NaN where there is none.
    """
    rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
    if not len(rows):
        return []
    longest = (1 + MAX_UNEVEN) * float(np.median(np.diff(time))) if len(time) > 1 else math.inf
    pauses = (np.diff(rows) > 1) | (np.diff(time[rows]) > longest)
    parts = np.split(rows, np.flatnonzero(pauses) + 1)
    runs = [slice(int(part[0]), int(part[-1]) + 1) for part in parts if len(part) >= MIN_RUN]
    if len(parts) == 1 and not runs:
        return [slice(int(rows[0]), int(rows[-1]) + 1)]
    return runs


def find_steps(
    kalman: KalmanEstimator, time: Float, readings: Float, level: Sequence[float], initial: Initial
) -> HeatSteps:
    """Steps of the heat in a record, beside a walk.

    They are looked for run by run between pauses: what is known of a run's start is what the runs
    before it tell, with their steps. In a pause a heat wanders as it does without steps: rows
    without readings there (`pauses.with_pauses`) have it change amid the pause.

    Parameters
    ----------
    kalman : KalmanEstimator
        Walk and noise as the record tells them, without steps.
    time : ndarray, shape (n,) [s], increasing
        As even as `why_no_steps` asks.
    readings : ndarray, shape (n, n_sensors)
        Relative to rest; NaN where there is none.
    level : sequence of float, one for each drive
        Standard deviation of a step, and of the heat at the first row [unit of the drive].
    initial : {"rest", "settled", "free"}
        As in `smoother.smooth`.
    """
    record = _Record(
        replace(kalman, outputs=(), followed=()), time, readings, level, initial,
        even_runs(time, readings),
    )  # fmt: skip
    of_walk = record.searched(1.0).evidence
    best: _Searched | None = None
    found: _Searched | None = None
    for share in WALK_SHARES:
        found = record.searched(share, found)
        falls = best is not None and found.evidence < best.evidence
        if not falls:
            best = found
        if found.evidence < of_walk - HOPELESS or (falls and found.evidence > of_walk):
            break
    assert best is not None, "there is a share"
    drawn: list[Float] = []
    if best.evidence > of_walk:
        of_runs = [each.drawn(at) for each, at in zip(best.searches, best.places, strict=True)]
        drawn = [record.variances(best.searches, each) for each in zip(*of_runs, strict=True)]
    return HeatSteps(
        best.evidence,
        of_walk,
        replace(kalman, walk=best.searches[0].walk),
        record.variances(best.searches, best.places),
        tuple(drawn),
        record.pauses,
        kalman.start_covariance(float(np.median(np.diff(time))), level, initial),
        len(record.runs),
    )


@dataclass(frozen=True)
class _Searched:
    """What was found in each run beside one walk, and its evidence in all."""

    evidence: float
    searches: list[StepSearch]
    places: list[Places]


@dataclass(frozen=True)
class _Record:
    """A record and its runs between pauses."""

    kalman: KalmanEstimator
    time: Float
    readings: Float
    level: Sequence[float]
    initial: Initial
    runs: list[slice]

    @property
    def pauses(self) -> Float:
        """Variance of each heat's changes in pauses: it wanders there as it does without steps."""
        found = np.zeros((len(self.time), len(self.level)))
        for one, two in itertools.pairwise(self.runs):
            rows = slice(one.stop - 1, two.start + 1)
            each = np.diff(self.time[rows], append=self.time[two.start])
            each[-1] = each[0]
            found[rows] += np.outer(each, np.square(self.kalman.walk))
        return found

    def searched(self, share: float, known: _Searched | None = None) -> _Searched:
        """Steps beside a walk of so much of the variance, or, for all of it, that walk alone."""
        walk = tuple(math.sqrt(share) * each for each in self.kalman.walk)
        kalman, dt = replace(self.kalman, walk=walk), float(np.median(np.diff(self.time)))
        steps = self.pauses if share < 1 else np.zeros((len(self.time), len(self.level)))
        P = self.kalman.start_covariance(dt, self.level, self.initial)
        a, at = np.zeros(len(P)), 0
        places = places_of(self.runs, len(self.level))
        searches, evidence = [], 0.0
        sets: list[Places] = []
        for k, run in enumerate(self.runs):
            if run.start > at:
                # The rows up to this run, with the steps that were found in them.
                rows = slice(at, run.start + 1)
                before = steps[rows].copy()
                # Those of the first row are in its covariance.
                before[0] -= self.pauses[at] if share < 1 and k > 0 else 0.0
                a, P = predicted(kalman, self.time[rows], self.readings[rows], a, P, before)
            at = run.start
            earlier = sum(len(each) for each in sets) if k else None
            search = StepSearch(kalman, dt, self.readings[run], self.level, a, P, places, earlier)
            found: Places = ()
            value = search.alone
            if share < 1:
                found, value = search.likeliest(known.places[k] if known else ())
                steps[run] += search.variances(found)
            searches.append(search)
            sets.append(found)
            evidence += value
        return _Searched(evidence, searches, sets)

    def variances(self, searches: Sequence[StepSearch], places: Sequence[Places]) -> Float:
        """Variance of a step in every row of the record, shape (n, n_drives)."""
        found = np.zeros((len(self.time), len(self.level)))
        for run, search, each in zip(self.runs, searches, places, strict=True):
            found[run] = search.variances(each)
        return found
