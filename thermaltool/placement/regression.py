"""Thermal errors as sums of temperatures, at one position or along an axis.

E(P, t) = Σ_i [β0i + β1i P + β2i P² + …] T_i(t) + γ1 P + γ2 P² + … + offset (Zhu, Ni, Shih 2008, 12
and 13; γ is the error at rest), with T_i as they are read, or with low-pass states of them beside:
x_ij' = (T_i − x_ij)/τ_j. All is linear in the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_model import effective_share
from thermaltool.fitting.excitation import MIN_MOVEMENT
from thermaltool.fitting.network.problem import mode_responses
from thermaltool.fitting.selection import BLOCKS
from thermaltool.model import rest_level
from thermaltool.placement.estimators import ESTIMATORS, Method, blocks_of
from thermaltool.record import Record
from thermaltool.units import drive_reference

Rows = NDArray[np.bool_]
Index = NDArray[np.intp]
# The zero of a log of which no row was fitted comes from so many of its first rows at most, or from
# this part of them, three at least.
ZERO_ROWS, ZERO_PART = 30, 0.05
# Rows of a log that count as independent at least: of errors that are nearly periodic an AR model
# leaves hardly any, and the evidence would rather have no weight.
LEAST_INDEPENDENT = 20.0
# Highest power of a position that is tried.
MAX_DEGREE = 3
# A term stays where the criterion falls by more than this without it.
MIN_CRITERION = 1e-9


@dataclass(frozen=True)
class Basis:
    """What the error is a sum of.

    Attributes
    ----------
    sensors : tuple of str
    time_constants : tuple of float [s]
        Of low-pass states of every sensor, beside the sensor itself.
    position : str or None
        Channel of the position along the axis.
    degree : int
        Highest power of the position.
    """

    sensors: tuple[str, ...]
    time_constants: tuple[float, ...] = ()
    position: str | None = None
    degree: int = 0


@dataclass(frozen=True)
class Column:
    """One term of the sum.

    Attributes
    ----------
    sensor : str or None
        None: a power of the position alone.
    lag : int
        0 for the sensor itself, k for its state of time constant k.
    power : int
        Of the position.
    """

    sensor: str | None
    lag: int = 0
    power: int = 0


@dataclass(frozen=True)
class ThermalRegression:
    """Fitted weights.

    Attributes
    ----------
    columns : tuple of Column
    weights, deviations : ndarray, shape (F,) [unit of the output per unit of the column]
    covariance : ndarray, shape (F, F)
    offsets : mapping of experiment to float
    rmse : float [unit of the output]
        Over the rows that were fitted.
    rows : int
    freedom : float
        How many weights are free.
    method : str
    """

    columns: tuple[Column, ...]
    weights: Array
    covariance: Array
    offsets: dict[int, float]
    rmse: float
    rows: int
    freedom: float
    method: str

    @property
    def deviations(self) -> Array:
        """Standard errors of the weights."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


class RegressionProblem:
    """Columns of a basis and one output, over all rows where the output is there.

    Parameters
    ----------
    data : TrainingData
        With one output, on the clocks of its logs.
    basis : Basis
    dead : bool
        Whether sensors may stand still: in rows that judge alone.

    Raises
    ------
    FitError
        A sensor that never moves, positions without readings or with one value, an output that is
        constant or missing.
    """

    def __init__(self, data: TrainingData, basis: Basis, dead: bool = False) -> None:
        self.data, self.basis, self.output = data, basis, data.outputs[0]
        known = [np.isfinite(record.column(self.output)) for record in data.records]
        if not any(rows.any() for rows in known):
            raise FitError(f"{self.output} has no reading in any log")
        self.columns = tuple(_columns(basis))
        # States carry on over the pauses of a log, as `simulate` has it.
        logs = groupby(data.records, key=lambda record: record.origin)
        parts = [self._values_of(list(pieces)) for _, pieces in logs]
        self.values: Array = np.concatenate(parts, axis=1)[:, np.concatenate(known)]
        self._known = known
        self.measured = self.joined(self.output)
        counts = [int(rows.sum()) for rows in known]
        self.origin: Index = np.repeat([record.origin for record in data.records], counts)
        self.record: Index = np.repeat(np.arange(len(counts)), counts)
        if not dead:
            self._check()

    def _check(self) -> None:
        basis = self.basis
        if not np.ptp(self.measured) > 0:
            raise FitError(f"{self.output} is constant: there is nothing to fit")
        for name in basis.sensors:
            if not moves([self.joined(name)]):
                raise FitError(f"{name} never moves in training: a dead sensor has no weight")
        if basis.position is not None and np.unique(self.joined(basis.position)).size < 2:
            raise FitError(f"{basis.position} has one value: no error along the axis is seen")

    def joined(self, name: str) -> Array:
        """A channel of the logs at all rows, shape (rows,).

        Parameters
        ----------
        name : str
        """
        pairs = zip(self.data.records, self._known, strict=True)
        return np.concatenate([record.column(name)[rows] for record, rows in pairs])

    def with_columns(self, columns: Sequence[Column]) -> RegressionProblem:
        """The same with some of its columns alone.

        Parameters
        ----------
        columns : sequence of Column
        """
        found = copy(self)
        found.values, found.columns = self.values[self._places(columns)], tuple(columns)
        return found

    @property
    def every(self) -> Rows:
        """All rows."""
        return np.ones(len(self.measured), bool)

    def scale(self, columns: Sequence[Column] | None = None) -> Array:
        """Size of each column, one for all sensors at the same power, shape (F,)."""
        columns = self.columns if columns is None else columns
        power = np.mean(self.values[self._places(columns)] ** 2, axis=1)
        kinds = np.array([c.power if c.sensor else -c.power for c in columns])
        means = {kind: float(np.sqrt(np.mean(power[kinds == kind]))) for kind in set(kinds)}
        return np.array([means[kind] or 1.0 for kind in kinds])

    def _places(self, columns: Sequence[Column]) -> Index:
        where = {column: k for k, column in enumerate(self.columns)}
        return np.array([where[column] for column in columns], np.intp)

    def _values_of(self, pieces: Sequence[Record]) -> Array:
        """All columns over all rows of the pieces of one log."""
        data, basis = self.data, self.basis
        time, taus = np.concatenate([r.time for r in pieces]), np.array(basis.time_constants)

        def whole(name: str) -> Array:
            return np.concatenate([r.column(name) for r in pieces])

        powers = [np.ones(len(time))]
        if basis.position is not None:
            at = whole(basis.position)
            powers = [at**power for power in range(basis.degree + 1)]
        rows: list[Array] = []
        for name in basis.sensors:
            hold, u = data.holds[data.inputs.index(name)], whole(name)
            level = rest_level(u, drive_reference(name), hold)
            states = [u - level]
            if basis.time_constants:
                own = np.array([level])
                states += list(mode_responses(time - time[0], u[None], own, taus, (0.0,), (hold,)))
            rows += [state * power for state in states for power in powers]
        return np.array([*rows, *powers[1:]])

    def fit(
        self, fitted: Rows, method: Method = "ridge", columns: Sequence[Column] | None = None
    ) -> ThermalRegression:
        """Weights by some rows.

        Parameters
        ----------
        fitted : ndarray of bool, shape (rows,)
        method : {"least-squares", "ridge", "elastic-net", "pcr", "pls"}
        columns : sequence of Column, optional
            Those that are taken. Default: all.

        Raises
        ------
        FitError
            Fewer rows than weights.
        """
        columns = self.columns if columns is None else tuple(columns)
        rows = int(fitted.sum())
        if rows <= len(columns) + 1:
            raise FitError(
                f"{self.output}: {rows} rows do not determine {len(columns)} weights: take fewer "
                "sensors, powers or time constants"
            )
        scale = self.scale(columns)
        x = self.values[self._places(columns)] / scale[:, None]
        inside, y = x[:, fitted], self.measured[fitted]
        origins = self.origin[fitted]
        inside, y = _about_means(inside, origins), _about_means(y, origins)
        folds = list(blocks_of(np.arange(rows), BLOCKS, rows))
        found = ESTIMATORS["least-squares"](inside, y, folds, 1.0)
        part = 1.0
        if method != "least-squares":
            part = self._independent(y - found.weights @ inside, fitted)
            found = ESTIMATORS[method](inside, y, folds, part)
        errors = self.measured - found.weights @ x
        offsets = {
            int(e): float(errors[fitted & (self.origin == e)].mean()) for e in np.unique(origins)
        }
        left = y - found.weights @ inside
        if method == "least-squares":
            part = self._independent(left, fitted)
        freedom = max(rows * part - found.freedom - len(offsets), 1.0)
        variance = float(left @ left) * part / freedom
        covariance = variance / part * found.spread / np.outer(scale, scale)
        return ThermalRegression(
            columns, found.weights / scale, covariance, offsets, float(np.sqrt(np.mean(left**2))),
            rows, found.freedom, f"{method} {found.tuning}".strip(),
        )  # fmt: skip

    def _independent(self, errors: Array, fitted: Rows) -> float:
        """Part of the rows that are worth an independent one each."""
        ends = np.flatnonzero(np.diff(self.record[fitted])) + 1
        least = LEAST_INDEPENDENT / len(errors)
        return min(max(effective_share(np.split(errors, ends)), least), 1.0)

    def computed(self, found: ThermalRegression, rows: Rows) -> Array:
        """The error by a regression, in the readings of the logs, shape (rows,).

        A log of which no row was fitted counts from its own first rows, as `simulate` has it.

        Parameters
        ----------
        found : ThermalRegression
        rows : ndarray of bool
        """
        y = found.weights @ self.values[self._places(found.columns)]
        for e in np.unique(self.origin[rows]):
            own = np.flatnonzero(self.origin == e)
            offset = found.offsets.get(int(e))
            if offset is None:
                first = own[: max(min(ZERO_ROWS, int(ZERO_PART * len(own))), 3)]
                offset = float(np.median(self.measured[first] - y[first]))
            y[own] += offset
        return np.asarray(y[rows])

    def error(self, fitted: Rows, held: Rows, method: Method = "ridge") -> float:
        """Root mean square of what a fit to some rows misses of others [unit of the output].

        Parameters
        ----------
        fitted, held : ndarray of bool
        method : as for `fit`
        """
        found = self.fit(fitted, method)
        return float(np.sqrt(np.mean((self.measured[held] - self.computed(found, held)) ** 2)))

    def selected(self, degrees: int = MAX_DEGREE) -> tuple[Column, ...]:
        """Columns that the evidence keeps: first the power of the position, then term by term.

        By BIC, −2 ln of the evidence to a constant (Schwarz 1978), with the rows that are
        independent.

        Parameters
        ----------
        degrees : int
            Highest power that is tried.
        """
        every = self.every
        whole = self.fit(every, "least-squares")
        left = self.measured - self.computed(whole, every)
        n = max(self._independent(left, every) * len(left), len(self.columns) + 2.0)

        def level(columns: Sequence[Column]) -> float:
            rmse = self.fit(every, "least-squares", columns).rmse
            return 2 * n * np.log(max(rmse, 1e-300)) + len(columns) * np.log(n)

        tried = [
            tuple(c for c in self.columns if c.power <= degree)
            for degree in range(min(degrees, self.basis.degree) + 1)
        ]
        kept = min(tried, key=level)
        while len(kept) > 1:
            fewer = [tuple(c for c in kept if c is not gone) for gone in kept]
            best = min(fewer, key=level)
            if level(best) >= level(kept) - MIN_CRITERION:
                break
            kept = best
        return kept


def moves(parts: Sequence[Array]) -> bool:
    """Whether a sensor moves within the logs.

    Parameters
    ----------
    parts : sequence of ndarray, shape (rows,)
        Its readings in each log.
    """
    values = np.concatenate(parts)
    return bool(np.ptp(values) > MIN_MOVEMENT * np.max(np.abs(values)))


def _columns(basis: Basis) -> list[Column]:
    lags, powers = range(1 + len(basis.time_constants)), range(basis.degree + 1)
    own = [Column(s, lag, power) for s in basis.sensors for lag in lags for power in powers]
    return [*own, *(Column(None, 0, power) for power in powers[1:])]


def _about_means(values: Array, origins: Index) -> Array:
    result = values.copy()
    for e in np.unique(origins):
        own = origins == e
        result[..., own] -= values[..., own].mean(axis=-1, keepdims=True)
    return result
