"""Tikhonov solutions over a grid of weights, and what the rules look at, from two curves alone.

With y ~ N(0, Σ + A K Aᵀ/λ) the quadratic form Q(λ) = yᵀ(…)⁻¹y and the logarithm of the determinant
D(λ) are what a smoother gives on its way. Their slopes in log(1/λ) are the rest: the misfit is
Q + Q', the penalty −Q', the degrees of freedom D'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermaltool.errors import FitError
from thermaltool.estimation.even_smoother import EvenSmoother
from thermaltool.estimation.parameter_rules import Path
from thermaltool.estimation.penalties import HeatProblem
from thermaltool.responses.modes import Float

# Weights a decade; the rules interpolate.
WEIGHTS_PER_DECADE = 2
# The least weight of each order: a heat that changes by its level from row to row (of order 0:
# that is of three times its level) is regularized by nothing.
LEAST_WEIGHT = (0.1, 1.0, 1.0)
# The largest weight leaves no more than this of one degree of freedom; and no more decades.
LEAST_FREEDOM, MAX_DECADES = 1.0, 16


@dataclass(frozen=True)
class TikhonovPath:
    """Solutions of one order.

    Attributes
    ----------
    path : Path
    variance : ndarray, shape (p,)
        Of the heat far from the ends, given the readings, where the prior of a weight holds and
        the noise has the scale that the likelihood gives it [unit of the drive, squared].
    """

    path: Path
    variance: Float

    @property
    def best(self) -> int:
        """Place of the weight with the largest likelihood."""
        return int(np.argmax(self.log_likelihood))

    @property
    def log_likelihood(self) -> Float:
        """Of the readings, for each weight [nats]."""
        assert self.path.log_likelihood is not None, "made with it"
        return self.path.log_likelihood

    def expected_error(self, solutions: Float) -> Float:
        """Root mean square errors that solutions have, as the best weight's likelihood has it.

        The mean over all heats that the readings leave: their variance around the conditional
        mean, and the square of the distance from it.

        Parameters
        ----------
        solutions : ndarray, shape (p, n)
        """
        apart = np.mean((solutions - self.path.solutions[self.best]) ** 2, axis=1)
        return np.asarray(np.sqrt(self.variance[self.best] + apart))


def tikhonov(problem: HeatProblem, readings: Float, order: int, weight: float) -> Float:
    """The heat of one weight.

    Parameters
    ----------
    problem : HeatProblem
    readings : ndarray, shape (n, n_sensors)
    order : int
    weight : float [1]

    Returns
    -------
    ndarray, shape (n,)
    """
    return _smoother(problem, len(readings), order, weight).run(readings)[0][:, 0]


def tikhonov_path(problem: HeatProblem, readings: Float, order: int) -> TikhonovPath:
    """Solutions over a grid of weights, from one degree of freedom to a heat that is free.

    Parameters
    ----------
    problem : HeatProblem
    readings : ndarray, shape (n, n_sensors)
    order : int

    Raises
    ------
    FitError
        The readings tell nothing of the heat at any weight.
    """
    # Slow to import, and the stream needs none of it.
    from scipy.interpolate import make_interp_spline

    rows, count = len(readings), readings.size
    least = LEAST_WEIGHT[order]
    free = _smoother(problem, rows, order, least * 10.0**MAX_DECADES).log_determinant
    # Where less is told than a degree of freedom, by halves.
    decades, low = MAX_DECADES, 0
    while decades - low > 1:
        middle = (low + decades) // 2
        told = _smoother(problem, rows, order, least * 10.0**middle).log_determinant - free
        low, decades = (low, middle) if told < LEAST_FREEDOM else (middle, decades)
    if decades < 2:
        raise FitError("the readings tell nothing of the heat: its level leaves no sensor more "
                       "than noise")  # fmt: skip
    weights = least * np.geomspace(10.0**decades, 1.0, WEIGHTS_PER_DECADE * decades + 1)
    solutions, squares = np.empty((len(weights), rows)), np.empty(len(weights))
    logs, variance = np.empty(len(weights)), np.empty(len(weights))
    for k, weight in enumerate(weights):
        smoother = _smoother(problem, rows, order, float(weight))
        heat, squares[k] = smoother.run(readings)
        solutions[k], logs[k] = heat[:, 0], smoother.log_determinant
        variance[k] = smoother.variance[0]
    if not np.any(squares > 0):
        raise FitError("every reading is zero: no heat, and no noise to tell its size")
    at = -np.log(weights)
    fall = make_interp_spline(at, np.log(squares))(at, nu=1).clip(-1 + 1e-9, -1e-12)
    freedom = make_interp_spline(at, logs)(at, nu=1).clip(1e-9, count * (1 - 1e-9))
    path = Path(
        weights,
        solutions,
        squares * (1 + fall),
        count,
        freedom,
        squares * -fall / weights,
        -0.5 * (count * np.log(squares / count) + logs),
    )
    return TikhonovPath(path, variance * squares / count)


def _smoother(problem: HeatProblem, rows: int, order: int, weight: float) -> EvenSmoother:
    return EvenSmoother(*problem.space(order, weight), rows)
