"""Rows at which a heat steps beside a walk, on an even clock: how likely each set of them is.

For given rows all is Gaussian, and what a step more or less adds to the likelihood is known in
closed form from the smoother's adjoint, so the rows are searched one by one (Champagnat, Goussard
and Idier 1996). Draws from their distribution are reversible jumps (Green 1995).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from thermaltool.estimation.estimator import KalmanEstimator
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.responses.modes import Float
from thermaltool.responses.recursion import Recursion

# Rows that may hold a step: in a longer record every second row may, or fewer.
MAX_PLACES = 8000
# More steps are not looked for.
MAX_STEPS = 150
# Draws from the distribution of the rows, how many rounds lie between two, and before the first.
DRAWS, ROUNDS_BETWEEN, ROUNDS_BEFORE = 8, 4, 6
# Below it an improvement is rounding [nats].
LEAST_GAIN = 1e-6

Places = tuple[int, ...]


def _places(rows: int, drives: int) -> tuple[int, int]:
    """Rows from place to place, and places of each drive."""
    stride = -(-rows * drives // MAX_PLACES)
    return stride, len(range(0, rows, stride))


def places_of(runs: Sequence[slice], drives: int) -> int:
    """Places of all runs of a record.

    Parameters
    ----------
    runs : sequence of slice
    drives : int
    """
    return drives * sum(_places(run.stop - run.start, drives)[1] for run in runs)


class StepSearch:
    """Steps beside one walk: which rows are how likely.

    A place is an index into rows (every ``stride``-th) of all drives, one drive after the other.

    Parameters
    ----------
    kalman : KalmanEstimator
        With that walk, and without outputs.
    dt : float [s]
    readings : ndarray, shape (n, n_sensors)
        Relative to rest, without NaN.
    level : sequence of float, one for each drive
        Standard deviation of a step [unit of the drive].
    state : ndarray, shape (m,)
        What is expected of the state at the first row, before its reading,
    covariance : ndarray, shape (m, m)
        and how far it may be from that.
    places : int, optional
        Of the record of which these rows are a part; without it they are all of it.
    earlier : int, optional
        Steps that earlier rows of it have; without it there are none.
    """

    def __init__(
        self,
        kalman: KalmanEstimator,
        dt: float,
        readings: Float,
        level: Sequence[float],
        state: Float,
        covariance: Float,
        places: int | None = None,
        earlier: int | None = None,
    ) -> None:
        self.walk, self.rows = kalman.walk, len(readings)
        drives, modal = len(kalman.drives), kalman.modal
        self.stride, self.each = _places(self.rows, drives)
        self.places, self.earlier = places or self.each * drives, earlier
        space = kalman.state_space(dt)
        if state.any():
            nothing = np.zeros((len(space.F), 1))
            still = Recursion(space.F, nothing, nothing, space.H)
            readings = readings - still.run(np.zeros((self.rows, 1)), state)[0]
        self.smoother = EvenSmoother(space, covariance, self.rows, range(modal, modal + drives))
        G = space.F[:modal, modal : modal + drives]
        machine = Recursion(space.F[:modal, :modal], G, np.zeros_like(G), space.H[:, :modal])
        self.responses = [machine.run(np.tile(unit, (self.rows, 1)))[0] for unit in np.eye(drives)]
        squares = self.smoother.start(readings)[1]
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
        """Of one set of so many places, any share of those of the record being as likely.

        What earlier runs have of it is theirs: the values of all runs add up.
        """
        if count > len(self.score):
            return -math.inf
        if self.earlier is None:
            return self._of_record(count)
        return self._of_record(self.earlier + count) - self._of_record(self.earlier)

    def _of_record(self, count: int) -> float:
        n = self.places
        return math.lgamma(count + 1) + math.lgamma(n - count + 1) - math.lgamma(n + 2)

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
