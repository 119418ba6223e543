"""The nonlinear side of a calibration: rates and shapes, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from thermaltool.errors import FitError
from thermaltool.fitting.discrepancy import AS_NEAR
from thermaltool.fitting.parametrization import SLOPE_STEP, Parametrization
from thermaltool.fitting.possible import Soundness, impossible
from thermaltool.fitting.projection import CalibrationProblem, Triangle
from thermaltool.model import Drive
from thermaltool.responses.modes import Float
from thermaltool.signals.detrend import difference_sigma


@dataclass(frozen=True)
class Tolerance:
    """Where a search ends: relative change of the parameters, and of the squared error.

    Attributes
    ----------
    step, loss : float
    central : bool
        Whether slopes are taken to both sides: those to one are off by too much for a fine search.
    """

    step: float
    loss: float
    central: bool


# Ends of a search whose weights differ by less, as a share, are one.
SAME_END = 0.1
# In a comparison all starts take so many steps, and so many of them go on.
FIRST_STEPS, LEADERS = 8, 2
# Step of a trust region that counts as one, in logarithms; where the search ends.
STEP_SCALE = 0.3
FINE, COARSE = Tolerance(1e-10, 1e-13, True), Tolerance(1e-4, 1e-5, False)


class StartSearch:
    """Errors of a set of rates relative to the deviation of the output, and where they are least.

    By the bounded trust region of scipy. The damped Gauss-Newton of signals/gauss_newton.py is as
    fast, and comes closer to a minimum that both find; but kinds of four rates and more have many,
    and from the same starts it ended in others: 2 % higher on the gantry with two drives [squared
    error], 26 % higher or 10 % lower on the hair dryer with the longest step that it may take.

    Parameters
    ----------
    problem : CalibrationProblem
    parametrization : Parametrization
    bounds : (ndarray, ndarray), each shape (searched,)
    tolerance : Tolerance
        `FINE` for a fit, `COARSE` for a comparison.
    """

    def __init__(
        self,
        problem: CalibrationProblem,
        parametrization: Parametrization,
        bounds: tuple[Float, Float],
        tolerance: Tolerance = FINE,
    ) -> None:
        self.tolerance = tolerance
        self.problem, self.parametrization, self.bounds = problem, parametrization, bounds
        rows = len(problem.measured)
        self.scale = float(np.std(problem.measured)) * np.sqrt(rows) or 1.0

    def errors(self, theta: Float, triangle: Triangle, kept: bool = False) -> Float:
        """Errors that depend on the rates, over the deviation of the output, shape (k,).

        Parameters
        ----------
        theta : ndarray, shape (searched,)
            Logarithms of the rates and shapes.
        triangle : Triangle
        kept : bool
            See `Parametrization.unit_weights`.
        """
        unit = self.parametrization.unit_weights(theta, self.problem.grid, kept)
        errors = self.problem.project(unit, triangle)[0] / self.scale
        return errors * (1 + self.parametrization.excess(theta))

    def slopes(self, theta: Float, triangle: Triangle) -> Float:
        """Derivatives of the errors, shape (k, searched).

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        triangle : Triangle
        """
        own = self.parametrization
        slopes = self.problem.slopes(own, theta, triangle, self.tolerance.central) / self.scale
        if excess := own.excess(theta):
            ahead = [own.excess(theta + step) for step in SLOPE_STEP * np.eye(len(theta))]
            rise = (np.array(ahead) - excess) / SLOPE_STEP
            slopes = slopes * (1 + excess)
            slopes += np.outer(self.errors(theta, triangle) / (1 + excess), rise)
        return np.asarray(slopes)

    def refine(
        self, theta: Float, triangle: Triangle, most: int | None = None
    ) -> tuple[float, Float]:
        """Size of the errors at the minimum near `theta`, and where it is.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        triangle : Triangle
        most : int, optional
            Steps after which the search ends anyway.
        """
        low, high = self.bounds
        inside = np.clip(theta, low + 1e-9, high - 1e-9)
        solution = least_squares(
            self.errors, inside, self.slopes, bounds=self.bounds, x_scale=STEP_SCALE,
            xtol=self.tolerance.step, ftol=self.tolerance.loss, args=(triangle,), max_nfev=most,
        )  # fmt: skip
        return float(np.linalg.norm(self.errors(solution.x, triangle))), solution.x

    def best(
        self,
        grid: Sequence[Float],
        triangle: Triangle,
        starts: int,
        progress: Callable[[str], None],
    ) -> list[tuple[float, Float]]:
        """Where the best `starts` of a grid lead to, the best first.

        Parameters
        ----------
        grid : sequence of ndarray, shape (searched,)
        triangle : Triangle
        starts : int
        progress : callable

        Raises
        ------
        FitError
            None of the grid has finite errors.
        """
        # Every fit of a kind begins with the same grid.
        sizes = np.array([np.linalg.norm(self.errors(theta, triangle, True)) for theta in grid])
        order = [grid[k] for k in np.argsort(sizes) if np.isfinite(sizes[k])][:starts]
        if not order:
            raise FitError("no start of the search has a finite error")
        if self.tolerance is COARSE and len(order) > LEADERS:
            ahead = [self.refine(theta, triangle, FIRST_STEPS) for theta in order]
            order = [theta for _, theta in sorted(ahead, key=lambda result: result[0])[:LEADERS]]
        reached = []
        for number, theta in enumerate(order):
            progress(f"start {number + 1} of {len(order)}")
            reached.append(self.refine(theta, triangle))
        return sorted(reached, key=lambda result: result[0])

    def fitted(self, theta: Float, triangle: Triangle) -> tuple[Float, Float]:
        """Residual of every row [unit of the output], and gains, decays, offsets.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        triangle : Triangle
        """
        unit = self.parametrization.unit_weights(theta, self.problem.grid)
        linear = self.problem.project(unit, triangle)[1]
        return self.problem.residual(unit, linear), linear

    def soundness(
        self, theta: Float, linear: Float, drives: Sequence[Drive], output: str, duration: float
    ) -> Soundness:
        """Whether these rates and gains may be those of a machine.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        linear : ndarray
            Gains, and what else there is.
        drives : sequence of Drive
        output : str
        duration : float [s]
            Of the longest record.
        """
        own = self.parametrization
        gains = linear[: own.gains]
        responses = own.responses(theta, gains)
        slowest = max(response.slowest() for response in responses)
        return Soundness(
            self.problem.cancellation(own.unit_weights(theta, self.problem.grid), gains),
            slowest / duration,
            impossible(drives, output, responses, self.problem.longest),
        )


def shared_otherwise(
    search: StartSearch, theta: Float, ends: Sequence[Float], triangle: Triangle
) -> list[Float]:
    """Grid weights of other ends of the search that leave no more than a reading's noise besides.

    What several drives do together they may share in other ways, which the slopes at one end of
    the search do not show.

    Parameters
    ----------
    search : StartSearch
    theta : ndarray, shape (searched,)
        The end that was taken.
    ends : sequence of ndarray, shape (searched,)
    triangle : Triangle

    Returns
    -------
    list of ndarray, shape (drives, rates)
    """
    own, problem = search.parametrization, search.problem

    def fitted(end: Float) -> tuple[Float, Float]:
        left, linear = search.fitted(end, triangle)
        weights = own.unit_weights(end, problem.grid) @ linear[: own.gains]
        return left, weights.reshape(problem.drives, -1)

    least, taken = fitted(theta)
    most = np.mean(least**2) + (AS_NEAR * difference_sigma(least)) ** 2
    apart = [taken]
    for left, weights in map(fitted, ends):
        change = min(float(np.linalg.norm(weights - each)) for each in apart)
        if np.mean(left**2) <= most and change > SAME_END * np.linalg.norm(taken):
            apart.append(weights)
    return apart[1:]
