"""Kinds of response fitted to the same records, with the errors on rows held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.averaging import known_noise
from thermaltool.fitting.candidate_data import FOLDS, CandidateData
from thermaltool.fitting.parametrization import Parametrization
from thermaltool.fitting.possible import Soundness
from thermaltool.fitting.projection import CalibrationProblem, GridStates
from thermaltool.fitting.start_search import COARSE, StartSearch
from thermaltool.model import Drive
from thermaltool.record import Record
from thermaltool.responses import Response, response_class
from thermaltool.responses.modes import Float
from thermaltool.signals.robust import robust_std

# Starts of each search that are refined. With several drives kinds have many minima, and one that
# is judged by a wrong one loses to a kind that can do anything; fewer do where delays are compared.
STARTS, FEW_STARTS = 16, 2
# Sums over so many blocks say how many rows are independent.
INDEPENDENT_BLOCKS = 48
# Rows whose residual is beyond so many robust deviations of a first fit take no part.
MAX_DEVIATIONS = 8.0


@dataclass(frozen=True)
class FittedKinds:
    """Kinds of response fitted to all rows.

    Attributes
    ----------
    kinds : tuple of str, one for each drive
    delays : tuple of float [s]
    parameters : int
        Fitted ones, without offsets.
    theta : ndarray, shape (searched,)
        Logarithms of rates and shapes.
    residual : ndarray, shape (groups,) [unit of the output]
        Of the mean of a group of rows, times the root of their number.
    soundness : Soundness
    search : StartSearch
    data : CandidateData
    common : bool
        Whether all drives that act share their rates.
    """

    kinds: tuple[str, ...]
    delays: tuple[float, ...]
    parameters: int
    theta: Float
    residual: Float
    soundness: Soundness
    search: StartSearch
    data: CandidateData
    common: bool = False

    def rates(self, drive: int) -> Float:
        """Logarithms of one drive's rates and shapes, shape (own searched,).

        Parameters
        ----------
        drive : int
        """
        return self.search.parametrization.parts(self.theta)[drive]

    @property
    def gains(self) -> Float:
        """Gains of all responses, shape (gains,)."""
        linear = self.search.fitted(self.theta, self.data.whole)[1]
        return linear[: self.search.parametrization.gains]

    @property
    def responses(self) -> tuple[Response, ...]:
        """One for each drive."""
        return self.search.parametrization.responses(self.theta, self.gains)

    @property
    def weights(self) -> Float:
        """Of every rate of the grid, shape (drives, rates)."""
        own = self.search.parametrization
        unit = own.unit_weights(self.theta, self.data.problem.grid)
        return np.asarray((unit @ self.gains).reshape(len(own.classes), -1))

    @property
    def size(self) -> float:
        """Sum of squares [unit² of the output]."""
        return float(np.sum(self.residual**2))

    @property
    def independent(self) -> float:
        """Rows that count as independent."""
        return independent_rows(self.residual)

    @cached_property
    def held_out(self) -> Float:
        """Errors as `residual`, by fits that have not seen the rows, shape (groups,)."""
        errors = np.zeros_like(self.residual)
        for k, triangle in enumerate(self.data.folds):
            there = self.data.fold == k
            near = self.search.refine(self.theta, triangle)[1]
            errors[there] = self.search.fitted(near, triangle)[0][there]
        return errors


@dataclass
class KindSearch:
    """All that candidates share: records, drives, and the rows that count.

    Attributes
    ----------
    records : sequence of Record
    drives : sequence of Drive
    output : str
    free_start : bool
    fixed : mapping of parameter name to value
    states : dict
        See `CalibrationProblem.assemble`, and
    equilibrium : bool
        there.
    """

    records: Sequence[Record]
    drives: Sequence[Drive]
    output: str
    free_start: bool
    fixed: Mapping[str, float]
    states: GridStates
    equilibrium: bool = False
    _data: dict[tuple[float, ...], CandidateData] = field(default_factory=dict)

    def without(self, drive: int) -> KindSearch:
        """The same rows with one drive left out, by its number.

        Parameters
        ----------
        drive : int
        """
        return self.driven_by([each for k, each in enumerate(self.drives) if k != drive])

    def from_rest(self) -> KindSearch:
        """The same rows, at rest at their first."""
        return self._with(free_start=False)

    def out_of_equilibrium(self) -> KindSearch:
        """The same rows, any gain to the surroundings allowed."""
        return self._with(equilibrium=False)

    def driven_by(
        self,
        drives: Sequence[Drive],
        states: GridStates | None = None,
        records: Sequence[Record] | None = None,
    ) -> KindSearch:
        """The same rows with other drives.

        Parameters
        ----------
        drives : sequence of Drive
        states : dict, optional
            Of these drives, where they go on otherwise between samples or have other values.
        records : sequence of Record, optional
            With other values of the drives.
        """
        kept, of = self.states if states is None else states, records or self.records
        return self._with(records=of, drives=drives, states=kept)

    def _with(self, **changes: Any) -> KindSearch:
        """Another search of the same rows."""
        other = replace(self, _data={}, **changes)
        other.__dict__["_sound"] = self._sound
        return other

    @cached_property
    def duration(self) -> float:
        """Of the longest record [s]."""
        return max(record.duration for record in self.records)

    @cached_property
    def period(self) -> float:
        """Shortest sample period [s]."""
        return min(record.period for record in self.records)

    @property
    def _noise(self) -> float | None:
        return known_noise(self.records, self.output)

    def _parametrization(self, kinds: Sequence[str], common: bool = False) -> Parametrization:
        classes = tuple(response_class(kind) for kind in kinds)
        constants = tuple({k: self.fixed.get(k, v) for k, v in c.fixed.items()} for c in classes)
        return Parametrization(classes, constants, common)

    def _search(
        self, data: CandidateData, kinds: Sequence[str], common: bool = False
    ) -> StartSearch:
        return self._coarse(data.problem, self._parametrization(kinds, common))

    def _coarse(self, problem: CalibrationProblem, own: Parametrization) -> StartSearch:
        limits = own.limits(self.period, self.duration, self.free_start, problem.longest)
        return StartSearch(problem, own, limits, COARSE)

    @cached_property
    def _sound(self) -> NDArray[np.bool_]:
        """Rows that are no outliers of a first fit, shape (rows,)."""
        problem = self._assemble((0.0,) * len(self.drives))
        kinds = ["rational2"] * len(self.drives)
        own = self._parametrization(kinds)
        search = self._coarse(problem, own)
        triangle = problem.compress(np.ones(len(problem.measured)))
        starts = own.starts(self.period, self.duration)
        theta = search.best(starts, triangle, 1, _silent)[0][1]
        for _ in range(2):
            residual = search.fitted(theta, triangle)[0]
            spread = robust_std(residual)
            keep = np.abs(residual) <= MAX_DEVIATIONS * spread if spread else residual == residual
            if keep.all():
                break
            triangle = problem.compress(keep.astype(float))
            theta = search.refine(theta, triangle)[1]
        self._data[(0.0,) * len(self.drives)] = CandidateData.grouped(problem, keep, self._noise)
        return np.asarray(keep)

    def _assemble(self, delays: tuple[float, ...]) -> CalibrationProblem:
        return CalibrationProblem.assemble(
            self.records, self.drives, self.output, self.free_start, delays, self.states,
            self.equilibrium,
        )  # fmt: skip

    def data(self, delays: tuple[float, ...]) -> CandidateData:
        """Rows in groups, the drives delayed.

        Parameters
        ----------
        delays : tuple of float [s]
        """
        keep = self._sound
        if delays not in self._data:
            self._data[delays] = CandidateData.grouped(self._assemble(delays), keep, self._noise)
        return self._data[delays]

    def size(
        self, kinds: Sequence[str], delays: tuple[float, ...], theta: Float, common: bool = False
    ) -> float:
        """Sum of squares at the minimum near `theta` [unit² of the output].

        Parameters
        ----------
        kinds : sequence of str
        delays : tuple of float [s]
        theta : ndarray, shape (searched,)
        common : bool
            See `fit`.
        """
        data = self.data(delays)
        search = self._search(data, kinds, common)
        return float((search.refine(theta, data.whole)[0] * search.scale) ** 2)

    def fit(
        self,
        kinds: tuple[str, ...],
        delays: tuple[float, ...],
        theta: Float | None = None,
        refined: int | None = None,
        common: bool = False,
    ) -> FittedKinds | None:
        """Kinds fitted to all rows; None where they cannot be.

        Parameters
        ----------
        kinds : tuple of str, one for each drive
        delays : tuple of float [s]
        theta : ndarray, shape (searched,), optional
            Where to start, too, beside the grids of the kinds.
        refined : int, optional
            Starts from which a minimum is sought; by the number of drives by default.
        common : bool
            One kind whose rates all drives share.
        """
        data = self.data(delays)
        search = self._search(data, kinds, common)
        own = search.parametrization
        unknowns = data.problem.unknowns(own)
        if len(data.problem.measured) * (FOLDS - 1) <= unknowns * FOLDS:
            return None
        starts = [*own.starts(self.period, self.duration), *([] if theta is None else [theta])]
        several = STARTS if len(self.drives) > 1 else FEW_STARTS
        try:
            theta = search.best(starts, data.whole, refined or several, _silent)[0][1]
        except FitError:
            return None
        residual, linear = search.fitted(theta, data.whole)
        count = own.searched + own.gains + sum(int(delay > 0) for delay in delays)
        count -= len(data.problem.known)
        return FittedKinds(
            kinds,
            delays,
            count,
            theta,
            residual,
            search.soundness(theta, linear, self.drives, self.output, self.duration),
            search,
            data,
            common,
        )


def independent_rows(residual: Float) -> float:
    """Rows that count as independent, from sums of the residual over blocks.

    Parameters
    ----------
    residual : ndarray, shape (rows,)
    """
    rows = len(residual)
    blocks = min(INDEPENDENT_BLOCKS, rows)
    starts = np.arange(blocks) * rows // blocks
    sums = np.add.reduceat(residual, starts)
    own = float(np.sum(residual**2))
    return rows / max(float(np.sum(sums**2)) / own, 1.0) if own else float(rows)


def _silent(message: str) -> None:
    """No word of progress."""
