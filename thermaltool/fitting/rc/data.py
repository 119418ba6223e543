"""Readings and inputs of the logs as the filter runs through them: pieces without a pause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import FitError
from thermaltool.fitting.rc.network import RcNetwork
from thermaltool.record import Record

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

# Rows that a fit takes; more would run for minutes.
MAX_ROWS = 100_000
# Steps that agree to this part of the longest count as one.
_STEP_GRAIN = 1e-10


@dataclass(frozen=True)
class FilterPiece:
    """Rows without a pause, whose inputs have no holes.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    inputs : ndarray, shape (n, q)
        Of each row; the last is a constant 1.
    changes : ndarray, shape (n, q)
        By which an input runs straight to the next row; 0 where it is held.
    readings : ndarray, shape (n, m)
        NaN where missing.
    at_rest : ndarray, shape (q,)
        Inputs under which a machine at rest has stood: the first ones, without heat.
    log : int
        Which log it is of.
    """

    time: Array
    inputs: Array
    changes: Array
    readings: Array
    at_rest: Array
    log: int = 0

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def present(self) -> Rows:
        """Where there is a reading, shape (n, m)."""
        return np.isfinite(self.readings)

    @cached_property
    def steps(self) -> tuple[Array, NDArray[np.int64]]:
        """Lengths of steps [s], and which of them follows each row; the last row has any."""
        lengths = np.diff(self.time, append=2 * self.time[-1] - self.time[-2])
        # As fine as the clock's own digits.
        grain = max(_STEP_GRAIN * float(np.max(lengths)), 8 * float(np.spacing(self.time[-1])))
        found, which = np.unique(np.round(lengths / grain), return_inverse=True)
        return found * grain, which.astype(np.int64)

    def without_readings(self, rows: Rows) -> FilterPiece:
        """The same, the readings of some rows, shape (n,), taken away."""
        readings = np.where(rows[:, None], np.nan, self.readings)
        return replace(self, readings=readings)

    def until(self, rows: int) -> FilterPiece:
        """The first rows."""
        return FilterPiece(self.time[:rows], self.inputs[:rows], self.changes[:rows],
                           self.readings[:rows], self.at_rest, self.log)  # fmt: skip

    def thinned(self, count: int) -> FilterPiece:
        """Every count-th row; what is held is averaged over the rows that are left out."""
        n = len(self) // count * count
        if count == 1 or n < 4 * count:
            return self
        first = self.inputs[:n:count]
        runs_on = np.any(self.changes != 0, axis=0)
        means = self.inputs[:n].reshape(-1, count, self.inputs.shape[1]).mean(axis=1)
        inputs = np.where(runs_on, first, means)
        changes = np.where(runs_on, np.diff(inputs, axis=0, append=inputs[-1:]), 0.0)
        return FilterPiece(self.time[:n:count], inputs, changes, self.readings[:n:count],
                           self.at_rest, self.log)  # fmt: skip


def filter_pieces(network: RcNetwork, logs: Sequence[Record]) -> tuple[FilterPiece, ...]:
    """Pieces of all logs, a log's pauses and missing inputs parting it.

    Parameters
    ----------
    network : RcNetwork
    logs : sequence of Record

    Raises
    ------
    FitError
        No piece, a channel that is never read or never moves, or too many rows.
    """
    runs = np.array([hold == "first" for hold in network.holds] + [False])
    heats = np.arange(len(runs)) < len(network.heat_channels)
    pieces = []
    for number, log in enumerate(logs):
        for part in log.pieces(network.inputs):
            ones = np.ones((1, len(part)))
            inputs = np.vstack([part.matrix(network.inputs), ones]).T
            changes = np.where(runs, np.diff(inputs, axis=0, append=inputs[-1:]), 0.0)
            readings = part.matrix(network.outputs).T
            at_rest = np.where(heats, 0.0, inputs[0])
            pieces.append(FilterPiece(part.time, inputs, changes, readings, at_rest, number))
    if not pieces:
        raise FitError(f"{', '.join(network.inputs)}: no two rows in a row have a reading")
    for k, channel in enumerate(network.outputs):
        values = np.concatenate([piece.readings[:, k] for piece in pieces])
        values = values[np.isfinite(values)]
        if not len(values):
            raise FitError(f"{channel} has no reading in any log")
        if not np.ptp(values) > 0:
            raise FitError(f"{channel} is constant: there is nothing to fit")
    rows = sum(map(len, pieces))
    if rows > MAX_ROWS:
        raise FitError(f"{rows} rows, and a network is fitted to {MAX_ROWS} at most: take a longer "
                       "period (check --resample)")  # fmt: skip
    return tuple(pieces)


def thinned(pieces: Sequence[FilterPiece], rows: int) -> tuple[FilterPiece, ...]:
    """About so many rows of all pieces together, as a first search takes them."""
    total = sum(map(len, pieces))
    count = max(1, -(-total // rows))
    return tuple(piece.thinned(count) for piece in pieces)


def held_out(pieces: Sequence[FilterPiece], share: float) -> list[int]:
    """How many rows of each piece are fitted: the first `share` of those of each log.

    Raises
    ------
    FitError
        Nothing on one side.
    """
    fitted = []
    for number in dict.fromkeys(piece.log for piece in pieces):
        own = [len(piece) for piece in pieces if piece.log == number]
        left = round(share * sum(own))
        if not 1 < left < sum(own):
            raise FitError("the split leaves nothing on one side")
        for rows in own:
            fitted.append(min(max(left, 0), rows))
            left -= fitted[-1]
    return fitted
