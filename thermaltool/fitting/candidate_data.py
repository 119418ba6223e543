"""Rows of records that candidates are compared on: means over groups, some held out in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.projection import CalibrationProblem, Triangle
from thermaltool.responses.modes import Float
from thermaltool.signals.detrend import difference_sigma

# Rows are averaged over groups until no more than so many are left: thermal responses are slower.
MAX_GROUPS = 1200
# The records are cut into so many blocks, every fourth of which is held out in turn.
BLOCKS, FOLDS = 96, 4
# An error beside that of a kind with one more time constant or shape counts from this share of a
# reading's noise: with less of it the whole error is at most 3 % larger, which is not worth one.
MIN_EXCESS = 0.25


@dataclass(frozen=True)
class CandidateData:
    """Records with given delays: rows in groups, and what each fold leaves of them.

    Attributes
    ----------
    problem : CalibrationProblem
        Of means over groups of rows, times the root of their number.
    whole : Triangle
    fold : ndarray of int, shape (groups,)
    size : ndarray, shape (groups,)
        Number of rows.
    noise : float [unit of the output]
        White noise of a reading.
    """

    problem: CalibrationProblem
    whole: Triangle
    fold: NDArray[np.int64]
    size: Float
    noise: float

    @staticmethod
    def grouped(
        problem: CalibrationProblem, keep: NDArray[np.bool_], noise: float | None
    ) -> CandidateData:
        """Means of groups of rows, each times the root of its number, so that noise stays white.

        Parameters
        ----------
        problem : CalibrationProblem
        keep : ndarray of bool, shape (rows,)
            Those that take part.
        noise : float, optional [unit of the output]
            Of a reading; by default that of the rows.
        """
        size = -(-int(keep.sum()) // MAX_GROUPS)
        record = problem.record[keep]
        place = np.arange(len(record)) - np.searchsorted(record, record)
        starts = np.flatnonzero(np.diff(record * len(record) + place // size, prepend=-1))
        root = np.sqrt(np.diff(np.append(starts, len(record))))
        grouped = replace(
            problem,
            design=np.add.reduceat(problem.design[keep], starts) / root[:, None],
            measured=np.add.reduceat(problem.measured[keep], starts) / root,
            time=problem.time[keep][starts],
            record=record[starts],
        )
        rows = len(starts)
        return CandidateData(
            grouped,
            grouped.compress(np.ones(rows)),
            np.arange(rows) * min(BLOCKS, rows) // rows % FOLDS,
            root**2,
            difference_sigma(problem.measured[keep]) if noise is None else noise,
        )

    @cached_property
    def folds(self) -> tuple[Triangle, ...]:
        """Without the rows of each fold."""
        return tuple(self.problem.compress((self.fold != k).astype(float)) for k in range(FOLDS))

    def rms(self, errors: Float) -> float:
        """Root mean square of means over groups of rows, from errors times root of the number."""
        return float(np.sqrt(np.average(errors**2 / self.size, weights=self.size)))

    def counts(self, errors: Float, others: Float, least: float) -> bool:
        """Whether errors are larger than others by at least so much of the noise of a reading."""
        excess = self.rms(errors) ** 2 - self.rms(others) ** 2
        return excess > (least * self.noise) ** 2
