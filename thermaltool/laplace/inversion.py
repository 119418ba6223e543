"""Numerical inversion of Laplace transforms: one interface, several methods, an honest error.

No method can bound its own error from its own samples: a contour that leaves a pole outside
converges beautifully to a wrong answer. So every estimate here is the larger of two things, the
difference of two orders of the method and its difference from a second, unrelated method. What
lies right of both is found first, by `causality`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermaltool.errors import FitError
from thermaltool.laplace.causality import rightmost
from thermaltool.laplace.contours import hyperbola, windows
from thermaltool.laplace.dehoog import HALF_PERIOD, beyond_head, dehoog
from thermaltool.laplace.resonances import Resonances, scan
from thermaltool.laplace.rules import RULES, apply_rule
from thermaltool.laplace.sampling import RealArray, Sampler, Transfer

METHODS = ("auto", "hyperbola", "talbot", "euler", "dehoog", "stehfest")

# Terms summed before acceleration, in the Fourier series that answers and in the one that checks
# it; the next pair is tried where the error exceeds the tolerance.
HEAD_TERMS = ((256, 64), (2048, 512), (8192, 2048))


@dataclass(frozen=True)
class Goal:
    """The error wanted of f(t)/growth at ascending times: absolute, or of what f has reached.

    Attributes
    ----------
    growth : ndarray, shape (n,)
    tol, rtol : float
        See `invert`.
    reached : float
        Largest |f| before the first of the times.
    """

    growth: RealArray
    tol: float
    rtol: float
    reached: float = 0.0

    def __call__(self, values: RealArray, error: RealArray) -> RealArray:
        """The errors wanted, shape (n,), where `values` and their `error` are f(t)/growth."""
        with np.errstate(all="ignore"):
            known = np.append(self.reached, (abs(values) - error) * self.growth)
            return np.fmax(self.tol, self.rtol * np.fmax.accumulate(known)[1:]) / self.growth

    def within(self, window: slice, values: RealArray, error: RealArray) -> Goal:
        """The same for the times of `window`, after those of `values` and their `error`."""
        with np.errstate(all="ignore"):
            known = (abs(values) - error) * self.growth[: values.size]
        return Goal(
            self.growth[window], self.tol, self.rtol, float(np.fmax.reduce(known, initial=0.0))
        )


@dataclass(frozen=True)
class Inversion:
    """An inverse Laplace transform at given times.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times [s], in the order asked for.
    values : ndarray, shape (n,)
        f(t); NaN where the method has no answer.
    error : ndarray, shape (n,)
        Estimated absolute error of `values`, in their unit; infinite where these are NaN.
    method : str
        The method, or those that ``auto`` took (``hyperbola+dehoog``).
    evaluations : int
        Number of s at which the transfer function was evaluated.
    abscissa : float
        Largest real part of the singularities of F [1/s], as given or as found.
    wanted : ndarray, shape (n,)
        The error that was wanted, in the unit of `values`.
    """

    t: RealArray
    values: RealArray
    error: RealArray
    method: str
    evaluations: int
    abscissa: float
    wanted: RealArray


def invert(
    transfer: Transfer,
    t: ArrayLike,
    *,
    method: str = "auto",
    tol: float = 1e-9,
    rtol: float = 1e-9,
    abscissa: float | None = None,
) -> Inversion:
    """Invert a Laplace transform F(s) of a real function f(t).

    Parameters
    ----------
    transfer : callable
        F: complex ndarray of shape (m,) [1/s] in, the same shape out (or a constant). f is real,
        so only Im s ≥ 0 is evaluated. For a step response pass ``lambda s: H(s) / s``.
    t : array_like, shape (n,)
        Times [s], above 0, in any order.
    method : str
        ``auto``: hyperbola, and where its error exceeds `tol` the better of it and dehoog.
        ``hyperbola`` (Weideman & Trefethen 2007) and ``talbot`` (Abate & Valko 2004): contours
        into the left half plane, for singularities on or near the negative real axis; 70
        evaluations per window of times (last/first ≤ 16), and 38 per time. ``euler`` (Abate &
        Whitt 2006): 54 per time, copes with oscillation of a few periods. ``dehoog`` (de Hoog,
        Knight & Stokes 1982): Re s > abscissa only, copes with poles near the imaginary axis and
        with delays. ``stehfest`` (Stehfest 1970): real s only, smooth f, four to seven digits.
    tol, rtol : float
        Error wanted: `tol`, in the unit of f, or `rtol` of the largest |f| up to that time,
        whichever is larger; dehoog takes more terms until it is met.
    abscissa : float, optional
        Largest real part of the singularities of F [1/s], taken as known; above 0 for an
        unstable F. Without it the rightmost singularity is found by some thousand evaluations
        more, except for ``stehfest``: 0.

    Returns
    -------
    Inversion
        `error` includes the difference from an independent dehoog inversion, whose evaluations
        are counted, except for ``stehfest``: its estimate, from real s alone, is blind to
        oscillations that it has smoothed away.

    Raises
    ------
    ValueError
        `t` not positive, finite and one-dimensional; unknown `method`; `tol` not positive;
        `rtol` negative.
    FitError
        F is not finite at an s that the method needs (the message names it); no line has all
        its singularities on the left.
    """
    times = np.asarray(t, dtype=np.float64)
    if times.ndim != 1 or not (np.isfinite(times) & (times > 0)).all():
        raise ValueError("times must be a one-dimensional array of positive finite numbers")
    if method not in METHODS:
        raise ValueError(f"no method {method!r}; one of {', '.join(METHODS)}")
    if not tol > 0 or not rtol >= 0 or not (abscissa is None or np.isfinite(abscissa)):
        raise ValueError("tol must be above 0, rtol not below, and abscissa finite")
    order = np.argsort(times, kind="stable")
    ascending = times[order]
    sample = Sampler(transfer, abscissa or 0.0)
    if abscissa is None and method != "stehfest" and times.size:
        sample.abscissa = rightmost(sample, ascending, tol)
    with np.errstate(over="ignore"):
        growth = np.exp(sample.abscissa * ascending)
    goal = Goal(growth, tol, rtol)
    values, error, used = _by_windows(sample, ascending, method, goal)
    with np.errstate(all="ignore"):
        wanted = goal(values, error) * growth
        values, error = values * growth, error * growth
    unusable = ~(np.isfinite(values) & np.isfinite(error))
    values[unusable], error[unusable] = np.nan, np.inf
    back = np.argsort(order, kind="stable")
    return Inversion(
        times,
        values[back],
        error[back],
        used,
        sample.evaluations,
        sample.abscissa,
        np.where(unusable, tol, wanted)[back],
    )


def _by_windows(
    sample: Sampler, t: RealArray, method: str, goal: Goal
) -> tuple[RealArray, RealArray, str]:
    """Values, errors and methods used at ascending times."""
    if method == "stehfest":
        return *apply_rule(sample, t, method), method
    values, error = np.empty_like(t), np.empty_like(t)
    from_dehoog = np.zeros(t.size, dtype=bool)
    resonances = scan(sample, t, (goal.tol / goal.growth).min(initial=np.inf))
    for window in windows(t):
        here = goal.within(window, values[: window.start], error[: window.start])
        values[window], error[window], from_dehoog[window] = _audited(
            sample, t[window], method, here, resonances
        )
    if method != "auto":
        return values, error, method
    used = [("hyperbola", not from_dehoog.all()), ("dehoog", from_dehoog.any())]
    return values, error, "+".join(name for name, is_used in used if is_used) or method


def _audited(
    sample: Sampler, t: RealArray, method: str, goal: Goal, resonances: Resonances
) -> tuple[RealArray, RealArray, NDArray[np.bool_]]:
    """Values, errors and whether dehoog gave them, at the times of one window."""
    values, own_error = _contour(sample, t, method)
    series, series_error = np.full_like(t, np.nan), np.full_like(t, np.inf)
    missed = np.zeros_like(t)
    for head, check in HEAD_TERMS:
        longer, error, rounding = dehoog(sample, t, head, check)
        undamped = resonances.above(np.pi * head / (HALF_PERIOD * t[-1]))
        wanted = float(goal(longer, error).min())
        unresolved = max(undamped, beyond_head(sample, t, longer, head, wanted))
        error = _worst(error, unresolved)
        better = error < series_error  # more terms are not better where F itself is rounded
        series = np.where(better, longer, series)
        series_error = np.where(better, error, series_error)
        missed = np.where(better, unresolved, missed)
        audited = _worst(own_error, abs(values - series), missed)
        target = goal(series, series_error)
        if (np.minimum(audited, series_error) <= np.maximum(target, 10 * rounding)).all():
            break
    if method == "dehoog":
        return series, series_error, np.ones(t.size, dtype=bool)
    replaced = (audited > target) & (series_error < audited) & (method == "auto")
    return (np.where(replaced, series, values), np.where(replaced, series_error, audited), replaced)


def _contour(sample: Sampler, t: RealArray, method: str) -> tuple[RealArray, RealArray]:
    """Values and errors by `method`; no answer for dehoog, which audits itself."""
    nothing = np.full_like(t, np.nan), np.full_like(t, np.inf)
    if method == "dehoog":
        return nothing
    if method in RULES:
        return apply_rule(sample, t, method)
    try:
        return hyperbola(sample, t)
    except FitError:  # in the left half plane, where only the contour needs F
        if method == "auto":
            return nothing
        raise


def _worst(*errors: RealArray | float) -> RealArray:
    """The largest of the estimates; one that is NaN says that there is no answer."""
    worst = np.asarray(np.maximum.reduce(np.broadcast_arrays(*errors)))
    return np.where(np.isnan(worst), np.inf, worst)
