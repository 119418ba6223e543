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

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.smoother import Smoothed, smooth
from thermaltool.estimation.start import Initial
from thermaltool.responses.modes import Float, Recursion

# Variance of the walk beside the steps, over that of the walk alone [1]: the likelier of the first
# two, the last where the walk alone is likelier than both. A smaller one is often likelier still,
# but takes what the model gets wrong for steps.
WALK_SHARES = (0.1, 0.01, 0.001)
# So much less likely than the walk alone, the steps are not looked for with a smaller walk [nats].
HOPELESS = 50.0
# Rows that may hold a step: in a longer record every second row may, or fewer.
MAX_PLACES = 8000
# More steps are not looked for, and none in more rows, which would take minutes.
MAX_STEPS, MAX_ROWS = 150, 20_000
# Draws from the distribution of the rows, how many rounds lie between two, and before the first.
DRAWS, ROUNDS_BETWEEN, ROUNDS_BEFORE = 8, 4, 6
# A sample may be longer or shorter than the usual one by this share: rows alone are searched.
MAX_UNEVEN = 0.1
# A heat that wanders by less over the record stands still [of its level].
STANDSTILL = 1e-6
# Below it an improvement is rounding [nats].
LEAST_GAIN = 1e-6

Places = tuple[int, ...]


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
    """

    evidence: float
    of_walk: float
    estimator: KalmanEstimator
    likeliest: Float
    draws: tuple[Float, ...]

    @property
    def are_likelier(self) -> bool:
        """Whether there are steps, and they explain the readings better than the walk alone."""
        return self.count > 0 and self.evidence > self.of_walk

    @property
    def count(self) -> int:
        """Number of steps, where they are likeliest."""
        return int(np.count_nonzero(self.likeliest))


def smooth_with_steps(
    found: HeatSteps, time: Float, readings: Float, level: Sequence[float], initial: Initial
) -> Smoothed:
    """Fixed-interval smoothing over all draws of the steps' rows: estimates, and `sigma`.

    Parameters
    ----------
    found : HeatSteps
    time, readings, level, initial
        As in `smoother.smooth`.
    """
    draws = [smooth(found.estimator, time, readings, level, initial, each) for each in found.draws]
    estimates = np.array([each.estimates for each in draws])
    # The law of total variance: within the draws and between them.
    within = np.mean([np.square(each.sigma) for each in draws], axis=0)
    sigma = np.sqrt(within + np.var(estimates, axis=0))
    return replace(draws[0], estimates=np.mean(estimates, axis=0), sigma=sigma)


def why_no_steps(
    kalman: KalmanEstimator, time: Float, readings: Float, level: Sequence[float]
) -> str:
    """Why steps are not looked for in a record; empty where they are.

    Parameters
    ----------
    kalman : KalmanEstimator
        Walk and noise as the record tells them.
    time : ndarray, shape (n,) [s], increasing
    readings : ndarray, shape (n, n_sensors)
    level : sequence of float, one for each drive [unit of the drive]
    """
    if len(kalman.drives) > 1:
        # What a model gets wrong of one drive is taken for steps of the other.
        return "several drives are estimated"
    if not np.isfinite(readings).all():
        return "readings are missing"
    steps = np.diff(time)
    period = float(np.median(steps))
    if np.any(np.abs(steps - period) > MAX_UNEVEN * period):
        return "the clock is uneven"
    if kalman.walk[0] * math.sqrt(float(np.ptp(time))) < STANDSTILL * level[0]:
        return "the heat stands still"
    if len(time) > MAX_ROWS:
        return f"there are more than {MAX_ROWS} rows"
    return ""


def find_steps(
    kalman: KalmanEstimator, time: Float, readings: Float, level: Sequence[float], initial: Initial
) -> HeatSteps:
    """Steps of the heat in a record, beside a walk.

    Parameters
    ----------
    kalman : KalmanEstimator
        Walk and noise as the record tells them, without steps.
    time : ndarray, shape (n,) [s], increasing
        As even as `why_no_steps` asks.
    readings : ndarray, shape (n, n_sensors)
        Relative to rest, without NaN.
    level : sequence of float, one for each drive
        Standard deviation of a step, and of the heat at the first row [unit of the drive].
    settled : bool
        As in `smoother.smooth`.
    """
    sensed = replace(kalman, outputs=(), followed=())
    dt = float(np.median(np.diff(time)))
    of_walk = _StepSearch(sensed, dt, readings, level, initial).alone
    best: tuple[float, _StepSearch, Places] | None = None
    places: Places = ()
    for share in WALK_SHARES:
        if share == WALK_SHARES[-1] and best is not None and best[0] > of_walk:
            break
        quieter = replace(sensed, walk=tuple(math.sqrt(share) * each for each in sensed.walk))
        search = _StepSearch(quieter, dt, readings, level, initial)
        places, evidence = search.likeliest(places)
        if best is None or evidence > best[0]:
            best = evidence, search, places
        if evidence < of_walk - HOPELESS:
            break
    assert best is not None, "there is a share"
    evidence, search, places = best
    drawn = search.drawn(places) if evidence > of_walk else []
    return HeatSteps(
        evidence,
        of_walk,
        replace(kalman, walk=search.walk),
        search.variances(places),
        tuple(map(search.variances, drawn)),
    )


class _StepSearch:
    """Steps beside one walk: which rows are how likely.

    A place is an index into rows (every ``stride``-th) of all drives, one drive after the other.
    """

    def __init__(
        self,
        kalman: KalmanEstimator,
        dt: float,
        readings: Float,
        level: Sequence[float],
        initial: Initial,
    ) -> None:
        self.walk, self.rows = kalman.walk, len(readings)
        drives, modal = len(kalman.drives), kalman.modal
        self.stride = -(-self.rows * drives // MAX_PLACES)
        self.each = len(range(0, self.rows, self.stride))
        space = kalman.state_space(dt)
        start = kalman.start_covariance(dt, level, initial)
        self.smoother = EvenSmoother(space, start, self.rows, range(modal, modal + drives))
        G = space.F[:modal, modal : modal + drives]
        machine = Recursion(space.F[:modal, :modal], G, np.zeros_like(G), space.H[:, :modal])
        self.responses = [machine.run(np.tile(unit, (self.rows, 1)))[0] for unit in np.eye(drives)]
        squares = self.smoother.run(readings)[1]
        constant = readings.size * math.log(2 * math.pi)
        self.alone = -0.5 * (squares + self.smoother.log_determinant + constant)
        self.score = self._at_places(self.smoother.scores(readings))
        self.information = self._at_places(self.smoother.information())
        self.variance = np.repeat(np.square(level), self.each)
        self.columns: dict[int, Float] = {}

    def _at_places(self, values: Float) -> Float:
        return values[:: self.stride].T.ravel()

    def _column(self, place: int) -> Float:
        """How the score of every place answers to a step of one at a place."""
        if place not in self.columns:
            drive, row = divmod(place, self.each)
            row *= self.stride
            readings = np.zeros((self.rows, len(self.responses[drive][0])))
            readings[row:] = self.responses[drive][: self.rows - row]
            self.columns[place] = self._at_places(self.smoother.scores(readings))
        return self.columns[place]

    def _prior(self, count: int) -> float:
        """Of one set of so many places, any share of places being as likely."""
        n = len(self.score)
        return (math.lgamma(count + 1) + math.lgamma(n - count + 1) - math.lgamma(n + 2)
                if count <= n else -math.inf)  # fmt: skip

    def _weighed(self, places: Places, at: slice = slice(None)) -> tuple[float, Float]:
        """Evidence of a set over none, and what one more place would add to it, for each."""
        taken = list(places)
        score, information = self.score[at], self.information[at]
        variance, value = self.variance[at], self._prior(len(taken))
        if taken:
            columns = np.array([self._column(each) for each in taken])
            inner = columns[:, taken] + np.diag(1 / self.variance[taken])
            root = np.linalg.cholesky((inner + inner.T) / 2)
            z = np.linalg.solve(root, self.score[taken])
            B = np.linalg.solve(root, columns[:, at])
            score = score - z @ B
            information = np.maximum(information - np.einsum("ij,ij->j", B, B), 0.0)
            value += 0.5 * float(z @ z) - float(np.sum(np.log(np.diag(root))))
            value -= 0.5 * float(np.sum(np.log(self.variance[taken])))
        added = 0.5 * score**2 / (information + 1 / variance)
        added -= 0.5 * np.log1p(variance * information)
        added += self._prior(len(taken) + 1) - self._prior(len(taken))
        return value, added

    def _best_added(self, places: Places) -> tuple[float, Places]:
        value, added = self._weighed(places)
        added[list(places)] = -np.inf
        place = int(np.argmax(added))
        return value + float(added[place]), (*places, place)

    def likeliest(self, places: Places) -> tuple[Places, float]:
        """The likeliest set that is found from `places`, and the evidence of steps around it."""
        value = self._weighed(places)[0]
        while len(places) < MAX_STEPS:
            found, more = self._best_added(places)
            if found <= value + LEAST_GAIN:
                better = self._mended(places, value)
                if better is None:
                    break
                places, value = better
                continue
            places, value = more, found
        return places, self.alone + value + self._of_neighbours(places)

    def _of_neighbours(self, places: Places) -> float:
        """What sets add to the evidence that differ from the likeliest in a place's row [nats]."""
        more = 0.0
        for each in places:
            at, added = self._others(places, each)
            # None is likelier than the place itself, but for what the search has left.
            more += float(np.logaddexp.reduce(np.minimum(added - added[each - at], 0.0)))
        return more

    def _mended(self, places: Places, value: float) -> tuple[Places, float] | None:
        """A likelier set: a place left out or moved, or two neighbours made one."""
        began = value
        for each in sorted(places):
            fewer = tuple(other for other in places if other != each)
            places, value = self._likelier(fewer, places, value)
        ordered = sorted(places)
        for one, two in itertools.pairwise(ordered):
            if one in places and two in places and one // self.each == two // self.each:
                fewer = tuple(other for other in places if other not in (one, two))
                places, value = self._likelier(fewer, places, value)
        return (places, value) if value > began + LEAST_GAIN else None

    def _likelier(self, fewer: Places, places: Places, value: float) -> tuple[Places, float]:
        without = self._weighed(fewer)[0]
        moved, more = self._best_added(fewer)
        if max(without, moved) <= value + LEAST_GAIN:
            return places, value
        return (fewer, without) if without >= moved else (more, moved)

    def drawn(self, places: Places) -> list[Places]:
        """Draws from the distribution of the places, which depend on the readings alone."""
        generator = np.random.default_rng(0)
        found = []
        for turn in range(ROUNDS_BEFORE + DRAWS * ROUNDS_BETWEEN):
            for each in places:
                places = self._moved(places, each, generator)
            places = self._born_or_dead(places, generator)
            if turn >= ROUNDS_BEFORE and (turn - ROUNDS_BEFORE) % ROUNDS_BETWEEN == 0:
                found.append(places)
        return found

    def _moved(self, places: Places, place: int, generator: np.random.Generator) -> Places:
        """A place drawn anew between its neighbours, given all others."""
        low, added = self._others(places, place)
        odds = np.exp(added - np.max(added))
        moved = low + int(generator.choice(len(odds), p=odds / np.sum(odds)))
        return (*(each for each in places if each != place), moved)

    def _others(self, places: Places, place: int) -> tuple[int, Float]:
        """Where a place could be between its neighbours: the first, and what each would add."""
        drive, others = place // self.each, tuple(each for each in places if each != place)
        of_drive = [each for each in others if each // self.each == drive]
        low = max((each + 1 for each in of_drive if each < place), default=drive * self.each)
        high = min((each for each in of_drive if each > place), default=(drive + 1) * self.each)
        return low, self._weighed(others, slice(low, high))[1]

    def _born_or_dead(self, places: Places, generator: np.random.Generator) -> Places:
        """One place more, drawn by what it would add, or one less (Green 1995)."""
        if generator.uniform() < 0.5:
            odds = self._odds(places)
            if len(places) < MAX_STEPS and generator.uniform() * (len(places) + 1) < np.sum(odds):
                odds = odds / np.sum(odds)
                return (*places, int(generator.choice(len(odds), p=odds)))
        elif places:
            gone = places[int(generator.integers(len(places)))]
            others = tuple(each for each in places if each != gone)
            if generator.uniform() * np.sum(self._odds(others)) < len(places):
                return others
        return places

    def _odds(self, places: Places) -> Float:
        """How much likelier a set is with each place more."""
        added = self._weighed(places)[1]
        added[list(places)] = -np.inf
        return np.exp(np.minimum(added, 500.0))

    def variances(self, places: Places) -> Float:
        """Variance of a step in every row, shape (n, n_drives)."""
        found = np.zeros((self.rows, len(self.score) // self.each))
        for place in places:
            drive, row = divmod(place, self.each)
            found[row * self.stride, drive] = self.variance[place]
        return found
