"""Rules that choose a regularization parameter, all from one path of solutions.

A path has a solution for every parameter of a grid, from the strongest regularization to the
weakest, and what a rule looks at: misfit, penalty, degrees of freedom, likelihood. The rules know
neither the operator nor the penalty (Hansen 1998, ch. 7; Bauer and Lukas 2011). A rule that has no
minimum, no corner or no crossing inside the grid is refused, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from thermaltool.responses.modes import Float

Rule = Literal["likelihood", "gcv", "quasi-optimality", "discrepancy", "l-curve"]
# The default takes the first of them that is not refused: in the order in which they fared on
# simulated machines (benchmarks/deconvolution.py).
RULES: tuple[Rule, ...] = get_args(Rule)

# A corner whose curvature is less is none: an arc of constant curvature through a right angle
# of two decades in each direction has 0.4 [1 per unit of the logarithm].
LEAST_CURVATURE = 0.5
# A choice is refused whose expected error is so many times the least of the path [1].
MAX_EXPECTED_RATIO = 1.2


@dataclass(frozen=True)
class Path:
    """Solutions over a grid of parameters, the strongest regularization first.

    Attributes
    ----------
    parameter : ndarray, shape (p,)
    solutions : ndarray, shape (p, n)
    misfit : ndarray, shape (p,)
        Sum of the squared residuals over the variance of the noise [1].
    count : int
        Number of readings.
    freedom : ndarray, shape (p,)
        Degrees of freedom of the fit: the trace of what leads from readings to fitted readings.
    penalty : ndarray, shape (p,), or None
        Squared (semi)norm of the solution; None where the method has none.
    log_likelihood : ndarray, shape (p,), or None
        [nats], with the scale of the noise at its maximum; None where the method has none.
    expected_error : ndarray, shape (p,), or None
        Root mean square error that each solution is expected to have; None where nothing tells it.
    noise_known : bool
        Whether the variance of the noise was measured.
    is_stepped : bool
        Whether only the parameters of the grid have a solution: choices are the nearest of them.
    """

    parameter: Float
    solutions: Float
    misfit: Float
    count: int
    freedom: Float
    penalty: Float | None = None
    log_likelihood: Float | None = None
    expected_error: Float | None = None
    noise_known: bool = True
    is_stepped: bool = False


@dataclass(frozen=True)
class RuleChoice:
    """What a rule says of a path.

    Attributes
    ----------
    rule : Rule or None
        None for a choice without a rule.
    place : float or None
        Place on the path, a fraction between two grid points included; None where it is refused.
    parameter : float or None
    residual_over_noise : float or None
        Root mean square of the residuals over that of the noise [1].
    expected_error : float or None
        Root mean square [unit of the drive].
    reason : str
        Why it is refused; empty where it is not. A choice whose expected error refuses it is told
        all the same.
    """

    rule: Rule | None
    place: float | None
    parameter: float | None = None
    residual_over_noise: float | None = None
    expected_error: float | None = None
    reason: str = ""


class NoChoiceError(Exception):
    """A rule has no answer; the message says why."""


def apply_rules(path: Path) -> tuple[RuleChoice, ...]:
    """What every rule says, in the order of `RULES`.

    Parameters
    ----------
    path : Path
    """
    return tuple(_applied(rule, path) for rule in RULES)


def _applied(rule: Rule, path: Path) -> RuleChoice:
    try:
        place = _PLACES[rule](path)
    except NoChoiceError as error:
        return RuleChoice(rule, None, reason=str(error))
    if path.is_stepped:
        place = float(round(place))
    parameter = _between(place, path.parameter)
    residual = _between(place, path.misfit / path.count) ** 0.5
    if path.expected_error is None:
        return RuleChoice(rule, place, parameter, residual)
    expected, least = _between(place, path.expected_error), float(np.min(path.expected_error))
    reason = ""
    if expected > MAX_EXPECTED_RATIO * least:
        reason = f"its expected error is {expected / least:.2g} times the least of the grid"
    return RuleChoice(rule, place, parameter, residual, expected, reason)


def _between(place: float, values: Float) -> float:
    """Of a place between two grid points, on a logarithmic scale."""
    return float(np.exp(np.interp(place, np.arange(len(values)), np.log(values))))


def _interior_minimum(values: Float, what: str) -> float:
    """Place of the smallest value, between grid points by a parabola."""
    if not np.isfinite(values).any():
        raise NoChoiceError(f"{what} is not finite")
    k = int(np.nanargmin(values))
    if k in (0, len(values) - 1):
        end = "strongest" if k == 0 else "weakest"
        raise NoChoiceError(f"no minimum inside the grid: {what} falls to its {end} regularization")
    before, here, behind = values[k - 1 : k + 2]
    bend = before - 2 * here + behind
    return k + (0.5 * (before - behind) / bend if bend > 0 else 0.0)


def _likelihood(path: Path) -> float:
    if path.log_likelihood is None:
        raise NoChoiceError("the method has no likelihood in closed form")
    return _interior_minimum(-path.log_likelihood, "minus the logarithm of the likelihood")


def _gcv(path: Path) -> float:
    """Generalized cross-validation (Golub, Heath and Wahba 1979)."""
    left = 1 - path.freedom / path.count
    return _interior_minimum(np.log(path.misfit) - 2 * np.log(np.maximum(left, 1e-12)), "GCV")


def _discrepancy(path: Path) -> float:
    """The residuals are as large as the noise (Morozov 1966)."""
    if not path.noise_known:
        raise NoChoiceError("the noise is not known, or zero")
    ratio = np.log(path.misfit / path.count)
    above = np.flatnonzero(ratio > 0)
    if not len(above):
        raise NoChoiceError(
            "the residuals are below the noise on the whole grid: it is smaller than was measured, "
            "or there is no heat"
        )
    k = int(above[-1])
    if k == len(ratio) - 1:
        raise NoChoiceError(
            "the residuals stay above the noise on the whole grid: it is larger than was measured, "
            "or the model is wrong"
        )
    return k + float(ratio[k] / (ratio[k] - ratio[k + 1]))


def _quasi_optimality(path: Path) -> float:
    """Where the solution changes least from one parameter to the next (Tikhonov and Glasko)."""
    steps = np.diff(np.log(path.parameter))
    change = np.linalg.norm(np.diff(path.solutions, axis=0), axis=1) / np.abs(steps)
    inner = np.flatnonzero((change[1:-1] < change[:-2]) & (change[1:-1] <= change[2:])) + 1
    if not len(inner):
        raise NoChoiceError("no minimum inside the grid: the change of the solution has none")
    return float(inner[np.argmin(change[inner])]) + 0.5


def _l_curve(path: Path) -> float:
    """The corner of misfit against penalty, on logarithmic scales (Hansen and O'Leary 1993)."""
    if path.penalty is None:
        raise NoChoiceError("the method has no penalty: there is no L-curve")
    # Slow to import, and the stream needs none of it.
    from scipy.interpolate import make_interp_spline

    at = np.arange(len(path.parameter), dtype=float)
    if len(at) < 4:
        raise NoChoiceError(f"a corner needs 4 points of the grid; there are {len(at)}")
    # An odd degree below the number of points.
    degree = min(5, (len(at) - 2) | 1)
    xy = [make_interp_spline(at, np.log(np.maximum(each, 1e-300)) / 2, k=degree)
          for each in (path.misfit, path.penalty)]  # fmt: skip
    fine = np.linspace(1.0, len(at) - 2.0, 20 * len(at))
    x1, y1, x2, y2 = (each(fine, nu=order) for order in (1, 2) for each in xy)
    speed = np.maximum(x1**2 + y1**2, 1e-12) ** 1.5
    # Misfit falls and penalty rises along the path: the corner turns left to right.
    curvature = (x2 * y1 - x1 * y2) / speed
    k = int(np.argmax(curvature))
    if k in (0, len(fine) - 1) or curvature[k] < LEAST_CURVATURE:
        raise NoChoiceError(
            f"no corner inside the grid: the largest curvature is {curvature[k]:.2g}"
        )
    return float(fine[k])


_PLACES = {
    "likelihood": _likelihood,
    "gcv": _gcv,
    "discrepancy": _discrepancy,
    "quasi-optimality": _quasi_optimality,
    "l-curve": _l_curve,
}
