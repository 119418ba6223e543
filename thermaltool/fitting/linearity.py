"""Test of linearity: do products and powers of the inputs and of the output explain the error.

Of a linear plant the error of the free run is noise, and what is left of the inputs through
dynamics that the model lacks. The regression has terms for both: every input through a bank of
first-order lags, the model's own responses, the output a sample before and after. Beside these
stand second- and third-order terms: powers of the simulated output (a nonlinearity behind the
dynamics, Wiener), powers of the inputs through the model's responses (before them, Hammerstein),
products of input and output or of two inputs through them (bilinear). All is whitened by an AR
model of what the whole regression leaves, and both parts are compared by F. Where that looks
significant, the p-value is found anew from noise of the colour that the linear terms leave, for
which everything is done again: a regression flatters slow noise.

Higher-order correlation: Billings and Voon, Int. J. Control 44 (1986) 235; the regression form
with a linear part taken off first: Tsay, Biometrika 73 (1986) 461.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import fdtrc

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.error_regression import (
    MIN_DIRECTION,
    ErrorRegression,
    TestedModel,
    beside_instants,
    colour_of,
    error_regression,
    filtered,
)
from thermaltool.fitting.joint import with_absorbed
from thermaltool.fitting.projection import orthonormal_rows
from thermaltool.signals.gauss_newton import solve

# An error below this share of the squared output is rounding.
MIN_RELATIVE_ERROR = 1e-16
# A p-value below this by the F distribution is found anew by simulated noise: so many draws at
# most, fewer where so many statistics are larger; rows before each in which the noise settles.
SURE_P_VALUE, MAX_DRAWS, ENOUGH_LARGER, SETTLING_ROWS = 0.1, 99, 10, 500
# Other terms count where the linear ones leave more than this share of them.
MIN_NEW_SHARE = 1e-3
# "Nonlinear" needs a p-value of no more, and this share of the squared error explained.
MAX_P_VALUE, MIN_EXPLAINED = 0.01, 0.1
# It matters from this share of what the output moves on, or from the smaller one where it is as
# large as what is left beside it.
MIN_SIZE, MIN_SIZE_ABOVE_REST = 0.02, 0.005


@dataclass(frozen=True)
class LinearityTest:
    """What second- and third-order terms explain of the error of a linear model.

    Attributes
    ----------
    p_value : float
        Of the error having none of them.
    explained : float
        Share of the squared error that they explain, beside instants of switches between rows.
    linear_fit_percent, nonlinear_fit_percent : float
        Fit of the free run with all linear terms of the regression, and with the others, too.
    term : str
        Which of them explains most.
    deviation : float [unit of the output]
        Standard deviation of the output.
    """

    p_value: float
    explained: float
    linear_fit_percent: float
    nonlinear_fit_percent: float
    term: str = ""
    deviation: float = float("nan")

    @property
    def nonlinear(self) -> bool:
        """Whether the plant is not linear, and by so much that it counts."""
        return self.p_value <= MAX_P_VALUE and self.explained >= MIN_EXPLAINED

    @property
    def size(self) -> float:
        """RMS of what the terms explain, over the standard deviation of the output."""
        linear, whole = (1 - p / 100 for p in (self.linear_fit_percent, self.nonlinear_fit_percent))
        return float(np.sqrt(max(linear**2 - whole**2, 0.0)))

    @property
    def matters(self) -> bool:
        """Whether what is not linear is of a size that counts against the output and the rest."""
        rest = 1 - self.nonlinear_fit_percent / 100
        least = MIN_SIZE_ABOVE_REST if self.size >= rest else MIN_SIZE
        return self.nonlinear and self.size >= least


def linearity_test(model: TestedModel, data: TrainingData) -> LinearityTest | None:
    """Test of the errors of a free run; None where the data are too few.

    Parameters
    ----------
    model : TestedModel
    data : TrainingData
        With the one output of the model.
    """
    found = error_regression(model, data)
    if found is None:
        return None
    tested = beside_instants(found)
    basis = orthonormal_rows(np.vstack([tested.linear, tested.other]), MIN_DIRECTION)
    reduced = _reduced(tested, basis)
    if reduced is None:
        return None
    p_value = float(fdtrc(*reduced.degrees, reduced.statistic))
    if p_value < SURE_P_VALUE:
        p_value = _simulated_p_value(tested, basis, reduced.statistic)
    kept = reduced.kept
    # The fit is that of the output as it is.
    deviation, linear, whole = own = _deviations(found, kept)
    _, left, less = own if tested is found else _deviations(tested, kept)
    explained = float(1 - (less / left) ** 2)
    return LinearityTest(
        p_value,
        explained,
        float(100 * (1 - linear / deviation)),
        float(100 * (1 - whole / deviation)),
        found.names[kept[int(np.argmax(reduced.alone))]],
        deviation,
    )


def _deviations(rows: ErrorRegression, kept: NDArray[np.intp]) -> tuple[float, float, float]:
    """Of the output, of what the linear terms leave, and of what all leave."""
    left = rows.error - _weights(rows.linear, rows.error) @ rows.linear
    both = np.vstack([rows.linear, rows.other[kept]])
    less = rows.error - _weights(both, rows.error) @ both
    deviation, linear, whole = (float(np.sqrt(np.mean(x**2))) for x in (rows.output, left, less))
    return deviation, linear, whole


@dataclass(frozen=True)
class Reduced:
    """Both parts of the regression compared.

    Attributes
    ----------
    statistic : float
        F.
    degrees : (int, int)
        Its degrees of freedom.
    kept : ndarray of int, shape (k,)
        Other terms that are not linear ones to rounding.
    alone : ndarray, shape (k,)
        Squared error that each of them explains by itself.
    """

    statistic: float
    degrees: tuple[int, int]
    kept: NDArray[np.intp]
    alone: Array


def _reduced(found: ErrorRegression, basis: Array) -> Reduced | None:
    """Both parts compared; None where no other term is left, or no error.

    Parameters
    ----------
    found : ErrorRegression
    basis : ndarray, shape (k, n)
        Orthonormal, of all its terms.
    """
    colour, _ = colour_of(found, found.error - (found.error @ basis.T) @ basis)
    white = filtered(found, colour)
    linear = orthonormal_rows(white.linear, MIN_DIRECTION)
    rest = white.other - (white.other @ linear.T) @ linear
    error = white.error - (white.error @ linear.T) @ linear
    sizes, left = (np.sqrt(np.sum(rows**2, axis=1)) for rows in (white.other, rest))
    kept = np.flatnonzero(left > MIN_NEW_SHARE * np.maximum(sizes, 1e-300))
    if not len(kept):
        return None
    new = orthonormal_rows(rest[kept], MIN_NEW_SHARE)
    gained, power = float(np.sum((new @ error) ** 2)), float(error @ error)
    q, free = len(new), len(error) - len(linear) - len(new)
    if free < 1 or not power > MIN_RELATIVE_ERROR * float(found.output @ found.output):
        return None
    statistic = gained / q / (max(power - gained, 1e-300) / free)
    return Reduced(statistic, (q, free), kept, (rest[kept] @ error) ** 2 / left[kept] ** 2)


def _simulated_p_value(found: ErrorRegression, basis: Array, statistic: float) -> float:
    """Share of draws of noise that have as large a statistic (Besag and Clifford 1991).

    Parameters
    ----------
    found : ErrorRegression
    basis : ndarray, shape (k, n)
        As `_reduced`.
    statistic : float
    """
    linear = orthonormal_rows(found.linear, MIN_DIRECTION)
    given = colour_of(found, found.error - (found.error @ linear.T) @ linear)
    places = [(np.arange(len(linear)), part) for part in found.runs(linear)]
    colour, _ = with_absorbed(given, np.eye(len(linear)), places)
    # The same draws at every call: a result must not change from run to run.
    rng, larger = np.random.default_rng(0), 0
    for drawn in range(1, MAX_DRAWS + 1):
        noise = [
            lfilter([1.0], colour, rng.standard_normal(len(run) + SETTLING_ROWS))[SETTLING_ROWS:]
            for run in found.runs(found.error)
        ]
        other = _reduced(replace(found, error=np.concatenate(noise)), basis)
        larger += other is not None and other.statistic >= statistic
        if larger == ENOUGH_LARGER:
            return larger / drawn
    return (larger + 1) / (MAX_DRAWS + 1)


def _weights(rows: Array, error: Array) -> Array:
    """Least squares."""
    sizes = np.maximum(np.sqrt(np.sum(rows**2, axis=1)), 1e-300)
    unit = rows / sizes[:, None]
    return np.asarray(solve(unit @ unit.T, unit @ error) / sizes)
