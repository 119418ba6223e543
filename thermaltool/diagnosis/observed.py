"""What is measured of one output, over all logs, in the form that the evidence needs."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.effect import Float
from thermaltool.fitting.discrepancy import MOST_ROWS
from thermaltool.record import Record
from thermaltool.signals.likelihood import ColouredNoise

# A pause above this many median periods is not averaged over.
PAUSE = 5.0


@dataclass(frozen=True)
class Observed:
    """Rows of one output that count.

    Attributes
    ----------
    output : str
    rows : tuple of ndarray of int, one for each log
        Rows that are measured and in use.
    first : ndarray of int, shape (n,)
        Where each group of averaged rows begins, counted through all logs.
    share : ndarray, shape (n,)
        One over the rows of the group: the white variance of its mean.
    time : ndarray, shape (n,) [s]
        Of the groups, on the mean.
    noise : ColouredNoise
        Of the groups.
    owner : ndarray of int, shape (n,)
        Log of each group.
    """

    output: str
    rows: tuple[NDArray[np.int64], ...]
    first: NDArray[np.int64]
    share: Float
    time: Float
    noise: ColouredNoise
    owner: NDArray[np.int64]

    @staticmethod
    def of(
        output: str, logs: Sequence[Record], usable: Sequence[NDArray[np.bool_]]
    ) -> Observed | None:
        """The rows of `output` that are measured and `usable`; None where there are none."""
        rows, first, owner, at = [], [], [], 0
        total = sum(int(np.sum(use)) for use in usable)
        size = -(-total // MOST_ROWS)
        for k, (log, use) in enumerate(zip(logs, usable, strict=True)):
            there = np.flatnonzero(use)
            rows.append(there)
            if not len(there):
                continue
            steps = np.diff(log.time[there])
            pauses = steps > PAUSE * np.median(steps) if len(steps) else np.zeros(0, bool)
            edges = [0, *(np.flatnonzero(pauses) + 1).tolist(), len(there)]
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
        noise = ColouredNoise(means, blocks, 1.0 / counts, period)
        return Observed(output, tuple(rows), starts, 1.0 / counts, means, noise, owners)

    def whole(self, series: Sequence[Float]) -> Float:
        """All rows of all logs, one after the other, of arrays (n_log,) or (n_log, c)."""
        return np.concatenate([each[r] for each, r in zip(series, self.rows, strict=True)])

    def gather(self, series: Sequence[Float]) -> Float:
        """Means of the groups of arrays (n_log,) or (n_log, c)."""
        joined = self.whole(series)
        if len(joined) == len(self.first):
            return joined
        share = self.share if joined.ndim == 1 else self.share[:, None]
        return np.asarray(np.add.reduceat(joined, self.first, axis=0) * share)

    @property
    def size(self) -> int:
        return len(self.first)


def measured_rows(
    logs: Sequence[Record], output: str, masked: Mapping[tuple[str, str], NDArray[np.bool_]]
) -> list[NDArray[np.bool_]]:
    """Rows of each log in which `output` is measured and not masked."""
    result = []
    for log in logs:
        if output not in log.columns:
            result.append(np.zeros(len(log.time), bool))
            continue
        use = np.isfinite(log.columns[output])
        result.append(use & ~masked.get((log.digest, output), np.zeros(len(use), bool)))
    return result
