"""The least-squares problem of a transient, in as few rows as its responses span.

The response to a lag is a smooth curve of ln τ. Its columns on a grid and the output are rotated
(QR, block by block) into few coordinates, between which the curve is interpolated: no search needs
the rows of the log again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import nnls

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.spectrum.transient import Transient

# Time constants of the grid in a decade; the degree of the spline between them: the error of the
# interpolation is below 1e-7 of a response.
GRID_PER_DECADE, SPLINE_DEGREE = 24, 5
# The grid goes beyond the shortest and the longest time behind a step by the first two factors.
# Spectra end at the third: what is slower still is a straight line, which no log excludes.
BEYOND_SHORT, BEYOND_LONG, BEYOND_USUAL = 3.0, 30.0, 3.0
# Directions of the responses below this part of the largest are rounding.
MIN_DIRECTION = 1e-13
# Rounds of the active set in unknowns.
MAX_ROUNDS = 50


@dataclass(frozen=True)
class CompressedTransient:
    """‖Σ R_j d(ln τ_j) + offset − y‖² in few coordinates.

    Attributes
    ----------
    grid : ndarray, shape (M,)
        Logarithms of time constants, ascending [ln s].
    curve : BSpline
        d(ln τ), shape (k,) each [K for 1 K/W].
    offset : ndarray, shape (k,) or (0,)
        The column of the level without power; none where it is zero.
    y : ndarray, shape (k,) [K]
        The output above `level`.
    level : float [K]
    rest : float [K²]
        What no response reaches.
    rows : int
    """

    grid: Array
    curve: BSpline
    offset: Array
    y: Array
    level: float
    rest: float
    rows: int

    @property
    def linear(self) -> int:
        """Parameters beside the lines."""
        return int(len(self.offset) > 0)

    def usual_end(self, logs: Array) -> float:
        """Where spectra end that have such lines [ln s].

        Parameters
        ----------
        logs : ndarray, shape (N,) [ln s]
            Ascending.
        """
        usual = float(self.grid[-1]) - np.log(BEYOND_LONG / BEYOND_USUAL)
        slowest = float(logs[-1]) + np.log(BEYOND_USUAL)
        return float(min(self.grid[-1], max(usual, slowest)))

    def columns(self, logs: Array) -> Array:
        """Responses of lags, shape (k, N).

        Parameters
        ----------
        logs : ndarray, shape (N,) [ln s]
        """
        return np.asarray(self.curve(logs)).T

    def slopes(self, logs: Array) -> Array:
        """Their derivatives by ln τ, shape (k, N).

        Parameters
        ----------
        logs : ndarray, shape (N,) [ln s]
        """
        return np.asarray(self.curve(logs, 1)).T

    def bounded(self, columns: Array) -> Array:
        """Columns for `nnls`: those of resistances, and of an offset of either sign."""
        if not self.linear:
            return columns
        return np.column_stack([columns, self.offset, -self.offset])

    def resistances(self, logs: Array) -> tuple[Array, float, float]:
        """Resistances of given lags, none below zero: (R [K/W], offset [K], loss [K²]).

        Parameters
        ----------
        logs : ndarray, shape (N,) [ln s]
        """
        columns = self.bounded(self.columns(logs))
        if not columns.size:
            return np.zeros(0), 0.0, float(self.y @ self.y) + self.rest
        found, loss = non_negative(columns, self.y)
        offset = float(found[-2] - found[-1]) if self.linear else 0.0
        return found[: len(logs)], offset, loss + self.rest


def non_negative(columns: Array, y: Array) -> tuple[Array, float]:
    """Non-negative least squares: the unknowns, shape (N,), and the squared error.

    Parameters
    ----------
    columns : ndarray, shape (n, N)
    y : ndarray, shape (n,)

    Raises
    ------
    FitError
        It does not end.
    """
    try:
        found, left = nnls(columns, y, maxiter=MAX_ROUNDS * columns.shape[1])
    except RuntimeError as error:
        raise FitError("non-negative least squares do not converge on this log") from error
    return found, float(left) ** 2


def compress(transient: Transient) -> CompressedTransient:
    """The problem of a transient; one pass over its rows.

    Parameters
    ----------
    transient : Transient
    """
    short, long = transient.reach
    low, high = np.log(short / BEYOND_SHORT), np.log(long * BEYOND_LONG)
    count = int(np.ceil(GRID_PER_DECADE * (high - low) / np.log(10.0))) + 1
    grid = np.linspace(low, high, count)
    rows: Array = np.zeros((0, count + 2))
    # Small numbers keep their digits beside an absolute temperature.
    level = float(transient.rise[0]) if transient.free_offset else 0.0
    for part, responses in transient.responses(np.exp(grid)):
        ones = np.ones(len(responses))
        block = np.column_stack([responses, ones, transient.rise[part] - level])
        rows = np.asarray(np.linalg.qr(np.vstack([rows, block]), mode="r"))
    design = rows[:, : count + transient.free_offset]
    directions, sizes, _ = np.linalg.svd(design, full_matrices=False)
    kept = directions[:, sizes > MIN_DIRECTION * sizes[0]].T
    y = kept @ rows[:, -1]
    offset = kept @ rows[:, count] if transient.free_offset else np.zeros(0)
    curve = make_interp_spline(grid, (kept @ rows[:, :count]).T, k=SPLINE_DEGREE)
    rest = float(np.sum((rows[:, -1] - y @ kept) ** 2))
    return CompressedTransient(grid, curve, offset, y, level, rest, len(transient.time))
