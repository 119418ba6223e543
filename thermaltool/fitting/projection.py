"""The linear side of calibration: records compressed once, gains projected out of all rates.

Every response is a sum of relaxation modes on one grid of rates. A record therefore enters as the
states of that grid, driven by its measured input, compressed to a triangle by QR. A set of rates
then costs its step response at some two hundred times and a least-squares problem of the grid's
size, whatever the length of the records and the shape of the input (variable projection,
Golub & Pereyra 1973; its slopes: L. Kaufman, BIT 15 (1975) 49).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from thermaltool.errors import FitError
from thermaltool.fitting.acting_record import cooling_of, longest_sustained
from thermaltool.fitting.averaging import row_noise
from thermaltool.fitting.parametrization import Parametrization
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.responses.relaxation import RelaxationGrid
from thermaltool.units import is_absolute

# What a drive makes of every rate of the grid, by the number of the record and the channel of the
# drive: shape (rows, rates).
GridStates = dict[tuple[int, str], Float]

# Ends of the grid of rates: of the slowest over the longest record, and of the fastest, times the
# sample period.
SLOWEST_RATE, FASTEST_RATE = 0.05, 4.0
# Terms that are so many times larger than the output, and cancel, are no answer.
MAX_CANCELLATION = 10.0
# Standard error of the sum of gains to the surroundings, where it is known to be one.
EQUILIBRIUM_ERROR = 1e-3
# Directions of the linear problem below this share of the largest, once scaled, are rounding.
MIN_DIRECTION = 1e-12


def linear_least_squares(columns: Float, measured: Float, min_direction: float) -> Float:
    """Coefficients, shape (p,) or (p, k), of columns that are scaled to one length first.

    An ill-conditioned pair of columns is thus not decided by their size.

    Parameters
    ----------
    columns : ndarray, shape (rows, p)
    measured : ndarray, shape (rows,) or (rows, k)
    min_direction : float
        Directions below this share of the largest singular value are left at zero.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    found = np.linalg.lstsq(columns / size, measured, rcond=min_direction)[0]
    return np.asarray((found.T / size).T)


def orthonormal_rows(rows: Float, least: float) -> Float:
    """An orthonormal basis of rows, without directions that are nearly in the others.

    Parameters
    ----------
    rows : ndarray, shape (p, n)
    least : float
        Share of the largest squared singular value, of rows of one length.
    """
    sizes = np.linalg.norm(rows, axis=1)
    rows = rows[sizes > 0] / sizes[sizes > 0][:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    used = values > least * max(values, default=1.0)
    return np.asarray((vectors[:, used] / np.sqrt(values[used])).T @ rows)


def surroundings(drives: Sequence[Drive], output: str) -> list[int]:
    """Drives, by number, whose temperature an output takes in the end; none where it has none.

    Parameters
    ----------
    drives : sequence of Drive
    output : str
    """
    if not is_absolute(output):
        return []
    return [d for d, drive in enumerate(drives) if is_absolute(drive.channel)]


@dataclass(frozen=True)
class Triangle:
    """Triangle R and rotated measurement z: ‖w(y − D c)‖² = ‖z − R c‖² + a constant.

    Attributes
    ----------
    R : ndarray, shape (columns + 1, columns)
    z : ndarray, shape (columns + 1,)
    """

    R: Float
    z: Float


@dataclass(frozen=True)
class CalibrationProblem:
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
    known : ndarray, shape (0 or 1, columns of the design + 1)
        What is known before any row: coefficients and value, in units of their error.
    noise : float [unit of the output]
        White noise of a reading; the weight of what is known beside a row.
    longest : float [s]
        Time constant beyond which the machine would heat itself.
    """

    grid: RelaxationGrid
    design: Float
    measured: Float
    time: Float
    record: NDArray[np.int64]
    records: int
    drives: int
    free_start: bool
    known: Float
    noise: float
    longest: float

    @staticmethod
    def assemble(
        records: Sequence[Record],
        drives: Sequence[Drive],
        output: str,
        free_start: bool,
        delays: Sequence[float] = (),
        states: GridStates | None = None,
        equilibrium: bool = False,
    ) -> CalibrationProblem:
        """Drive the grid with every record's inputs and stack the rows that are measured.

        Parameters
        ----------
        records : sequence of Record
        drives : sequence of Drive
        output : str
        free_start : bool
            Whether a decay of every rate is among the columns of each record.
        delays : sequence of float [s]
            Of each drive; none by default.
        states : dict, optional
            What drives make of the grid, by record and channel: taken where it is there, else
            put there. For problems of the same records and drives.
        equilibrium : bool
            Whether a temperature takes that of its surroundings in the end, where no heat acts: its
            steady gains to all temperatures among the drives add up to one.

        Raises
        ------
        FitError
            An output that no record has a value of.
        """
        duration = max(record.duration for record in records)
        period = min(record.period for record in records)
        grid = RelaxationGrid.between(SLOWEST_RATE / duration, FASTEST_RATE / period)
        n, inputs = len(grid.rates), len(drives)
        decays = n * len(records) if free_start else 0
        blocks, measured, owner, times = [], [], [], []
        driven: GridStates = {} if states is None else states
        for k, record in enumerate(records):
            values = record.column(output)
            there = np.isfinite(values)
            cooling = cooling_of(record)
            block = np.zeros((int(there.sum()), n * inputs + decays + len(records)))
            for d, drive in enumerate(drives):
                u = relative(record.column(drive.channel), drive.reference, drive.hold)
                x = driven.get((k, drive.channel))
                if x is None:
                    x = driven[k, drive.channel] = grid.states(record.time, u, drive.hold, cooling)
                if delays and delays[d]:
                    x = grid.delayed(x, record.time, u, drive.hold, delays[d], cooling)
                block[:, d * n : (d + 1) * n] = x[there]
            if free_start:
                since = record.time[there] - record.time[0]
                to = slice(n * inputs + k * n, n * inputs + (k + 1) * n)
                block[:, to] = np.exp(-np.outer(since, grid.rates))
                if cooling is not None:
                    block[:, to] *= np.exp(cooling[0] - cooling[there])[:, None]
            block[:, n * inputs + decays + k] = 1.0
            blocks.append(block)
            measured.append(values[there])
            times.append(record.time[there])
            owner.append(np.full(len(block), k))
        if not sum(map(len, measured)):
            raise FitError("the output has no value in any log")
        around = surroundings(drives, output) if equilibrium else []
        known = np.zeros((min(len(around), 1), blocks[0].shape[1] + 1))
        for d in around:
            known[:, d * n : (d + 1) * n] = 1 / EQUILIBRIUM_ERROR
        known[:, -1] = 1 / EQUILIBRIUM_ERROR
        return CalibrationProblem(
            grid,
            np.vstack(blocks),
            np.concatenate(measured),
            np.concatenate(times),
            np.concatenate(owner),
            len(records),
            inputs,
            free_start,
            known,
            max(row_noise(record, output) for record in records) if around else 0.0,
            longest_sustained(records),
        )

    def compress(self, weights: Float, noise: tuple[Float, float] | None = None) -> Triangle:
        """QR of the weighted rows.

        Parameters
        ----------
        weights : ndarray, shape (rows,)
            Of the squares.
        noise : (ndarray of shape (rows, m), float), optional
            Columns B and s of errors whose covariance is s²·I + B Bᵀ: those of a fit in which each
            column has a weight of standard deviation one.
        """
        root = np.sqrt(weights)[:, None]
        stacked = np.hstack([self.design * root, self.measured[:, None] * root])
        if len(self.known):
            stacked = np.vstack([stacked, self.known * self.noise])
        first = 0
        if noise is not None:
            # Columns whose weights are eliminated first leave the others as they are beside them.
            columns, sigma = noise
            first = columns.shape[1]
            known = np.hstack([sigma * np.eye(first), np.zeros((first, stacked.shape[1]))])
            beside = np.vstack([columns * root, np.zeros((len(self.known), first))])
            stacked = np.vstack([np.hstack([beside, stacked]), known])
        (R,) = qr(stacked, mode="r", overwrite_a=True, check_finite=False)[:1]
        R = R[first : stacked.shape[1], first:]
        return Triangle(np.asarray(R[:, :-1], float), np.asarray(R[:, -1], float))

    def decays(self, gains: int) -> int:
        """Number of decays from an earlier level: one for each gain and record.

        Parameters
        ----------
        gains : int
        """
        return self.records * gains if self.free_start else 0

    def unknowns(self, parametrization: Parametrization) -> int:
        """Number of all that is fitted: searched parameters, gains, decays, offsets.

        Parameters
        ----------
        parametrization : Parametrization
        """
        gains = parametrization.gains
        return parametrization.searched + gains + self.decays(gains) + self.records

    def combine(self, unit: Float) -> Float:
        """Columns of the reduced problem: gains, decays, offsets; shape (columns, unknowns)."""
        n, gains = len(self.grid.rates), unit.shape[1]
        decays = self.decays(gains)
        full = np.zeros((self.design.shape[1], gains + decays + self.records))
        full[: n * self.drives, :gains] = unit
        if self.free_start:
            shapes = sum(unit[d * n : (d + 1) * n] for d in range(self.drives))
            for k in range(self.records):
                rows = slice(n * self.drives + k * n, n * self.drives + (k + 1) * n)
                full[rows, gains + k * gains : gains + (k + 1) * gains] = shapes
        full[-self.records :, -self.records :] = np.eye(self.records)
        return full

    def project(self, unit: Float, triangle: Triangle) -> tuple[Float, Float]:
        """Best linear part for given rates.

        Parameters
        ----------
        unit : ndarray, shape (drives · n, gains)
            `Parametrization.unit_weights`.
        triangle : Triangle

        Returns
        -------
        residual : ndarray
            z − R c, the part of the error that depends on the rates.
        linear : ndarray
            Gains, decays, offsets.
        """
        columns = triangle.R @ self.combine(unit)
        linear = linear_least_squares(columns, triangle.z, MIN_DIRECTION)
        return triangle.z - columns @ linear, linear

    def slopes(
        self, parametrization: Parametrization, theta: Float, triangle: Triangle, central: bool
    ) -> Float:
        """Derivatives of what `project` leaves, by the logarithms, shape (k, searched).

        What the linear part then makes up for is taken off (Kaufman 1975): the gradient of the
        squared error is exact.

        Parameters
        ----------
        parametrization : Parametrization
        theta : ndarray, shape (searched,)
        triangle : Triangle
        central : bool
            See `Parametrization.unit_slopes`.
        """
        unit = parametrization.unit_weights(theta, self.grid)
        columns = triangle.R @ self.combine(unit)
        linear = linear_least_squares(columns, triangle.z, MIN_DIRECTION)
        moved = triangle.R @ np.column_stack(
            [
                self._by_rates(slope, linear)
                for slope in parametrization.unit_slopes(theta, self.grid, central)
            ]
        )
        return columns @ linear_least_squares(columns, moved, MIN_DIRECTION) - moved

    def _by_rates(self, slope: Float, linear: Float) -> Float:
        """What a change of the unit weights makes of the coefficients of the design."""
        return self.combine(slope)[:, : -self.records] @ linear[: -self.records]

    def cancellation(self, unit: Float, gains: Float) -> float:
        """Size of the largest term over that of the output: far above 1, terms cancel.

        Parameters
        ----------
        unit : ndarray, shape (drives · n, gains)
            `Parametrization.unit_weights`.
        gains : ndarray, shape (gains,)
        """
        terms = self.design[:, : len(unit)] @ (unit * gains)
        spread = float(np.linalg.norm(self.measured - np.mean(self.measured))) or 1.0
        return float(np.max(np.linalg.norm(terms - terms.mean(axis=0), axis=0))) / spread

    def residual(self, unit: Float, linear: Float) -> Float:
        """Error of every row, shape (rows,) [unit of the output]."""
        return np.asarray(self.measured - self.design @ (self.combine(unit) @ linear))

    def jacobian(self, parametrization: Parametrization, theta: Float, linear: Float) -> Float:
        """Sensitivity of every row to the logarithms (central differences), then to `linear`.

        Parameters
        ----------
        parametrization : Parametrization
        theta : ndarray, shape (searched,)
        linear : ndarray
            Gains, decays, offsets.

        Returns
        -------
        ndarray, shape (rows, searched + len(linear))
        """
        return self._sensitivity(self.design, parametrization, theta, linear)

    def known_jacobian(
        self, parametrization: Parametrization, theta: Float, linear: Float
    ) -> Float:
        """The same of what is known before any row, in units of its error, shape (0 or 1, …)."""
        return self._sensitivity(self.known[:, :-1], parametrization, theta, linear)

    def _sensitivity(
        self, design: Float, parametrization: Parametrization, theta: Float, linear: Float
    ) -> Float:
        slopes = parametrization.unit_slopes(theta, self.grid)
        columns = [design @ self._by_rates(slope, linear) for slope in slopes]
        unit = parametrization.unit_weights(theta, self.grid)
        return np.column_stack([*columns, design @ self.combine(unit)])
