"""Rows of logs, averaged in groups where they are too many for a likelihood."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.record import Record
from thermaltool.signals.likelihood import ColouredNoise

Float = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_ROWS = 3000  # groups that a likelihood works on: more rows are averaged
MAX_PERIODS_IN_GROUP = 5.0  # [median periods]: longer pauses are not averaged over


@dataclass(frozen=True, eq=False)
class RowGroups:
    """Rows of one output that count, averaged in groups where they are many.

    Attributes
    ----------
    rows : tuple of ndarray of int, one for each log
        Rows that are measured and in use.
    first : ndarray of int, shape (n,)
        Where each group begins, counted through all logs.
    weight : ndarray, shape (n,)
        White variance of a group's mean over that of a reading: one over its readings.
    counts : ndarray of int, shape (n,)
        Rows of each group.
    time : ndarray, shape (n,) [s]
        Mean time of each group.
    noise : ColouredNoise
        Noise of the groups.
    owner : ndarray of int, shape (n,)
        Log of each group.
    """

    rows: tuple[Index, ...]
    first: Index
    weight: Float
    counts: Index
    time: Float
    noise: ColouredNoise
    owner: Index

    @staticmethod
    def of(
        logs: Sequence[Record], usable: Sequence[NDArray[np.bool_]] | None = None
    ) -> RowGroups | None:
        """Groups of the usable rows; None where there are none.

        Parameters
        ----------
        logs : sequence of Record
        usable : sequence of ndarray of bool, one for each log, optional
            All rows by default.
        """
        usable = [np.ones(len(log), bool) for log in logs] if usable is None else usable
        rows, first, owner, at = [], [], [], 0
        total = sum(int(np.sum(use)) for use in usable)
        size = -(-total // MAX_ROWS)
        for k, (log, use) in enumerate(zip(logs, usable, strict=True)):
            there = np.flatnonzero(use)
            rows.append(there)
            if not len(there):
                continue
            steps = np.diff(log.time[there])
            long = MAX_PERIODS_IN_GROUP * np.median(steps) if len(steps) else 0.0
            edges = [0, *(np.flatnonzero(steps > long) + 1).tolist(), len(there)]
            groups = np.concatenate([np.arange(a, b, size) for a, b in itertools.pairwise(edges)])
            first.append(at + groups)
            owner.append(np.full(len(groups), k))
            at += len(there)
        if not at:
            return None
        starts, owners = np.concatenate(first), np.concatenate(owner)
        counts = np.diff(np.append(starts, at))
        time = np.concatenate([log.time[r] for log, r in zip(logs, rows, strict=True)])
        means = np.add.reduceat(time, starts) / counts
        blocks = np.flatnonzero(np.diff(owners, prepend=-1))
        period = float(np.median(np.concatenate([np.diff(log.time) for log in logs])))
        weight = 1.0 / (counts * np.array([log.row_readings for log in logs])[owners])
        noise = ColouredNoise(means, blocks, weight, period)
        return RowGroups(tuple(rows), starts, weight, counts, means, noise, owners)

    def joined(self, series: Sequence[Float]) -> Float:
        """Rows in use of all logs, one after the other.

        Parameters
        ----------
        series : sequence of ndarray, shape (n_log,) or (n_log, c)
        """
        return np.concatenate([each[r] for each, r in zip(series, self.rows, strict=True)])

    def means(self, series: Sequence[Float]) -> Float:
        """Means of the groups, shape (n,) or (n, c).

        Parameters
        ----------
        series : sequence of ndarray, shape (n_log,) or (n_log, c)
        """
        joined = self.joined(series)
        if len(joined) == len(self.first):
            return joined
        share = 1.0 / self.counts
        share = share if joined.ndim == 1 else share[:, None]
        return np.asarray(np.add.reduceat(joined, self.first, axis=0) * share)

    @property
    def size(self) -> int:
        """Number of groups."""
        return len(self.first)

    @property
    def count(self) -> int:
        """Number of rows."""
        return sum(len(rows) for rows in self.rows)

    @property
    def present(self) -> list[int]:
        """Logs that have rows."""
        return [k for k, rows in enumerate(self.rows) if len(rows)]
