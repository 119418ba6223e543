"""Intervals that hold whatever the spectrum is: profile likelihood over all that are positive.

An interval holds the values for which some non-negative spectrum fits nearly as well as the best:
its squared error is larger by no more than 1.96² variances of the noise. So bounded were
linear functionals by B. W. Rust and W. R. Burrus (1972), and D. P. O'Leary and B. W. Rust, SIAM J.
Sci. Stat. Comput. 7 (1986) 473.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from thermaltool.fitting.data import Array
from thermaltool.fitting.spectrum.compressed import non_negative
from thermaltool.fitting.spectrum.lines import LineFit
from thermaltool.signals.intervals import NORMAL_95

Interval = tuple[float, float]

# Places of the spectra in a decade; near a line: places on either side, so many standard errors
# apart, of which none counts as longer than this [ln s].
PER_DECADE, NEAR, NEAR_STEP, MAX_NEAR_ERROR = 12, 8, 0.5, 0.1
# Responses below this part of the noise say nothing.
MIN_DIRECTION = 1e-6
# Weight of a condition that a spectrum keeps, in the largest response.
CONDITION_WEIGHT = 1e3
# Ends of intervals, in the total resistance and in ln s; a resistance above so many is unbounded.
TOLERANCE, UNBOUNDED = 1e-4, 1e3


class SpectrumBounds:
    """Bounds of what all spectra that fit have in common.

    Parameters
    ----------
    fit : LineFit
        Its lines are among the places of the spectra; its noise is that of the intervals.
    """

    def __init__(self, fit: LineFit) -> None:
        problem, n = fit.problem, len(fit.logs)
        errors = np.sqrt(np.maximum(np.diag(fit.covariance())[:n], 0.0))
        around = NEAR_STEP * np.arange(-NEAR, NEAR + 1)
        near = fit.logs[:, None] + np.minimum(errors, MAX_NEAR_ERROR)[:, None] * around
        low, high = float(problem.grid[0]), problem.usual_end(fit.logs)
        count = int(np.ceil(PER_DECADE * (high - low) / np.log(10.0))) + 1
        self.logs = np.unique(
            np.concatenate([np.linspace(low, high, count), np.clip(near.ravel(), low, high)])
        )
        columns = problem.bounded(problem.columns(self.logs))
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        self._sigma = float(np.sqrt(fit.variance))
        self._level = problem.level
        scale = max(float(np.sum(fit.resistances)), np.finfo(float).tiny)
        kept = directions[:, sizes * scale > MIN_DIRECTION * self._sigma].T
        self._columns, self._y = kept @ columns, kept @ problem.y
        self.best, self._least = non_negative(self._columns, self._y)
        self._weight = CONDITION_WEIGHT * float(np.max(np.linalg.norm(self._columns, axis=0)))
        self.total = float(np.sum(self.best[: len(self.logs)]))

    def _excess(self, weights: Array, value: float) -> float:
        """Standard errors beyond 1.96 at which a functional of the spectrum has a value."""
        scale = self._weight / float(np.max(np.abs(weights)))
        found, _ = non_negative(
            np.vstack([self._columns, scale * weights]), np.append(self._y, scale * value)
        )
        error = self._columns @ found - self._y
        more = max(float(error @ error) - self._least, 0.0)
        return math.sqrt(more) / self._sigma - NORMAL_95

    def _inside(self, low: float, high: float) -> Array:
        """Which places lie between two logarithms of time constants, of the columns of all."""
        inside = np.zeros(self._columns.shape[1])
        inside[: len(self.logs)] = (self.logs > low) & (self.logs <= high)
        return inside

    def resistance(self, low: float, high: float) -> Interval:
        """Interval of the resistance of all time constants in a stretch [K/W].

        Parameters
        ----------
        low, high : float [ln s]
            The upper one included.
        """
        weights = self._inside(low, high)
        if not weights.any():
            return 0.0, 0.0
        here, step = float(weights @ self.best), 0.02 * self.total

        def excess(value: float) -> float:
            return self._excess(weights, value)

        least = 0.0 if excess(0.0) <= 0 else self._crossing(excess, 0.0, here, self.total)
        most = here + step
        while excess(most) <= 0:
            step *= 2
            most = here + step
            if most > UNBOUNDED * self.total:
                return least, float("inf")
        return least, self._crossing(excess, here, most, self.total)

    def mean_log(self, low: float, high: float) -> Interval:
        """Interval of the mean ln τ in a stretch, weighted by resistance [ln s].

        Parameters
        ----------
        low, high : float [ln s]
        """
        inside = self._inside(low, high)
        logs = np.append(self.logs, np.zeros(len(inside) - len(self.logs)))
        there = self.logs[inside[: len(self.logs)] > 0]
        ends = float(there[0]), float(there[-1])
        held = float(inside @ self.best)
        if held <= 0:
            return ends
        centre = float((inside * logs) @ self.best) / held

        def excess(value: float) -> float:
            return self._excess(inside * (logs - value), 0.0)

        first, last = (
            end if excess(end) <= 0 else self._crossing(excess, centre, end, 1.0) for end in ends
        )
        return first, last

    @staticmethod
    def _crossing(excess: Callable[[float], float], a: float, b: float, scale: float) -> float:
        """Where the excess is zero between two values; at the inner one where rounding rules."""
        values = excess(a), excess(b)
        if values[0] * values[1] >= 0:
            return a if abs(values[0]) < abs(values[1]) else b
        return float(brentq(excess, a, b, xtol=TOLERANCE * scale, rtol=1e-9))
