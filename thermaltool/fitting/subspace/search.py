"""The search for poles that all outputs share: subspace methods, then Gauss-Newton."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.errors import FitError
from thermaltool.fitting.data import Array
from thermaltool.fitting.subspace.problem import SubspacePoint, SubspaceProblem
from thermaltool.fitting.subspace.realization import Complex, Realization
from thermaltool.fitting.subspace.sections import PoleSection, all_poles, moved, of_poles
from thermaltool.signals.gauss_newton import minimize

# Rows on which starts are compared.
MAX_START_ROWS = 4000
# Shortest time constant [sample periods]; the longest in lengths of the record.
FASTEST_PERIODS, LONGEST_IN_RECORDS = 0.1, 10.0
# Largest natural frequency of a pair [rad/sample period], what is faster is an alias; and its least
# damping.
MAX_FREQUENCY, MIN_DAMPING_RATIO = 3.0, 1e-4
# Damping from which the two poles of a section are real and apart, the ratio of them 1.5.
MIN_REAL_DAMPING = 1.021
# A step that raises the logarithm of the likelihood by no more is the last one, of a candidate or a
# start the second; the largest step of a logarithm; linearizations.
LIKELIHOOD_TOLERANCE, ROUGH_TOLERANCE, MAX_STEP, MAX_ITERATIONS = 1e-4, 0.05, 1.0, 40
# Starts that are followed.
FOLLOWED_STARTS = 2
# Time constants that a pole more is chosen from.
ADDED_POLES = 8
METHOD = "subspace identification, refined by output error"


@dataclass(frozen=True)
class SubspaceSearchResult:
    """Where a search ended.

    Attributes
    ----------
    point : SubspacePoint
    converged : bool
    """

    point: SubspacePoint
    converged: bool


def bounded(
    sections: Iterable[PoleSection], longest: int, real: bool = False
) -> tuple[PoleSection, ...]:
    """Sections within the range of the search.

    Parameters
    ----------
    sections : iterable of PoleSection
    longest : int
        Rows of the longest record.
    real : bool
        Without pairs.
    """
    least = np.log(MIN_REAL_DAMPING if real else MIN_DAMPING_RATIO)
    slow, fast = -np.log(LONGEST_IN_RECORDS * longest), -np.log(FASTEST_PERIODS)
    found = []
    for section in sections:
        if section.states == 1:
            found.append(PoleSection((float(np.clip(section.theta[0], slow, fast)),)))
            continue
        omega = float(np.clip(section.theta[0], slow, fast))
        zeta = max(section.theta[1], least)
        if zeta < 0:
            omega = min(omega, np.log(MAX_FREQUENCY))
        # The slower real pole is about ω/2ζ, the faster 2ζω.
        most = max(min(omega - slow, fast - omega), 0.0) - np.log(2)
        found.append(PoleSection((omega, float(min(zeta, max(most, least, 0.0))))))
    return tuple(found)


def refine(
    problem: SubspaceProblem,
    sections: tuple[PoleSection, ...],
    tolerance: float = LIKELIHOOD_TOLERANCE,
) -> SubspaceSearchResult:
    """Damped Gauss-Newton over the logarithms of the sections from one start.

    Outputs are weighted by the inverse of their error variance, which the likelihood gives anew at
    every step.

    Parameters
    ----------
    problem : SubspaceProblem
    sections : tuple of PoleSection
    tolerance : float
        Gain of the logarithm of the likelihood by the last step.
    """
    longest = problem.data.longest

    def normal_equations(here: SubspacePoint) -> tuple[Array, Array]:
        parts = problem.linearized(here)
        matrix = sum(f.rows / f.loss * f.reduced for f in parts)
        return np.asarray(matrix), np.asarray(sum(f.rows / f.loss * f.pull for f in parts))

    def stepped(here: SubspacePoint, step: Array) -> SubspacePoint:
        there = moved(here.sections, np.clip(step, -MAX_STEP, MAX_STEP))
        return problem.project(bounded(there, longest, problem.real))

    end = minimize(
        problem.project(bounded(sections, longest, problem.real)),
        lambda here: 2 * here.criterion,
        normal_equations,
        stepped,
        lambda here: 2 * tolerance,
        MAX_ITERATIONS,
    )
    return SubspaceSearchResult(end.point, end.converged)


def search(
    problem: SubspaceProblem,
    found: Sequence[Realization],
    order: int,
    beside: Sequence[tuple[PoleSection, ...]] = (),
    tolerance: float = LIKELIHOOD_TOLERANCE,
) -> SubspaceSearchResult:
    """The poles of largest likelihood.

    Parameters
    ----------
    problem : SubspaceProblem
    found : sequence of Realization
    order : int
        Number of poles.
    beside : sequence of tuple of PoleSection
        Further starts: of this order, or of one less, to whose poles another one is added.
    tolerance : float
        As `refine`.

    Raises
    ------
    FitError
        There is no start.
    """
    thin = replace(problem, stride=max(1, problem.data.rows // MAX_START_ROWS))
    starts = [poles for each in found if (poles := each.poles(order)) is not None]
    for known in [*map(all_poles, beside), *([np.zeros(0, complex)] if order == 1 else [])]:
        starts += [known] if len(known) == order else _with_one_more(known, problem)
    if not starts:
        raise FitError(
            f"no run of readings without a gap is long enough for {order} modes: take fewer; "
            "--structure network takes holes"
        )
    ranked = _ranked(thin, starts)
    ends = [refine(thin, sections, ROUGH_TOLERANCE) for sections in ranked[:FOLLOWED_STARTS]]
    best = min(ends, key=lambda end: end.point.criterion)
    if thin.stride == problem.stride and tolerance >= ROUGH_TOLERANCE:
        return best
    return refine(problem, best.point.sections, tolerance)


def _with_one_more(poles: Complex, problem: SubspaceProblem) -> list[Complex]:
    longest = problem.data.longest
    rates = 1 / np.geomspace(0.3, longest / 2, ADDED_POLES)
    return [np.append(poles, -rate) for rate in rates]


def _ranked(problem: SubspaceProblem, starts: Sequence[Complex]) -> list[tuple[PoleSection, ...]]:
    """Sections of the starts, those of largest likelihood first."""
    longest = problem.data.longest
    each = [bounded(of_poles(poles), longest, problem.real) for poles in starts]
    return sorted(each, key=lambda sections: problem.project(sections).criterion)
