"""Few rows that stand for many: averages of inputs, through lags, and of one output.

y = Σ_i [w_i0 u_i + Σ_j w_ij u_i/(τ_j s + 1)] + offset + Σ_j a_j e^(−t/τ_j) + v

with the time constants on a grid, and a decay for each piece that does not begin at rest. The error
v is a first-order process (AR(1) from average to average, with a correlation time of its own), the
weights of components are normal with one variance: a ridge, of which the evidence decides, the
likelihood of the output with the weights integrated out (MacKay 1992; Rasmussen and Williams 2006,
5.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import DataError, FitError
from thermaltool.fitting.components.reduction import Reduction
from thermaltool.fitting.data import Array, Split, TrainingData
from thermaltool.fitting.network.problem import mode_responses
from thermaltool.signals.start_level import start_level
from thermaltool.signals.symmetric import eigh
from thermaltool.units import is_displacement, parse_channel

# Averages that stand for the records at least and at most, and rows of each between.
AVERAGES, AVERAGED_ROWS = (200, 2000), 20
# Averages below which nothing is to be held out in five blocks.
MIN_AVERAGES = 25
# Time constants of the grid, from one average to this part of the longest record.
GRID_TIMES, LONGEST_PART = 6, 4
# Variance of the averages' errors over that of the weights, of which the evidence decides.
RIDGES = 10.0 ** np.arange(-10, 5.1, 0.5)
# Correlation times of the errors: so many, from averages to this part of the longest record.
ERROR_TIMES, SHORTEST_ERROR, LONGEST_ERROR = 4, 4, 0.6
# Errors below this share of the output are rounding.
MIN_ERROR = 1e-12


@dataclass(frozen=True)
class Choice:
    """What is not estimated with the weights.

    Attributes
    ----------
    components : int
    lags : tuple of int
        Of the grid of time constants.
    direct : bool
        Whether the inputs themselves count beside their lags.
    error_time : float [s]
        Correlation time of the errors; zero where they are white.
    ridge : float
        Variance of what drives the errors over that of the weights; zero: by the evidence.
    """

    components: int
    lags: tuple[int, ...]
    direct: bool = True
    error_time: float = 0.0
    ridge: float = 0.0

    @property
    def slots(self) -> tuple[int, ...]:
        """What the weights are of: 0 the inputs themselves, 1 + k lag k."""
        return (*((0,) if self.direct else ()), *(1 + lag for lag in self.lags))


@dataclass(frozen=True)
class Weights:
    """Weights of every input, found for one choice.

    Attributes
    ----------
    choice : Choice
    level : float
        Logarithm of the evidence, for each average, times −2: of an error variance.
    values : ndarray, shape (1 + N, m)
        Of the inputs themselves, then of each lag.
    decays : ndarray, shape (pieces · N,)
        Of what the start of each piece leaves, where it is not at rest.
    offsets : ndarray, shape (experiments,)
    covariance : ndarray, shape ((1 + N) · m, (1 + N) · m)
        Of `values` in a row.
    freedom : float
        How many weights the ridge leaves free.
    """

    choice: Choice
    level: float
    values: Array
    decays: Array
    offsets: Array
    covariance: Array
    freedom: float


class ComponentProblem:
    """Averages of one output and of what its inputs become through every lag of the grid.

    Parameters
    ----------
    data : TrainingData
        One output, on an even clock.
    reduction : Reduction

    Raises
    ------
    FitError
        Too few rows, or an output that does not move.
    """

    def __init__(self, data: TrainingData, reduction: Reduction) -> None:
        self.data, self.reduction = data, reduction
        output = data.output()
        if not np.ptp(output[np.isfinite(output)]) > 0:
            (name,) = data.outputs
            raise DataError(
                f"{name} is constant over the rows that are fitted: there is nothing to identify",
                name,
            )
        least, most = (data.rows // count for count in AVERAGES)
        self.rows = max(1, min(least, max(AVERAGED_ROWS, most)))
        shortest, longest = self.rows * data.period, data.duration / LONGEST_PART
        self.times: Array = np.geomspace(max(longest, 2 * shortest), shortest, GRID_TIMES)
        self.error_times: Array = np.geomspace(
            SHORTEST_ERROR * shortest, max(LONGEST_ERROR * data.duration, 5 * shortest), ERROR_TIMES
        )
        parts = [len(record) // self.rows for record in data.records]
        if sum(parts) < MIN_AVERAGES:
            raise FitError(f"{data.rows} rows are too few to hold out blocks of them")
        self.record: NDArray[np.intp] = np.repeat(np.arange(len(parts)), parts)
        self.first_row = np.concatenate([self.rows * np.arange(n) for n in parts])
        self.origin = np.array([record.origin for record in data.records])[self.record]
        self.output = self._averaged([y[0] for y in data.y])
        # As simulate has it, a displacement counts from where its log begins at rest.
        begins = data.begins if is_displacement(data.outputs[0]) else {}
        self.levels = {
            e: start_level(data.y[k][0]).value for e, k in begins.items() if data.records[k].at_rest
        }

    def _averaged(self, series: Sequence[Array]) -> Array:
        """Averages of rows of every record, in a row, shape (..., averages)."""
        found = []
        for values in series:
            count = values.shape[-1] // self.rows
            kept = values[..., : count * self.rows]
            found.append(kept.reshape(*values.shape[:-1], count, self.rows).mean(axis=-1))
        return np.concatenate(found, axis=-1)

    @cached_property
    def inputs(self) -> Array:
        """Averages of every input and of it through every lag, shape (1 + N, m, averages)."""
        data, none = self.data, (0.0,)
        found = []
        for i in range(len(data.inputs)):
            parts = []
            for record, u in zip(data.records, data.u, strict=True):
                level = data.levels[record.origin][i : i + 1]
                lagged = mode_responses(
                    record.elapsed, u[i : i + 1], level, self.times, none, data.holds[i : i + 1]
                )
                parts.append(np.vstack([u[i] - level, lagged]))
            found.append(self._averaged(parts))
        return np.array(found).transpose(1, 0, 2)

    @cached_property
    def decays(self) -> Array:
        """Of every lag in every piece that does not begin at rest, shape (N, pieces, averages)."""
        free = [k for k, record in enumerate(self.data.records) if not record.at_rest]
        found = np.zeros((len(self.times), len(free), len(self.output)))
        averaged = self._averaged(
            [np.exp(-r.elapsed / self.times[:, None]) for r in self.data.records]
        )
        for place, k in enumerate(free):
            own = self.record == k
            found[:, place, own] = averaged[:, own]
        return found

    def held(self, split: Split) -> NDArray[np.bool_]:
        """Averages that a split holds out.

        Parameters
        ----------
        split : Split
            Of the data.
        """
        starts, stops = (np.array(ends)[self.record] for ends in (split.starts, split.stops))
        middle = self.first_row + self.rows / 2
        return np.asarray((middle >= starts) & (middle < stops))

    def errors(self, weights: Weights) -> Array:
        """Errors of all averages, shape (averages,).

        Parameters
        ----------
        weights : Weights
        """
        lags = np.array(weights.choice.lags, dtype=np.intp)
        known = np.tensordot(weights.values, self.inputs[[0, *(1 + lags)]], 2)
        known = known + weights.decays @ self.decays[lags].reshape(-1, len(self.output))
        return np.asarray(self.output - known - weights.offsets[self.origin])

    def fit(
        self,
        fitted: NDArray[np.bool_],
        choices: Sequence[Choice],
        with_covariance: bool = True,
    ) -> list[Weights]:
        """Weights of choices, each with the ridge of most evidence where its own is zero.

        Parameters
        ----------
        fitted : ndarray of bool, shape (averages,)
            Those that count.
        choices : sequence of Choice
            Those of one error time, and then those that differ in their ridge, one after the other.
        with_covariance : bool
            Else that of the weights is empty.
        """
        columns, output = (
            self._about_means(x, fitted)[..., fitted] for x in (self.inputs[0], self.output)
        )
        units = [parse_channel(name).unit for name in self.data.inputs]
        loadings = self.reduction.loadings(columns, output, units)
        found = []
        whitened: _Whitened | None = None
        solved: _Solved | None = None
        for choice in choices:
            if whitened is None or whitened.error_time != choice.error_time:
                whitened, solved = self._whitened(fitted, choice.error_time, loadings), None
            plain = replace(choice, ridge=0.0)
            if solved is None or solved.choice != plain:
                solved = self._solved(whitened, plain, len(loadings))
            weights = self._weights(whitened, solved, choice, loadings, fitted, with_covariance)
            found.append(weights)
        return found

    def _about_means(self, values: Array, fitted: NDArray[np.bool_]) -> Array:
        result = values.copy()
        for e in np.unique(self.origin[fitted]):
            own = self.origin == e
            result[..., own] -= values[..., own & fitted].mean(axis=-1, keepdims=True)
        return result

    def _whitened(self, fitted: NDArray[np.bool_], error_time: float, loadings: Array) -> _Whitened:
        """Sums over the averages, less what of each follows from the one before."""
        kept = np.exp(-self.rows * self.data.period / error_time) if error_time else 0.0
        after = np.flatnonzero(fitted[1:] & fitted[:-1] & (self.record[1:] == self.record[:-1])) + 1
        scores = np.einsum("ik,lin->lkn", loadings, self.inputs)
        columns = np.concatenate([scores.reshape(-1, scores.shape[-1]),
                                  self.decays.reshape(-1, scores.shape[-1])])  # fmt: skip
        whole = np.vstack([columns, self.output])
        moved = whole[:, after] - kept * whole[:, after - 1]
        origins = self.origin[after]
        for e in np.unique(origins):
            own = origins == e
            if e in self.levels:
                moved[-1, own] -= (1 - kept) * self.levels[e]
            else:
                moved[:, own] -= moved[:, own].mean(axis=1, keepdims=True)
        gram = moved @ moved.T
        return _Whitened(error_time, gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]), len(after))

    def _solved(self, whitened: _Whitened, choice: Choice, inputs: int) -> _Solved:
        pieces, first = self.decays.shape[1], inputs * (1 + len(self.times))
        place = np.concatenate([
            *(inputs * slot + np.arange(choice.components) for slot in choice.slots),
            *(first + pieces * lag + np.arange(pieces) for lag in choice.lags),
        ]).astype(np.intp)  # fmt: skip
        values, vectors = eigh(whitened.gram[np.ix_(place, place)])
        pull = vectors.T @ whitened.cross[place]
        return _Solved(choice, np.maximum(values, 0.0), vectors, pull)

    def _weights(
        self,
        whitened: _Whitened,
        solved: _Solved,
        choice: Choice,
        loadings: Array,
        fitted: NDArray[np.bool_],
        with_covariance: bool,
    ) -> Weights:
        k, n = choice.components, whitened.count
        values, vectors, pull = solved.values, solved.vectors, solved.pull
        ridges = RIDGES if not choice.ridge else np.array([choice.ridge])
        left = whitened.power - np.sum(pull[:, None] ** 2 / (values[:, None] + ridges), axis=0)
        left = np.maximum(left, MIN_ERROR * whitened.power)
        levels = np.log(left / n) + np.sum(np.log1p(values[:, None] / ridges), axis=0) / n
        best = int(np.argmin(levels))
        spread = values + ridges[best]
        linear = vectors @ (pull / spread)
        split = k * len(choice.slots)
        # Of the inputs themselves and of every lag; those do not count where there are none.
        places = [0, *(1 + lag for lag in choice.lags)]
        put = np.eye(len(places))[:, [places.index(slot) for slot in choice.slots]]
        covariance = np.zeros((0, 0))
        if with_covariance:
            turn = np.kron(put, loadings[:, :k])
            deviation = turn @ (vectors[:split] * np.sqrt(left[best] / n / spread))
            covariance = deviation @ deviation.T
        found = Weights(
            replace(choice, ridge=float(ridges[best])),
            float(levels[best]),
            put @ linear[:split].reshape(-1, k) @ loadings[:, :k].T,
            linear[split:],
            np.zeros(self.data.experiments),
            covariance,
            float(np.sum(vectors[:split] ** 2 * (values / spread))),
        )
        errors, offsets = self.errors(found), found.offsets
        for e in np.unique(self.origin[fitted]):
            own = errors[fitted & (self.origin == e)]
            offsets[e] = self.levels.get(int(e), float(own.mean()))
        return found


@dataclass(frozen=True)
class _Whitened:
    """Sums of whitened averages: of columns, of them with the output, of the output."""

    error_time: float
    gram: Array
    cross: Array
    power: float
    count: int


@dataclass(frozen=True)
class _Solved:
    """Eigenvalues and vectors of the sums of one choice, and the output along them."""

    choice: Choice
    values: Array
    vectors: Array
    pull: Array
