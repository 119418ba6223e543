"""The linear side of calibration: logs compressed once, gains projected out of every candidate.

Every response is a sum of relaxation modes on one grid of rates. A log therefore enters as the
states of that grid, driven by its measured input, compressed to a triangle by QR. A candidate set
of rates then costs its step response at some two hundred times and a least-squares problem of the
grid's size, whatever the length of the logs and the shape of the input (variable projection,
Golub & Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from thermaltool.errors import FitError
from thermaltool.responses import Response
from thermaltool.responses.modes import Float, Hold
from thermaltool.responses.relaxation import RelaxationGrid


@dataclass(frozen=True)
class OutputRecord:
    """What one log says of one output.

    Attributes
    ----------
    time : ndarray, shape (n,) [s]
    drives : tuple of ndarray, shape (n,)
        Relative to their references; no NaN.
    values : ndarray, shape (n,)
        The measured output; NaN where missing (left out of the fit).
    """

    time: Float
    drives: tuple[Float, ...]
    values: Float


@dataclass(frozen=True)
class Candidate:
    """Kinds of response and their fixed parameters: turns rates into responses.

    Attributes
    ----------
    classes : tuple of response classes, one for each drive
    fixed : tuple of mapping, the parameters that are not fitted
    """

    classes: tuple[Any, ...]
    fixed: tuple[Mapping[str, float], ...]

    def split(self, theta: Float) -> list[dict[str, float]]:
        """Searched parameters of each response, from their logarithms."""
        parts, at = [], 0
        for cls in self.classes:
            values = np.exp(theta[at : at + len(cls.searched)])
            parts.append(dict(zip(cls.searched, values.tolist(), strict=True)))
            at += len(cls.searched)
        return parts

    def responses(self, theta: Float, gains: Float) -> tuple[Response, ...]:
        """The responses that `theta` (logarithms) and `gains` stand for."""
        built, at = [], 0
        for cls, fixed, searched in zip(self.classes, self.fixed, self.split(theta), strict=True):
            values = gains[at : at + len(cls.gains)].tolist()
            built.append(cls(**searched, **dict(zip(cls.gains, values, strict=True)), **fixed))
            at += len(cls.gains)
        return tuple(built)

    def unit_weights(self, theta: Float, grid: RelaxationGrid) -> Float:
        """Grid weights of each gain set to one; shape (drives · n, gains)."""
        n, columns = len(grid.rates), []
        parts = zip(self.classes, self.fixed, self.split(theta), strict=True)
        for k, (cls, fixed, searched) in enumerate(parts):
            for gain in cls.gains:
                ones = {name: float(name == gain) for name in cls.gains}
                column = np.zeros(n * len(self.classes))
                column[k * n : (k + 1) * n] = grid.weights(cls(**searched, **ones, **fixed))
                columns.append(column)
        return np.column_stack(columns)


@dataclass(frozen=True)
class Compressed:
    """Triangle R and rotated measurement z: ‖w(y − D c)‖² = ‖z − R c‖² + a constant."""

    R: Float
    z: Float


@dataclass(frozen=True)
class Problem:
    """measured ≈ design · [grid weights; decays from an earlier level; offsets].

    Attributes
    ----------
    grid : RelaxationGrid
    design : ndarray, shape (rows, drives · n + decays + records)
    measured, time : ndarray, shape (rows,)
    record : ndarray of int, shape (rows,)
        Which record a row belongs to.
    records, drives : int
    free_start : bool
    """

    grid: RelaxationGrid
    design: Float
    measured: Float
    time: Float
    record: NDArray[np.int64]
    records: int
    drives: int
    free_start: bool

    @staticmethod
    def assemble(
        records: Sequence[OutputRecord], holds: Sequence[Hold], free_start: bool
    ) -> Problem:
        """Drive the grid with every record's inputs and stack the rows that are measured."""
        duration = max(float(r.time[-1] - r.time[0]) for r in records)
        period = min(float(np.median(np.diff(r.time))) for r in records)
        grid = RelaxationGrid.between(0.05 / duration, 4 / period)
        n, drives = len(grid.rates), len(holds)
        decays = n * len(records) if free_start else 0
        blocks, measured, owner, times = [], [], [], []
        for k, record in enumerate(records):
            there = np.isfinite(record.values)
            block = np.zeros((int(there.sum()), n * drives + decays + len(records)))
            for d, hold in enumerate(holds):
                states = grid.states(record.time, record.drives[d], hold)
                block[:, d * n : (d + 1) * n] = states[there]
            if free_start:
                since = record.time[there] - record.time[0]
                to = slice(n * drives + k * n, n * drives + (k + 1) * n)
                block[:, to] = np.exp(-np.outer(since, grid.rates))
            block[:, n * drives + decays + k] = 1.0
            blocks.append(block)
            measured.append(record.values[there])
            times.append(record.time[there])
            owner.append(np.full(len(block), k))
        if not sum(map(len, measured)):
            raise FitError("the output has no value in any log")
        return Problem(
            grid,
            np.vstack(blocks),
            np.concatenate(measured),
            np.concatenate(times),
            np.concatenate(owner),
            len(records),
            drives,
            free_start,
        )

    def compress(self, weights: Float) -> Compressed:
        """QR of the weighted rows; `weights` are those of the squares, shape (rows,)."""
        root = np.sqrt(weights)[:, None]
        stacked = np.hstack([self.design * root, self.measured[:, None] * root])
        (R,) = qr(stacked, mode="r", overwrite_a=True, check_finite=False)[:1]
        R = R[: stacked.shape[1]]
        return Compressed(np.asarray(R[:, :-1], float), np.asarray(R[:, -1], float))

    def combine(self, unit: Float) -> Float:
        """Columns of the reduced problem: gains, decays, offsets; shape (columns, unknowns)."""
        n, gains = len(self.grid.rates), unit.shape[1]
        decays = self.records * gains if self.free_start else 0
        full = np.zeros((self.design.shape[1], gains + decays + self.records))
        full[: n * self.drives, :gains] = unit
        if self.free_start:
            shapes = sum(unit[d * n : (d + 1) * n] for d in range(self.drives))
            for k in range(self.records):
                rows = slice(n * self.drives + k * n, n * self.drives + (k + 1) * n)
                full[rows, gains + k * gains : gains + (k + 1) * gains] = shapes
        full[-self.records :, -self.records :] = np.eye(self.records)
        return full

    def project(self, unit: Float, compressed: Compressed) -> tuple[Float, Float]:
        """Best linear part for given rates.

        Returns
        -------
        residual : ndarray
            z − R c, the part of the error that depends on the rates.
        linear : ndarray
            Gains, decays, offsets.
        """
        columns = compressed.R @ self.combine(unit)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = 1.0
        linear = np.linalg.lstsq(columns / size, compressed.z, rcond=1e-12)[0] / size
        return compressed.z - columns @ linear, linear
